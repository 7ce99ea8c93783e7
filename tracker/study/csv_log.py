"""Text tables of any make to columns: delimiter, decimal comma, header, units and written dates are detected.

The meaning of the columns is determined in `log_columns.py` and `pressure_log.py`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd

from ..errors import PressureLogError, reason
from ..types import FloatArray
from .log_columns import LogColumn
from .units import known_unit, split_unit

_DELIMITERS = ("\t", ";", ",", "|", " ")
# Lines of a header that loggers put before the table; a table begins within them.
_HEAD_LINES = 100
_SAMPLE_LINES = 50
# Characters of a field that may be a number or a date.
_LONGEST_VALUE = 400
# Names in a message.
_SHOWN_CHARS = 300
_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_CLOCK = re.compile(
    r"(\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}[T ]+)?\d{1,2}:\d{2}(:\d{2})?([.,]\d+)?\s*(Z|[+-]\d{2}:?\d{2})?"
)
_CLOCK_FORMATS = (
    *("ISO8601", "%d.%m.%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f"),
    *("%d-%m-%Y %H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f", "%Y.%m.%d %H:%M:%S.%f"),
)

_TICKS_PER_S = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


@dataclass(frozen=True)
class _Layout:
    """Layout of a text table: delimiter, decimal sign, first line of numbers, fields per line."""

    delimiter: str
    decimal: str
    first: int
    n_fields: int


def csv_columns(path: Path) -> tuple[list[LogColumn], list[str]]:
    """Columns of a text table, and warnings about what was worked around.

    Delimiter (tab, semicolon, comma, bar, blanks) and decimal sign are chosen so that most fields are numbers.
    The line before the first line of numbers holds the names; where that line holds only units, the one before it.
    Without a header the columns are called "1", "2", ...

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    columns : list of LogColumn
        Columns with a name or a number in them.
    warnings : list of str
        A line each.

    Raises
    ------
    PressureLogError
        Not a text, no table in it, or a table that can be read in two ways.
    """
    lines = _text(path).splitlines()
    layout = _layout(lines, path)
    names, units = _header(lines, layout, path)
    cells, warnings = _cells(lines, layout, path)
    columns = []
    for position, (name, unit) in enumerate(zip(names, units, strict=True)):
        column, warning = _column(name, unit, cells[position], layout)
        if warning:
            warnings.append(warning)
        columns.append(replace(column, number=position + 1))
    return [c for c in columns if c.name or np.isfinite(c.values).any()], warnings


def _text(path: Path) -> str:
    data = path.read_bytes()
    if not data.strip():
        raise PressureLogError(f"{path}: expected a table, got an empty file")
    for encoding in ("utf-16",) if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("utf-8-sig", "cp1252"):
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise PressureLogError(f"{path}: expected a text table or a MATLAB file, got something else")


def _fields(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return [field.strip() for field in line.split(delimiter)]
    try:
        return [field.strip() for field in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:  # a quoted field of more than 128 KiB is no value
        return [field.strip() for field in line.split(delimiter)]


def _is_number(field: str, decimal: str) -> bool:
    text = field if decimal == "." else field.replace(",", ".", 1)
    return len(text) <= _LONGEST_VALUE and bool(_NUMBER.fullmatch(text))


def _is_clock(field: str) -> bool:
    return len(field) <= _LONGEST_VALUE and bool(_CLOCK.fullmatch(field))


def _layout(lines: Sequence[str], path: Path) -> _Layout:
    """The layout by which most fields of the first lines are numbers or dates, and the fewest anything else."""
    best: tuple[tuple[int, int], _Layout] | None = None
    for delimiter in _DELIMITERS:
        for decimal in (".",) if delimiter == "," else (".", ","):
            found = _first_line(lines, delimiter, decimal)
            if found is None:
                continue
            first, n_fields = found
            good = bad = 0
            sample = [
                _fields(line, delimiter) for line in lines[first : first + _SAMPLE_LINES] if line.strip()
            ]
            for fields in sample:
                parsed = [_is_number(f, decimal) or _is_clock(f) for f in fields if f]
                good += sum(parsed)
                bad += len(parsed) - sum(parsed)
            score = (good - 2 * bad, -first)
            if best is None or score > best[0]:
                best = score, _Layout(delimiter, decimal, first, n_fields)
    if best is None:
        raise PressureLogError(f"{path}: expected a table of numbers, found no line of numbers")
    return best[1]


def _first_line(lines: Sequence[str], delimiter: str, decimal: str) -> tuple[int, int] | None:
    """Index of the first line that holds numbers as the next one does, and its number of fields."""

    def shape(line: str) -> tuple[int, bool]:
        fields = _fields(line, delimiter)
        return len(fields), any(_is_number(f, decimal) for f in fields)

    filled = [(n, shape(line)) for n, line in enumerate(lines[: _HEAD_LINES + 2]) if line.strip()]
    for (n, (n_fields, is_numbers)), (_, following) in pairwise(filled):
        if is_numbers and following == (n_fields, True) and not lines[n].lstrip().startswith("#"):
            return n, n_fields
    return None


def _header(lines: Sequence[str], layout: _Layout, path: Path) -> tuple[list[str], list[str | None]]:
    above = [line for line in lines[: layout.first] if line.strip()][-2:]
    rows = [_fields(re.sub(r"^\s*[#%]+\s*", "", line), layout.delimiter) for line in above]
    # Names that contain blanks, over columns separated by blanks, may have another delimiter.
    if layout.delimiter == " " and above and len(rows[-1]) != layout.n_fields:
        rows[-1] = next((f for d in "\t;,|" if len(f := _fields(above[-1], d)) == layout.n_fields), rows[-1])
    if not rows:
        return [str(n) for n in range(1, layout.n_fields + 1)], [None] * layout.n_fields
    # A trailing delimiter adds an empty field, in the header or in the rows.
    for row in rows:
        while len(row) > layout.n_fields and not row[-1]:
            row.pop()
    names = rows[-1]
    if len(names) == layout.n_fields - 1 and not _fields(lines[layout.first], layout.delimiter)[-1]:
        names = [*names, ""]
    if len(names) != layout.n_fields:
        if len(rows[-1]) == 1:  # a remark, not a header
            return [str(n) for n in range(1, layout.n_fields + 1)], [None] * layout.n_fields
        raise PressureLogError(
            f"{path}: expected as many fields in the rows as names in the header, "
            f"got {layout.n_fields} and {len(names)} ({', '.join(names)[:_SHOWN_CHARS]})"
        )
    written = [known_unit(re.sub(r"[\[\](){}]", "", name)) for name in names]
    if (
        len(rows) == 2
        and len(rows[0]) == layout.n_fields
        and all(unit or not name for unit, name in zip(written, names, strict=True))
    ):
        return rows[0], written
    both = [split_unit(name) for name in names]
    return [name for name, _ in both], [unit for _, unit in both]


def _cells(lines: Sequence[str], layout: _Layout, path: Path) -> tuple[pd.DataFrame, list[str]]:
    """The cells under the header as pandas reads them, and a warning about lines that do not fit."""
    body = list(filter(None, lines[layout.first :]))
    try:
        cells = pd.read_csv(
            io.StringIO("\n".join(body)),
            header=None,
            # One column more than expected, which catches lines that are too long.
            names=list(range(layout.n_fields + 1)),
            index_col=False,
            sep=r"\s+" if layout.delimiter == " " else layout.delimiter,
            decimal=layout.decimal,
            skipinitialspace=True,
            on_bad_lines="skip",
            low_memory=False,
        )
    except (ValueError, OverflowError, csv.Error) as error:
        raise PressureLogError(f"{path}: cannot be read as a table ({reason(error)})") from error
    # Many loggers end each line with a delimiter; that last field is empty.
    long = cells[layout.n_fields].notna()
    n_bad = len(body) - len(cells) + int(long.sum())
    warnings = []
    if n_bad:
        warnings.append(f"{n_bad} of {len(body)} lines have too many fields and were left out")
    short = _short_lines(body, layout) if len(cells) == len(body) else []
    if short and layout.delimiter == " ":
        # Which column is missing cannot be told, so the others may stand in the wrong ones.
        long.iloc[short] = True
        warnings.append(f"{len(short)} of {len(body)} lines have too few fields and were left out")
    elif short:
        warnings.append(
            f"{len(short)} of {len(body)} lines have too few fields; the last ones are taken as empty"
        )
    return cells.loc[~long].reset_index(drop=True), warnings


def _short_lines(body: Sequence[str], layout: _Layout) -> list[int]:
    """Numbers of the lines with too few fields, the delimiter at the end of a line not counted."""
    least = layout.n_fields
    if any('"' in line for line in body):
        return []  # a quoted field may hold delimiters and go over several lines
    if layout.delimiter == " ":
        return [number for number, line in enumerate(body) if len(line.split()) < least]
    if body and body[0].rstrip().endswith(layout.delimiter):
        least -= 1
    return [number for number, line in enumerate(body) if line.count(layout.delimiter) < least - 1]


def _column(name: str, unit: str | None, cells: pd.Series, layout: _Layout) -> tuple[LogColumn, str | None]:
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        return LogColumn(name, unit, cells.to_numpy(dtype=float)), None
    text = cells.astype("str").str.strip()
    filled = cells.notna().to_numpy() & (text != "").to_numpy()
    if filled.any() and text[filled].head(_SAMPLE_LINES).map(_is_clock).mean() > 0.5:
        values, is_clock = _seconds(text), True
    else:
        if layout.decimal == ",":
            text = text.str.replace(",", ".", n=1)
        text = text.replace({"True": "1", "False": "0", "TRUE": "1", "FALSE": "0", "ON": "1", "OFF": "0"})
        values, is_clock = pd.to_numeric(text, errors="coerce").to_numpy(dtype=float), False
    lost = filled & ~np.isfinite(values) & ~text.str.lower().isin(["nan", "inf", "-inf"]).to_numpy()
    warning = None
    if lost.any() and not lost[filled].all():  # a column of text is not of interest
        what = "dates" if is_clock else "numbers"
        warning = (
            f"column '{name}': {lost.sum()} cells are no {what}, the first '{text[int(lost.argmax())][:40]}'"
        )
    return LogColumn(name, unit, values, is_clock), warning


def _seconds(text: pd.Series) -> FloatArray:
    """Seconds since 1970 of written dates, or since midnight of times of day; NaN where it cannot be read."""
    text = text.str.replace(r"(:\d{2}),(\d+)", r"\1.\2", regex=True)
    if not text.str.contains(r"\d[-/.]\d{1,2}[-/.]\d").any():
        parts = text.str.extract(r"^(?:(?P<h>\d+):)?(?P<min>\d+):(?P<s>\d+(?:\.\d+)?)$").astype(float)
        short = parts["h"].isna().all() & (text.str.count(":") == 1).all() & ~text.str.contains(r"\.").any()
        if short:  # 14:05 is a time of day without seconds
            return (60 * (60 * parts["min"] + parts["s"])).to_numpy(dtype=float)
        return (3600 * parts["h"].fillna(0) + 60 * parts["min"] + parts["s"]).to_numpy(dtype=float)
    best = np.full(len(text), np.nan)
    with_fraction = text.where(
        text.str.contains(r":\d{2}\.\d+"), text.str.replace(r"(:\d{2})$", r"\1.0", regex=True)
    )
    for date_format in _CLOCK_FORMATS:
        source = text if date_format == "ISO8601" else with_fraction
        stamps = pd.to_datetime(source, format=date_format, errors="coerce", utc=True)
        known = stamps.notna().to_numpy()
        if known.sum() > np.isfinite(best).sum():
            # Not by a difference of dates, which pandas limits to the years 1678 to 2261.
            ticks = stamps.astype("int64").to_numpy() / _TICKS_PER_S[stamps.dt.unit]
            best = np.where(known, ticks, np.nan)
    return best
