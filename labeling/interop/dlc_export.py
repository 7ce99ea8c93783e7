"""Exporting a project's labels as a DeepLabCut project: a new folder with config.yaml, images, and labels.

The import is in `dlc.py`. benchmarks/deeplabcut_opens.py opens the result with DeepLabCut itself.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...tracker.project import Project
from ..label_table import LabelRow, format_label_table
from .exporting import (
    ExportReport,
    LabelledVideo,
    copy_images,
    labelled_videos,
    new_folder,
    skeleton_edges,
    warn_of_actuators,
)
from .importing import by_stem


def export_dlc(project: Project, out: str | Path, *, videos: Sequence[str | Path] = ()) -> ExportReport:
    """Write a DeepLabCut project that holds the project's images and labels.

    Images are copied byte for byte, labels keep every digit: importing the result gives the same labels.
    The folder is created as a whole or not at all.

    Parameters
    ----------
    project : Project
        Project whose labels are written.
    out : str or Path
        The DeepLabCut project's folder; must not exist, or be empty.
    videos : sequence of str or Path, optional
        Video files to list in config.yaml; they are not copied. A video that is not given is listed as if it were in
        the new project's videos/. DeepLabCut trains without it.

    Returns
    -------
    ExportReport
        What was written.

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, `out` is not empty, or two videos have one name.
    OSError
        The folder cannot be written.
    """
    out = Path(out)
    report = ExportReport()
    labelled = labelled_videos(project, report)
    warn_of_actuators(labelled, "a DeepLabCut project", report)
    files = by_stem(videos)
    with new_folder(out) as folder:
        (folder / "videos").mkdir()
        video_sets = {}
        for video in labelled:
            _write_labels(project, video, folder / "labeled-data" / video.video, report)
            given = files.get(video.video)
            listed = f"videos/{video.video}.mp4" if given is None else given.resolve().as_posix()
            video_sets[listed] = {"crop": f"0, {video.size_wh[0]}, 0, {video.size_wh[1]}"}
        (folder / "config.yaml").write_text(
            yaml.safe_dump(_config(project, out, video_sets), sort_keys=False, allow_unicode=True),
            encoding="utf-8",
        )
    return report


def _write_labels(project: Project, video: LabelledVideo, folder: Path, report: ExportReport) -> None:
    copy_images(video, folder)
    if not video.table.rows:
        return
    coordinates = [(name, coord) for name in project.keypoints for coord in ("x", "y")]
    rows = [
        LabelRow(row.image, {cell: text for cell, text in row.cells.items() if cell in coordinates})
        for row in video.table.rows
    ]
    scorer = project.settings.scorer
    path = folder / f"CollectedData_{scorer}.csv"
    text = format_label_table(rows, project.keypoints, video.video, scorer)
    path.write_text(text, encoding="utf-8", newline="")
    missing = _write_h5(path.with_suffix(".h5"), rows, project, video.video)
    if missing and missing not in report.warnings:
        report.warnings.append(missing)


def _write_h5(path: Path, rows: list[LabelRow], project: Project, video: str) -> str | None:
    """Write the same labels as DeepLabCut's HDF5; return a warning where PyTables is not installed."""
    try:
        import tables  # noqa: F401
    except ImportError:
        return (
            "PyTables is not installed (the extra dlc-h5), so no .h5 labels were written: "
            "run deeplabcut.convertcsv2h5(config, userfeedback=False) before training there"
        )
    import pandas as pd

    keypoints = list(project.keypoints)
    columns = pd.MultiIndex.from_product(
        [[project.settings.scorer], keypoints, ["x", "y"]], names=["scorer", "bodyparts", "coords"]
    )
    index = pd.MultiIndex.from_tuples([("labeled-data", video, row.image) for row in rows])
    points = [[row.point(name) or (np.nan, np.nan) for name in keypoints] for row in rows]
    values = np.array(points, dtype=np.float64).reshape(len(rows), -1)
    pd.DataFrame(values, index=index, columns=columns).to_hdf(path, key="df_with_missing", mode="w")
    return None


def _config(project: Project, out: Path, video_sets: dict[str, Any]) -> dict[str, Any]:
    """Return DeepLabCut's settings with its default values. It corrects project_path itself in a moved project."""
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
        "skeleton": [list(edge) for edge in skeleton_edges(project)],
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
