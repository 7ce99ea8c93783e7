"""Reading a DeepLabCut project, a labeled-data folder or a label file.

Importing what was read is in `importing.py`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...tracker.errors import LabelError
from ..label_table import LabelRow, LabelTable, read_label_table
from ..store import images_in, label_files
from .pandas_hdf5 import read_pandas_table
from .source import Source, SourceVideo, checked_name
from .yaml_files import read_yaml

# The folders that DeepLabCut's check_labels fills with images on which the labels are drawn.
_DRAWN_SUFFIX = "_labeled"


def open_dlc(path: str | Path) -> Source:
    """Read a DeepLabCut project, a folder with labeled-data/, such a folder itself, or a label file.

    Parameters
    ----------
    path : str or Path
        The folder or file.

    Returns
    -------
    Source
        Its images and labels.

    Raises
    ------
    LabelError
        The path is none of these, or it has no labels, is a multi-animal project, or holds a malformed file.
    """
    path = Path(path)
    if path.is_file():
        table = _read(path, None)
        by_video: dict[str, list[LabelRow]] = defaultdict(list)
        for row in table.rows:
            by_video[row.video or path.resolve().parent.name].append(row)
        videos = [_video(video, _images_folder(path, video), rows) for video, rows in by_video.items()]
        return _checked(Source(path, table.bodyparts, None, tuple(videos)))
    if not path.is_dir():
        raise LabelError(
            f"expected a DeepLabCut project or a labels folder, got no such file or folder: {path}"
        )
    config = _read_config(path / "config.yaml")
    scorer = config.get("scorer")
    bodyparts: dict[str, None] = dict.fromkeys(config.get("bodyparts") or ())
    videos, warnings = [], []
    for folder in _label_folders(path):
        files = sorted(_h5_or_csv(folder), key=lambda file: file.stem != f"CollectedData_{scorer}")
        if not files:
            if not folder.name.endswith(_DRAWN_SUFFIX):
                warnings.append(f"{folder.name}: no CollectedData file in it, nothing imported")
            continue
        tables = [_read(file, scorer) for file in files]
        for table in tables:
            bodyparts |= dict.fromkeys(table.bodyparts)
        videos.append(_video(folder.name, folder, [row for table in tables for row in table.rows]))
    return _checked(Source(path, tuple(bodyparts), scorer, tuple(videos), tuple(warnings)))


def _video(video: str, folder: Path, rows: Sequence[LabelRow]) -> SourceVideo:
    images = {path.name: path.read_bytes for path in images_in(folder)}
    return SourceVideo(video, tuple(rows), images, str(folder))


def _checked(source: Source) -> Source:
    if not source.videos:
        raise LabelError(
            f"{source.path}: expected labels (labeled-data/<video>/CollectedData_<scorer>.csv), got none"
        )
    return source


def _label_folders(path: Path) -> list[Path]:
    if (path / "labeled-data").is_dir():
        path = path / "labeled-data"
    elif _h5_or_csv(path):
        return [path]
    return sorted(folder for folder in path.iterdir() if folder.is_dir() and not folder.name.startswith("."))


def _h5_or_csv(folder: Path) -> list[Path]:
    """Return the label files of a folder; an .h5 file only where its CSV is missing."""
    csvs = label_files(folder)
    lone = [file for file in folder.glob("CollectedData_*.h5") if file.with_suffix(".csv") not in csvs]
    return [*csvs, *sorted(lone)]


def _images_folder(label_file: Path, video: str) -> Path:
    """Return the folder of a label file's images: its own, or one in labeled-data/ next to it."""
    parent = label_file.resolve().parent
    return parent if parent.name == video else parent / "labeled-data" / video


def _read_config(path: Path) -> dict[str, Any]:
    if not path.is_file():
        return {}
    config = read_yaml(path)
    if not isinstance(config, dict):
        raise LabelError(
            f"{path}: expected the settings of a DeepLabCut project, got {type(config).__name__}"
        )
    if config.get("multianimalproject"):
        raise LabelError(f"{path}: expected a project of one actuator a frame, got a multi-animal project")
    bodyparts = config.get("bodyparts")
    if bodyparts is not None and not (
        isinstance(bodyparts, list) and all(isinstance(b, str) for b in bodyparts)
    ):
        raise LabelError(f"{path}: expected bodyparts to be a list of names, got {repr(bodyparts)[:60]}")
    scorer = config.get("scorer")
    return {**config, "scorer": None if scorer is None else str(scorer)}


def _read(path: Path, scorer: str | None) -> LabelTable:
    return read_h5_table(path) if path.suffix == ".h5" else read_label_table(path, scorer)


def read_h5_table(path: Path) -> LabelTable:
    """Read the labels of DeepLabCut's .h5, which is a pandas table written by PyTables. Nothing in it is unpickled.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    LabelTable
        Its rows and body parts.

    Raises
    ------
    LabelError
        The file is not one of DeepLabCut's, or holds a pickle of anything but names.
    """
    table = read_pandas_table(path)
    if table.names != ("scorer", "bodyparts", "coords"):
        raise LabelError(f"{path}: expected columns of scorer, bodyparts and coords, got another table")
    rows = []
    for number, (index, values) in enumerate(zip(table.index, table.values.tolist(), strict=True), start=1):
        parts = (part for text in index for part in checked_name(text).replace("\\", "/").split("/"))
        name = [part for part in parts if part not in ("", ".")]
        if not name or ".." in name:
            raise LabelError(f"{path} row {number}: expected the name of an image, got '{'/'.join(name)}'")
        cells = {
            (body_part, coordinate): repr(value)
            for (_, body_part, coordinate), value in zip(table.columns, values, strict=True)
            if not math.isnan(value)
        }
        rows.append(LabelRow(name[-1], cells, name[-2] if len(name) > 1 else None, f"{path} row {number}"))
    return LabelTable(tuple(dict.fromkeys(part for _, part, _ in table.columns)), tuple(rows))
