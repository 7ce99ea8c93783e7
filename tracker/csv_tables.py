"""Comma-separated tables with one header row: reading with a check of every row, and text cells for spreadsheets.

Pressure logs, which have any form, are read by `study/csv_log.py`; labels by `labeling/label_table.py`.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

# Characters with which a cell begins that a spreadsheet takes for a formula.
_FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r")
_QUOTE = "'"


def read_csv_table(path: Path, delimiter: str = ",", decimal: str = ".") -> pd.DataFrame:
    """Read a table whose rows all have as many fields as the header has names.

    pandas alone shifts or cuts rows that have more fields, and fills rows that have fewer, without a word. Fields
    after the last name are allowed where they are empty, as many programs end each line with a delimiter.

    Parameters
    ----------
    path : Path
        The file, in UTF-8 with or without a byte order mark.
    delimiter : str, optional
        Between two fields.
    decimal : str, optional
        Decimal sign of numbers.

    Returns
    -------
    DataFrame
        The table; names are stripped of blanks.

    Raises
    ------
    ValueError
        Not UTF-8, not such a table, a row of another length, or a name that is there twice.
    OSError
        The file cannot be read.
    """
    text = path.read_bytes().decode("utf-8-sig")
    if "\0" in text:
        raise ValueError("expected text, got a byte of value 0")
    names = _checked_names(text, delimiter)
    return pd.read_csv(
        io.StringIO(text),
        sep=delimiter,
        decimal=decimal,
        header=None,
        names=names,
        usecols=range(len(names)),
        skiprows=_lines_to_header(text),
        index_col=False,
        low_memory=False,
    )


def _checked_names(text: str, delimiter: str) -> list[str]:
    """Names of the header, after every row was compared with it."""
    names: list[str] = []
    try:
        rows = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        for row in rows:
            if not names:
                names = _without_empty_end([name.strip() for name in row], 0)
                if len(set(names)) < len(names):
                    twice = next(name for name in names if names.count(name) > 1)
                    raise ValueError(f"expected distinct names of columns, got '{twice[:60]}' twice")
            elif row and len(_without_empty_end(row, len(names))) != len(names):
                raise ValueError(
                    f"line {rows.line_num}: expected {len(names)} fields as the header has names, got {len(row)}"
                )
    except csv.Error as error:
        raise ValueError(f"line {rows.line_num}: {error}") from error
    if not names:
        raise ValueError("expected a header row, got none")
    return names


def _without_empty_end(row: Sequence[str], least: int) -> list[str]:
    cells = list(row)
    while len(cells) > least and not cells[-1].strip():
        cells.pop()
    return cells


def _lines_to_header(text: str) -> int:
    """Number of lines up to the header, itself included; a header that is quoted may go over several."""
    rows = csv.reader(io.StringIO(text, newline=""))
    next(row for row in rows if any(cell.strip() for cell in row))
    return rows.line_num


def spreadsheet_cell(text: str) -> str:
    """Return a text cell that no spreadsheet takes for a formula.

    Spreadsheets run what begins with = + - @, a tab or a carriage return. An apostrophe in front makes it a text. One
    is also put before text that begins with apostrophes and such a sign, so that `spreadsheet_text` gives back the
    same text.

    Parameters
    ----------
    text : str
        The text of a cell. Numbers are not passed here.

    Returns
    -------
    str
        The cell.

    Examples
    --------
    >>> spreadsheet_cell("=1+2"), spreadsheet_cell("a=b"), spreadsheet_cell("'=x")
    ("'=1+2", 'a=b', "''=x")
    """
    return _QUOTE + text if _is_formula(text.lstrip(_QUOTE)) else text


def spreadsheet_text(cell: str) -> str:
    """Return the text that `spreadsheet_cell` was given.

    Parameters
    ----------
    cell : str
        A cell as it is in the file.

    Returns
    -------
    str
        The text.

    Examples
    --------
    >>> spreadsheet_text("'=1+2"), spreadsheet_text("'quoted'")
    ('=1+2', "'quoted'")
    """
    return cell[1:] if cell.startswith(_QUOTE) and _is_formula(cell.lstrip(_QUOTE)) else cell


def _is_formula(text: str) -> bool:
    """Whether text begins as a formula; a sign alone is none."""
    return len(text) > 1 and text.startswith(_FORMULA_SIGNS)
