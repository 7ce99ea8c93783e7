"""Importing and exporting Lightning Pose's labels: one CSV for all videos next to labeled-data/, and project.yaml.

The CSV is DeepLabCut's with one column for the image's path. Optionally each keypoint has a third column, `visible`
(documented since version 2.4): 0 not labelled, 1 hidden, 2 visible. Positions are used as they are. Lightning Pose
reads DeepLabCut's labels without conversion, and their (0, 0) is the centre of the top-left pixel.

A hidden point is one that a person has marked as not visible. Lightning Pose ignores its position. It corresponds to
`not_visible` in the notes.
"""

from __future__ import annotations

import csv
import io
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml

from ...tracker.errors import LabelError
from ...tracker.project import Project
from ..label_table import LabelRow, read_label_table
from ..notes_file import read_notes
from .exporting import (
    ExportReport,
    LabelledVideo,
    copy_images,
    labelled_videos,
    new_folder,
    warn_of_actuators,
)
from .source import ImageFinder, Source, SourceVideo

_VISIBLE = "visible"
_NOT_LABELLED, _HIDDEN, _SEEN = "0", "1", "2"
_FILE = "CollectedData.csv"


# --- in --------------------------------------------------------------------------------------------------


def label_csvs(folder: Path) -> list[Path]:
    """Return the CSV files of a folder, without subfolders, that start like label files."""
    return [path for path in sorted(folder.glob("*.csv")) if _begins_as_labels(path)]


def has_visible_column(path: Path) -> bool:
    """Whether a CSV has Lightning Pose's `visible` columns."""
    with path.open("rb") as file:
        heads = [file.readline(1 << 16) for _ in range(3)]
    return heads[2].startswith(b"coords") and _VISIBLE.encode() in heads[2].strip().split(b",")


def _begins_as_labels(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(16).removeprefix(b"\xef\xbb\xbf").startswith(b"scorer,")


def open_lightning_pose(path: str | Path, images: str | Path | None = None) -> Source:
    """Read a Lightning Pose project, all of its views, or one label CSV.

    Parameters
    ----------
    path : str or Path
        The project's folder or a CSV.
    images : str, Path or None, optional
        Folder of the images; None looks next to the CSV.

    Returns
    -------
    Source
        The images and labels.

    Raises
    ------
    LabelError
        There are no labels, or a CSV is malformed.
    """
    path = Path(path)
    files = label_csvs(path) if path.is_dir() else [path]
    if not files:
        raise LabelError(f"{path}: expected labels of Lightning Pose ({_FILE}), got none")
    folder = path if path.is_dir() else path.resolve().parent
    finder = ImageFinder([Path(images)] if images is not None else [folder])
    keypoints: dict[str, None] = {}
    by_video: dict[str, list[LabelRow]] = defaultdict(list)
    for file in files:
        table = read_label_table(file)
        keypoints |= dict.fromkeys(table.bodyparts)
        for row in table.rows:
            by_video[row.video or folder.resolve().name].append(row)
    skipped: list[str] = []
    videos = tuple(_video(video, rows, finder, skipped) for video, rows in by_video.items())
    if not videos:
        raise LabelError(f"{path}: expected labelled frames, got none")
    return Source(path, tuple(keypoints), None, videos, (), tuple(skipped))


def _video(video: str, rows: Sequence[LabelRow], finder: ImageFinder, skipped: list[str]) -> SourceVideo:
    images, labels, hidden = {}, [], {}
    for row in rows:
        try:
            found = finder.find(f"labeled-data/{video}/{row.image}")
        except LabelError as error:
            skipped.append(f"{video}/{row.image}: {error}")
            continue
        if found is not None:
            images[row.image] = found.read_bytes
        cells, hidden_here = _visible_cells(row, skipped)
        labels.append(LabelRow(row.image, cells, video, row.where))
        if hidden_here:
            hidden[row.image] = hidden_here
    return SourceVideo(video, tuple(labels), images, finder.where, not_visible=hidden)


def _visible_cells(
    row: LabelRow, skipped: list[str]
) -> tuple[Mapping[tuple[str, str], str], tuple[str, ...]]:
    """Return the cells of the visible points, and the keypoints that are hidden."""
    cells = {cell: text for cell, text in row.cells.items() if cell[1] != _VISIBLE}
    hidden = []
    for (name, coord), text in row.cells.items():
        if coord != _VISIBLE or text.removesuffix(".0") == _SEEN:
            continue
        if text.removesuffix(".0") not in (_NOT_LABELLED, _HIDDEN):
            skipped.append(f"{row.where}, column {name} {_VISIBLE}: expected 0, 1 or 2, got '{text}'")
        elif text.removesuffix(".0") == _HIDDEN:
            hidden.append(name)
        for axis in ("x", "y"):
            cells.pop((name, axis), None)
    return cells, tuple(hidden)


# --- out -------------------------------------------------------------------------------------------------


def export_lightning_pose(project: Project, out: str | Path) -> ExportReport:
    """Write a Lightning Pose project: project.yaml, CollectedData.csv, labeled-data/, and videos/ to fill.

    Images are copied byte for byte, positions keep every digit: importing the result gives the same labels.
    `visible` columns are written where a keypoint is marked as not visible. The folder is created as a whole or not
    at all.

    Parameters
    ----------
    project : Project
        Project whose labels are written.
    out : str or Path
        Folder of the new project; must not exist, or be empty.

    Returns
    -------
    ExportReport
        What was written.

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, or `out` is not empty.
    OSError
        The folder cannot be written.
    """
    report = ExportReport()
    videos = labelled_videos(project, report)
    warn_of_actuators(videos, "a Lightning Pose project", report)
    notes = {video.video: read_notes(project.labels_dir / video.video) for video in videos}
    with new_folder(Path(out)) as folder:
        (folder / "videos").mkdir()
        for video in videos:
            copy_images(video, folder / "labeled-data" / video.video)
        settings = {"view_names": [], "keypoint_names": list(project.keypoints)}
        (folder / "project.yaml").write_text(
            yaml.safe_dump(settings, sort_keys=False, allow_unicode=True), encoding="utf-8"
        )
        hidden = {
            (video.video, image, name)
            for video in videos
            for image in video.xy
            for name in notes[video.video].get(image, {}).get("not_visible", [])
        }
        (folder / _FILE).write_text(_csv(project, videos, hidden), encoding="utf-8", newline="")
    return report


def _csv(project: Project, videos: Sequence[LabelledVideo], hidden: set[tuple[str, str, str]]) -> str:
    coords = ("x", "y", _VISIBLE) if hidden else ("x", "y")
    columns = [(name, coord) for name in project.keypoints for coord in coords]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["scorer", *[project.settings.scorer] * len(columns)])
    writer.writerow(["bodyparts", *(name for name, _ in columns)])
    writer.writerow(["coords", *(coord for _, coord in columns)])
    for video in videos:
        for image, xy in video.xy.items():
            cells = []
            for name, (x, y) in zip(project.keypoints, xy.tolist(), strict=True):
                placed = not np.isnan(x)
                cells += [repr(x), repr(y)] if placed else ["", ""]
                if hidden:
                    unseen = _HIDDEN if (video.video, image, name) in hidden else _NOT_LABELLED
                    cells.append(_SEEN if placed else unseen)
            writer.writerow([f"labeled-data/{video.video}/{image}", *cells])
    return text.getvalue()
