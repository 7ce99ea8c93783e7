"""DeepLabCut's CollectedData CSV: parsing and formatting of one file's text, cell by cell.

Where such files are and what they mean for a project is in `store.py`. They are read with the csv module: pandas loses
an empty first row and does not keep the cells' text.

The file has three header rows (scorer, bodyparts, coords), then a row for every image. One column names the image in
older files (`labeled-data/<video>/img005.png`), three do in newer ones (`labeled-data`, `<video>`, `img005.png`). An
empty cell is a point that is not labelled.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..tracker.errors import LabelError

_HEADERS = ("scorer", "bodyparts", "coords")
_EMPTY = frozenset(("", "nan", "na", "n/a", "null", "none", "<na>"))

Point = tuple[float, float]
Cell = tuple[str, str]  # (body part, coordinate): x, y, or a column of another program


@dataclass(frozen=True)
class LabelRow:
    """One image's row.

    Attributes
    ----------
    image : str
        File name of the image.
    cells : mapping of Cell to str
        (body part, coordinate) -> text as it is in the file; empty cells are left out.
    video : str or None
        Name of the video's folder according to the row, None where it names none.
    where : str
        File and line, for messages.
    """

    image: str
    cells: Mapping[Cell, str]
    video: str | None = None
    where: str = ""

    def point(self, bodypart: str) -> Point | None:
        """Return the position of a body part.

        Parameters
        ----------
        bodypart : str
            Its name.

        Returns
        -------
        Point or None
            (x, y) px, None where it is not labelled.

        Raises
        ------
        LabelError
            A cell is not a finite number, or one of x and y is missing.
        """
        x, y = (self._number(bodypart, coord) for coord in ("x", "y"))
        if x is None and y is None:
            return None
        if x is None or y is None:
            found, missing = ("y", "x") if x is None else ("x", "y")
            raise LabelError(
                f"{self.where}, column {bodypart}: expected x and y, got {found} without {missing}"
            )
        return (x, y)

    def _number(self, bodypart: str, coord: str) -> float | None:
        text = self.cells.get((bodypart, coord))
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise LabelError(
                f"{self.where}, column {bodypart} {coord}: expected a number of px, got '{text}'"
            )
        return value

    def with_points(self, points: Mapping[str, Point | None]) -> LabelRow:
        """Return the row with some points changed. Cells that keep their value keep their text.

        Parameters
        ----------
        points : mapping of str to Point or None
            Body part -> (x, y) px, None to remove it.

        Returns
        -------
        LabelRow
            The changed row.
        """
        cells = dict(self.cells)
        for bodypart, point in points.items():
            for coord, value in zip(("x", "y"), point or (None, None), strict=True):
                cell = (bodypart, coord)
                if value is None:
                    cells.pop(cell, None)
                elif cell not in cells or self._number(bodypart, coord) != value:
                    cells[cell] = repr(float(value))  # the shortest text that reads back as the same float
        return LabelRow(self.image, cells, self.video, self.where)


@dataclass(frozen=True)
class LabelTable:
    """The rows of one or more label files.

    Attributes
    ----------
    bodyparts : tuple of str
        Names of the body parts, in order of appearance.
    rows : tuple of LabelRow
        The rows.
    """

    bodyparts: tuple[str, ...] = ()
    rows: tuple[LabelRow, ...] = field(default=())


def read_label_table(path: Path, scorer: str | None = None) -> LabelTable:
    """Read a CollectedData CSV in the older or the newer form.

    Parameters
    ----------
    path : Path
        The file.
    scorer : str or None, optional
        Scorer whose columns are preferred where a file has several scorers.

    Returns
    -------
    LabelTable
        Its rows and body parts.

    Raises
    ------
    LabelError
        The file has another format, a row is too short or too long, or two scorers disagree about a point.
    """
    try:
        # utf-8-sig: spreadsheets write a byte order mark.
        text = path.read_bytes().decode("utf-8-sig")
        if "\0" in text:  # no name of a file can hold it
            raise LabelError(f"{path}: expected a CSV file in UTF-8, got a byte of value 0")
        lines = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise LabelError(f"{path}: expected a CSV file in UTF-8, got {error}") from error
    heads = tuple(line[0].strip() if line else "" for line in lines[:3])
    if heads[:2] == ("scorer", "individuals"):
        raise LabelError(f"{path}: expected labels of one animal or actuator, got a multi-animal file")
    if heads != _HEADERS:
        raise LabelError(
            f"{path}: expected a label file whose first rows begin with scorer, bodyparts, coords, "
            f"got {', '.join(repr(head[:30]) for head in heads) or 'an empty file'}"
        )
    first = 1
    while first < len(lines[2]) and not lines[2][first].strip():
        first += 1  # in the newer form, two more columns name the image
    if not len(lines[0]) == len(lines[1]) == len(lines[2]):
        raise LabelError(
            f"{path}: expected header rows of one length, got {[len(line) for line in lines[:3]]}"
        )
    columns = [tuple(cell.strip() for cell in column) for column in zip(*lines[:3], strict=True)][first:]

    rows = []
    for number, line in enumerate(lines[3:], start=4):
        if not any(cell.strip() for cell in line):
            continue
        where = f"{path} line {number}"
        if len(line) != len(lines[0]):
            raise LabelError(f"{where}: expected {len(lines[0])} cells, got {len(line)}")
        cells_of_name = (cell.strip().replace("\\", "/") for cell in line[:first])
        name = [part for cell in cells_of_name for part in cell.split("/") if part not in ("", ".")]
        if not name or ".." in name:
            raise LabelError(f"{where}: expected the name of an image, got '{'/'.join(name)}'")
        cells = _cells(columns, line[first:], scorer, where)
        rows.append(LabelRow(name[-1], cells, name[-2] if len(name) > 1 else None, where))
    return LabelTable(tuple(dict.fromkeys(bodypart for _, bodypart, _ in columns)), tuple(rows))


def format_label_table(rows: Iterable[LabelRow], bodyparts: Iterable[str], video: str, scorer: str) -> str:
    """Format a CollectedData CSV in the newer form, which needs no path separator.

    DeepLabCut 3 writes this form and reads both.

    Parameters
    ----------
    rows : iterable of LabelRow
        The rows, in the order of the file.
    bodyparts : iterable of str
        Body parts, in the order of the columns.
    video : str
        Name of the video's folder.
    scorer : str
        Name of the scorer.

    Returns
    -------
    str
        The file's text.
    """
    rows = list(rows)
    extra = dict.fromkeys(cell for row in rows for cell in row.cells if cell[1] not in ("x", "y"))
    columns = [
        (bodypart, coord)
        for bodypart in bodyparts
        for coord in ("x", "y", *(coord for part, coord in extra if part == bodypart))
    ]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for head, names in zip(
        _HEADERS,
        ([scorer] * len(columns), *zip(*columns, strict=True)) if columns else ([], [], []),
        strict=True,
    ):
        writer.writerow([head, "", "", *names])
    for row in rows:
        writer.writerow(
            ["labeled-data", video, row.image, *(row.cells.get(column, "") for column in columns)]
        )
    return text.getvalue()


def same_number(first: str, second: str) -> bool:
    """Whether two cells hold the same text or number: 12.50 and 12.5 do."""
    try:
        return first == second or float(first) == float(second)
    except ValueError:
        return False


def _cells(
    columns: list[tuple[str, ...]], texts: list[str], scorer: str | None, where: str
) -> dict[Cell, str]:
    """Return the cells of a row that are not empty. The preferred scorer's count; others may only add or agree."""
    cells: dict[Cell, str] = {}
    pairs = sorted(zip(columns, texts, strict=True), key=lambda pair: pair[0][0] != scorer)
    owner: dict[Cell, str] = {}
    for (by, bodypart, coord), text in pairs:
        text = text.strip()
        if text.lower() in _EMPTY:
            continue
        cell = (bodypart, coord)
        if not same_number(cells.setdefault(cell, text), text) and owner[cell] != scorer:
            raise LabelError(
                f"{where}, column {bodypart} {coord}: expected one value, "
                f"got {cells[cell]} by {owner[cell]} and {text} by {by}"
            )
        owner.setdefault(cell, by)
    return cells
