"""Exporting a project to a foreign format: the parts that all formats share.

What each format writes is in its own file.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from ...tracker.errors import LabelError
from ...tracker.links import make_folder, refuse_links
from ...tracker.project import Project
from ...tracker.types import FloatArray
from ..label_table import LabelTable
from ..store import LabelStore, image_size_wh


@dataclass
class ExportReport:
    """Outcome of an export.

    Attributes
    ----------
    labelled : int
        Number of labelled frames.
    images : int
        Number of images.
    warnings : list of str
        Warnings, one line each.
    """

    labelled: int = 0
    images: int = 0
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class LabelledVideo:
    """One video's images and labels, to be written in any format.

    Attributes
    ----------
    video : str
        Stem of the video.
    actuator : str
        The actuator that it shows.
    images : tuple of Path
        All images, labelled or not, in the order of their frames.
    table : LabelTable
        Its rows, merged over the label files.
    xy : dict of str to ndarray of float
        Image name -> (K, 2) px in the order of the project's keypoints, NaN where not labelled; no row, no
        entry.
    size_wh : tuple of int
        (width, height) of the first image, px.
    """

    video: str
    actuator: str
    images: tuple[Path, ...]
    table: LabelTable
    xy: dict[str, FloatArray]
    size_wh: tuple[int, int]


def labelled_videos(project: Project, report: ExportReport) -> list[LabelledVideo]:
    """Collect everything to export.

    Parameters
    ----------
    project : Project
        The project.
    report : ExportReport
        Gets the counts, and warnings of what cannot be exported.

    Returns
    -------
    list of LabelledVideo
        The videos with images, by stem.

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, or an image does not open.
    """
    store = LabelStore.of(project)
    frames = store.read()
    if not frames:
        raise LabelError(f"expected labelled frames to export, got none in {project.labels_dir}")
    report.labelled = len(frames)
    videos = []
    for video in store.videos():
        images = tuple(store.images(video))
        if not images:
            continue
        size_wh = image_size_wh(images[0])
        if size_wh is None:
            raise LabelError(f"expected an image, got a file that does not open as one: {images[0]}")
        table = store.table(video)
        dropped = [name for name in table.bodyparts if name not in store.keypoints]
        if dropped:
            report.warnings.append(f"{video}: labels of {', '.join(dropped)} are no keypoints, not exported")
        xy = {frame.image_path.name: frame.xy for frame in frames if frame.video == video}
        videos.append(LabelledVideo(video, project.actuator_of(video), images, table, xy, size_wh))
        report.images += len(images)
    return videos


def skeleton_edges(project: Project) -> list[tuple[str, str]]:
    """Return the edges between neighbouring keypoints along the actuator, base to tip."""
    return list(pairwise(project.keypoints))


def warn_of_actuators(videos: list[LabelledVideo], target: str, report: ExportReport) -> None:
    """Warn that a format cannot store which video shows which actuator, where there are several actuators.

    Parameters
    ----------
    videos : list of LabelledVideo
        The videos to export.
    target : str
        Name of the foreign project, such as "a DeepLabCut project".
    report : ExportReport
        Gets the warning.
    """
    actuators = sorted({video.actuator for video in videos})
    if len(actuators) > 1:
        report.warnings.append(
            f"{target} cannot store which video shows which actuator ({', '.join(actuators)}): "
            "keep bendtrack.toml"
        )


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Yield a temporary folder to fill; it is renamed to `out` when the block ends without an error.

    Parameters
    ----------
    out : Path
        The final folder; must not exist, or be empty.

    Yields
    ------
    Path
        The temporary folder.

    Raises
    ------
    LabelError
        `out` is not empty.
    OSError
        The folder cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise LabelError(
            f"expected a new or an empty folder to export to, got one with something in it: {out}"
        )
    refuse_links(out)
    make_folder(out.parent)
    staging = out.parent / f".{out.name[:40]}.{secrets.token_hex(6)}.tmp"
    try:
        staging.mkdir()
        yield staging
        if out.is_dir():
            out.rmdir()
        os.replace(staging, out)
    except BaseException:
        shutil.rmtree(staging, ignore_errors=True)
        raise


def copy_images(video: LabelledVideo, folder: Path) -> None:
    """Copy all images of a video, byte for byte, to a new folder."""
    folder.mkdir(parents=True)
    for path in video.images:
        shutil.copyfile(path, folder / path.name)
