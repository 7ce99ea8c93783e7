"""Every table of a study's results as a CSV file: tidy, one header row, units in the column names, full precision."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from ..atomic import atomic_path
from ..csv_tables import spreadsheet_cell
from ..errors import ResultsError, reason


def write_csv_tables(tables: Mapping[str, pd.DataFrame], folder: str | Path) -> list[Path]:
    """Write each table to `folder`/<name>.csv, whole or not at all; NaN is an empty cell.

    Text that a spreadsheet would run as a formula gets an apostrophe in front (see `csv_tables.spreadsheet_cell`).

    Parameters
    ----------
    tables : mapping of str to DataFrame
        Tables by name.
    folder : str or Path
        An existing folder.

    Returns
    -------
    list of Path
        Paths of the files.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    paths = []
    for name, table in tables.items():
        path = Path(folder) / f"{name}.csv"
        try:
            with atomic_path(path) as temporary:
                cells = table.map(_as_cell)
                cells.columns = [spreadsheet_cell(str(column)) for column in cells.columns]
                cells.to_csv(temporary, index=False, lineterminator="\n", encoding="utf-8")
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({reason(error)})") from error
        paths.append(path)
    return paths


def _as_cell(value: Any) -> Any:
    """Several numbers in one cell are separated by spaces, which any language can split; texts are no formulas."""
    if isinstance(value, str):
        return spreadsheet_cell(value)
    return " ".join(map(str, value)) if isinstance(value, tuple) else value
