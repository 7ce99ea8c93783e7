"""A project's labels as a DeepLabCut project: a new folder with config.yaml, pictures, and labels.

The way back is in `dlc.py`.
"""

from __future__ import annotations

import datetime
import os
import secrets
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...tracker.errors import LabelError
from ...tracker.project import Project
from ...tracker.video import video_stem
from ..label_table import LabelRow, format_label_table
from ..store import LabelStore, image_size_wh


@dataclass
class ExportReport:
    """What an export wrote: numbers of labelled frames and of pictures, and what the user should know."""

    labelled: int = 0
    images: int = 0
    warnings: list[str] = field(default_factory=list)


def export_dlc(project: Project, out: str | Path, *, videos: Sequence[str | Path] = ()) -> ExportReport:
    """Write a DeepLabCut project that holds the project's pictures and labels.

    Pictures are copied byte for byte, labels keep every digit: importing the outcome gives the same labels.
    The folder appears whole or not at all.

    Parameters
    ----------
    project : whose labels
    out : the DeepLabCut project's folder; must not exist, or be empty
    videos : video files to name in config.yaml (they are not copied); one that is not given is named as if it
        lay in the new project's videos/ (DeepLabCut trains without it)

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, `out` has something in it, or two videos have one name.
    OSError
        The folder cannot be written.
    """
    out = Path(out)
    store = LabelStore.of(project)
    frames = store.read()
    if not frames:
        raise LabelError(f"expected labelled frames to export, got none in {project.labels_dir}")
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise LabelError(
            f"expected a new or an empty folder to export to, got one with something in it: {out}"
        )
    report = ExportReport(labelled=len(frames))
    files = by_stem(videos)

    out.parent.mkdir(parents=True, exist_ok=True)
    staging = out.parent / f".{out.name[:40]}.{secrets.token_hex(6)}.tmp"
    try:
        (staging / "videos").mkdir(parents=True)
        video_sets = {}
        for video in store.videos():
            pictures = store.images(video)
            if not pictures:
                continue
            _export_video(store, video, pictures, staging / "labeled-data" / video, report)
            listed = files[video].resolve().as_posix() if video in files else f"videos/{video}.mp4"
            size = image_size_wh(pictures[0])
            if size is None:
                raise LabelError(f"expected a picture, got a file that does not open as one: {pictures[0]}")
            video_sets[listed] = {"crop": f"0, {size[0]}, 0, {size[1]}"}
        (staging / "config.yaml").write_text(
            yaml.safe_dump(_config(project, out, video_sets), sort_keys=False, allow_unicode=True),
            encoding="utf-8",
        )
        if out.is_dir():
            out.rmdir()
        os.replace(staging, out)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise
    return report


def by_stem(videos: Sequence[str | Path]) -> dict[str, Path]:
    """Video files by the name that their labels go by.

    Raises
    ------
    LabelError
        Two files have one name, so that nobody knows whose the labels are.
    """
    files: dict[str, Path] = {}
    for path in map(Path, videos):
        first = files.setdefault(video_stem(path), path)
        if first.resolve() != path.resolve():
            raise LabelError(
                f"expected videos of different names, as labels go by them, got {first} and {path}"
            )
    return files


def _export_video(
    store: LabelStore, video: str, pictures: list[Path], folder: Path, report: ExportReport
) -> None:
    folder.mkdir(parents=True)
    for picture in pictures:
        shutil.copyfile(picture, folder / picture.name)
    report.images += len(pictures)
    table = store.table(video)
    if not table.rows:
        return
    dropped = [name for name in table.bodyparts if name not in store.keypoints]
    if dropped:
        report.warnings.append(f"{video}: labels of {', '.join(dropped)} are no keypoints, not exported")
    coordinates = [(name, coord) for name in store.keypoints for coord in ("x", "y")]
    rows = [
        LabelRow(row.image, {cell: text for cell, text in row.cells.items() if cell in coordinates})
        for row in table.rows
    ]
    name = f"CollectedData_{store.scorer}"
    (folder / f"{name}.csv").write_text(
        format_label_table(rows, store.keypoints, video, store.scorer), encoding="utf-8", newline=""
    )
    missing = _write_h5(folder / f"{name}.h5", rows, store, video)
    if missing and missing not in report.warnings:
        report.warnings.append(missing)


def _write_h5(path: Path, rows: list[LabelRow], store: LabelStore, video: str) -> str | None:
    """The same labels in DeepLabCut's HDF5 form; a warning instead where PyTables is not installed."""
    try:
        import tables  # noqa: F401
    except ImportError:
        return (
            "PyTables is not installed (bendtrack[dlc-h5]), so no .h5 labels were written: "
            "run deeplabcut.convertcsv2h5(config, userfeedback=False) before training there"
        )
    import pandas as pd

    columns = pd.MultiIndex.from_product(
        [[store.scorer], list(store.keypoints), ["x", "y"]], names=["scorer", "bodyparts", "coords"]
    )
    index = pd.MultiIndex.from_tuples([("labeled-data", video, row.image) for row in rows])
    points = [[row.point(name) or (np.nan, np.nan) for name in store.keypoints] for row in rows]
    values = np.array(points, dtype=np.float64).reshape(len(rows), -1)
    pd.DataFrame(values, index=index, columns=columns).to_hdf(path, key="df_with_missing", mode="w")
    return None


def _config(project: Project, out: Path, video_sets: dict[str, Any]) -> dict[str, Any]:
    """DeepLabCut's keys with its default values. It corrects project_path itself when a project is moved."""
    today = datetime.date.today()
    keypoints = list(project.keypoints)
    return {
        "Task": project.root.resolve().name,
        "scorer": project.settings.scorer,
        "date": today.strftime("%b%d"),
        "multianimalproject": False,
        "identity": None,
        "project_path": out.resolve().as_posix(),
        "engine": "pytorch",
        "video_sets": video_sets,
        "bodyparts": keypoints,
        "start": 0,
        "stop": 1,
        "numframes2pick": 20,
        "skeleton": [list(pair) for pair in pairwise(keypoints)],
        "skeleton_color": "black",
        "pcutoff": 0.6,
        "dotsize": 12,
        "alphavalue": 0.7,
        "colormap": "rainbow",
        "TrainingFraction": [0.95],
        "iteration": 0,
        "default_net_type": "resnet_50",
        "default_augmenter": "default",
        "snapshotindex": -1,
        "detector_snapshotindex": -1,
        "batch_size": 8,
        "detector_batch_size": 1,
        "cropping": False,
        "x1": 0,
        "x2": 640,
        "y1": 0,
        "y2": 480,
        "corner2move2": [50, 50],
        "move2corner": True,
    }
