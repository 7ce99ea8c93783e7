"""Angle tables of a study: bendtrack's own, a plain CSV of time_s and angle_deg, or looked up by the video's name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..csv_tables import read_csv_table
from ..errors import ResultsError, StudyError, reason
from ..hashing import file_sha256
from ..project import SETTINGS_FILE
from ..results import MAX_FLAG_CHARS, AngleTable, read_record, read_results
from ..types import Flag, FloatArray
from ..video import video_stem

_OWN_HEADER = "frame,time_s,angle_deg,angle_sd_deg,flag"
_TABLES = (".h5", ".csv", ".json")
_LONGEST_HEADER = 2**17


@dataclass(frozen=True)
class Angles:
    """Angles over time, gaps as NaN.

    Attributes
    ----------
    time_s : ndarray of float
        (T,) rising.
    angle_deg, angle_sd_deg : ndarray of float
        (T,) degrees, NaN in gaps; the sd also where the table has none.
    warnings : tuple of str
        Warnings, a line each.
    provenance : dict of str to Any
        JSON-ready.
    """

    time_s: FloatArray
    angle_deg: FloatArray
    angle_sd_deg: FloatArray
    warnings: tuple[str, ...]
    provenance: dict[str, Any]


def read_angles(path: str | Path, keep_flagged: Sequence[str] = ()) -> Angles:
    """Read an angle table: .csv, .h5 or .json of `bendtrack track`, or a CSV with columns time_s and angle_deg.

    A plain CSV may also have angle_sd_deg and flag; its fields are separated by commas, or by semicolons with decimal
    commas. Flagged rows become gaps, except for the flags in `keep_flagged`.

    Parameters
    ----------
    path : str or Path
        The angle table.
    keep_flagged : sequence of str, optional
        Flags of rows whose angle is used.

    Returns
    -------
    Angles
        The angles, with gaps as NaN.

    Raises
    ------
    ResultsError
        Missing, malformed, or no row with an angle.
    """
    path = Path(path)
    if path.suffix == ".csv" and path.is_file() and not _own_csv(path):
        time_s, angle, sd, flag, provenance = _plain_csv(path)
    else:
        table = read_results(path)
        time_s, angle, sd, flag = table.time_s, table.angle_deg.copy(), table.angle_sd_deg.copy(), table.flag
        provenance = _of_table(table)
    warnings = [f"video: {warning}" for warning in provenance.get("tracking", {}).get("warnings", [])]
    for kind in sorted(set(flag) - {Flag.NONE.value}):
        rows = flag == kind
        if kind in keep_flagged:
            warnings.append(f"angles: {rows.sum()} of {len(rows)} rows are flagged {kind} and were kept")
        else:
            angle[rows] = sd[rows] = np.nan
            warnings.append(f"angles: {rows.sum()} of {len(rows)} rows are flagged {kind}: gaps")
    unflagged = int((np.isnan(angle) & (flag == Flag.NONE.value)).sum())
    if unflagged:
        warnings.append(f"angles: {unflagged} of {len(angle)} rows have no angle: gaps")
    # Times must rise: resampling needs a unique time for each frame.
    rises = time_s > np.concatenate([[-np.inf], np.fmax.accumulate(time_s)[:-1]])
    if not rises.all():
        warnings.append(f"angles: {(~rises).sum()} rows whose time does not rise were left out")
        time_s, angle, sd = time_s[rises], angle[rises], sd[rises]
    if np.isfinite(angle).sum() < 2:
        raise ResultsError(f"{path}: expected angles, got {np.isfinite(angle).sum()} rows with one")
    return Angles(
        time_s, angle, sd, tuple(warnings), {"name": path.name, "sha256": file_sha256(path), **provenance}
    )


def find_table(results: Path, video: Path) -> Path:
    """The angle table of a video in a folder of results, or in a project's.

    Where several videos of that name were tracked, the video's SHA-256 decides.

    Parameters
    ----------
    results : Path
        Folder of results, or of a project.
    video : Path
        The video file, which need not exist.

    Returns
    -------
    Path
        Path of the table.

    Raises
    ------
    StudyError
        No such folder, no table, or several tables that may be the video's.
    """
    folder = results / "results" if (results / SETTINGS_FILE).is_file() else results
    if not folder.is_dir():
        raise StudyError(f"expected a folder of results, got none: {folder}")
    stem = video_stem(video)
    name = re.compile(re.escape(stem) + r"(-[0-9a-f]{8,64})?")
    found: dict[str, Path] = {}
    for suffix in _TABLES:
        for path in sorted(folder.glob(f"*{suffix}")):
            if name.fullmatch(path.stem):
                found.setdefault(path.stem, path)
    if not found:
        raise StudyError(
            f"{folder}: expected an angle table of {video.name} ({stem}.csv, .h5 or .json), found none"
        )
    if len(found) > 1:
        own = file_sha256(video) if video.is_file() else None
        found = {key: path for key, path in found.items() if own is not None and _video_of(path) == own}
        if len(found) != 1:
            raise StudyError(
                f"{folder}: expected one angle table of {video.name}, found several; name it with angles = ..."
            )
    return next(iter(found.values()))


def _video_of(table: Path) -> str | None:
    try:
        video = read_record(table.with_suffix(".json")).get("video")
    except ResultsError:
        return None
    return video.get("sha256") if isinstance(video, dict) else None


def _own_csv(path: Path) -> bool:
    with open(path, encoding="utf-8-sig", errors="replace") as file:
        return file.readline(_LONGEST_HEADER).startswith(_OWN_HEADER)


def _of_table(table: AngleTable) -> dict[str, Any]:
    definition = None if table.definition is None else table.definition.name
    return {"rows": len(table), "definition": definition, "tracking": dict(table.provenance)}


def _plain_csv(
    path: Path,
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.str_], dict[str, Any]]:
    try:
        with open(path, encoding="utf-8-sig") as file:
            has_semicolons = ";" in file.readline(_LONGEST_HEADER)
        frame = read_csv_table(path, *((";", ",") if has_semicolons else (",", ".")))
    except (OSError, ValueError, OverflowError) as error:
        raise ResultsError(f"{path}: cannot be read as a CSV ({reason(error)})") from error
    if not {"time_s", "angle_deg"} <= set(frame.columns):
        raise ResultsError(
            f"{path}: expected columns time_s and angle_deg (and perhaps angle_sd_deg, flag), "
            f"got {', '.join(map(str, frame.columns))[:200]}"
        )
    numbers = {}
    for column in ("time_s", "angle_deg", "angle_sd_deg"):
        values = frame[column] if column in frame else pd.Series(np.nan, index=frame.index)
        try:
            numbers[column] = values.to_numpy(dtype=float, na_value=np.nan).copy()
        except (TypeError, ValueError, OverflowError) as error:
            raise ResultsError(
                f"{path}: column {column}: expected numbers or empty cells ({reason(error)})"
            ) from error
    flag = pd.Series("", index=frame.index, dtype=object)
    if "flag" in frame:
        flag = frame["flag"].astype(object).where(frame["flag"].notna(), "").astype(str)
    longest = int(flag.str.len().max()) if len(flag) else 0
    if longest > MAX_FLAG_CHARS:
        raise ResultsError(f"{path}: expected flags of at most {MAX_FLAG_CHARS} characters, got {longest}")
    return (
        numbers["time_s"],
        numbers["angle_deg"],
        numbers["angle_sd_deg"],
        flag.to_numpy(dtype=np.str_),
        {"rows": len(frame)},
    )
