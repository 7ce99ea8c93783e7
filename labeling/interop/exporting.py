"""Out of our project into a foreign one: what every format's export has in common.

Each format's own file says what it writes.
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
from ...tracker.project import Project
from ...tracker.types import FloatArray
from ..label_table import LabelTable
from ..store import LabelStore, image_size_wh


@dataclass
class ExportReport:
    """What an export wrote: numbers of labelled frames and of pictures, and what the user should know."""

    labelled: int = 0
    images: int = 0
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class LabelledVideo:
    """One video's pictures and labels, ready to be written in any form.

    Attributes
    ----------
    video : stem
    actuator : which it shows
    pictures : all of them, labelled or not, in the order of their frames
    table : its rows merged over the label files
    xy : image name -> (K, 2) px in the order of the project's keypoints, NaN where not labelled; no row, no entry
    size_wh : of the first picture, px
    """

    video: str
    actuator: str
    pictures: tuple[Path, ...]
    table: LabelTable
    xy: dict[str, FloatArray]
    size_wh: tuple[int, int]


def labelled_videos(project: Project, report: ExportReport) -> list[LabelledVideo]:
    """Everything that there is to export; the report gets the counts and what cannot go out.

    Raises
    ------
    LabelError
        Nothing is labelled, the labels are malformed, or a picture does not open.
    """
    store = LabelStore.of(project)
    frames = store.read()
    if not frames:
        raise LabelError(f"expected labelled frames to export, got none in {project.labels_dir}")
    report.labelled = len(frames)
    videos = []
    for video in store.videos():
        pictures = tuple(store.images(video))
        if not pictures:
            continue
        size_wh = image_size_wh(pictures[0])
        if size_wh is None:
            raise LabelError(f"expected a picture, got a file that does not open as one: {pictures[0]}")
        table = store.table(video)
        dropped = [name for name in table.bodyparts if name not in store.keypoints]
        if dropped:
            report.warnings.append(f"{video}: labels of {', '.join(dropped)} are no keypoints, not exported")
        xy = {frame.image_path.name: frame.xy for frame in frames if frame.video == video}
        videos.append(LabelledVideo(video, project.actuator_of(video), pictures, table, xy, size_wh))
        report.images += len(pictures)
    return videos


def skeleton_edges(project: Project) -> list[tuple[str, str]]:
    """Neighbours along the actuator, base to tip: what other programs draw lines between."""
    return list(pairwise(project.keypoints))


def warn_of_actuators(videos: list[LabelledVideo], form: str, report: ExportReport) -> None:
    """Say that a form has no place for which video shows which actuator, where there is more than one."""
    actuators = sorted({video.actuator for video in videos})
    if len(actuators) > 1:
        report.warnings.append(
            f"{form} has no place for which video shows which actuator ({', '.join(actuators)}): "
            "keep bendtrack.toml"
        )


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Yield a folder to fill; it becomes `out` when the block ends well, whole or not at all.

    Raises
    ------
    LabelError
        `out` has something in it.
    OSError
        The folder cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise LabelError(
            f"expected a new or an empty folder to export to, got one with something in it: {out}"
        )
    out.parent.mkdir(parents=True, exist_ok=True)
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


def copy_pictures(video: LabelledVideo, folder: Path) -> None:
    """All pictures of a video, byte for byte, into a new folder."""
    folder.mkdir(parents=True)
    for picture in video.pictures:
        shutil.copyfile(picture, folder / picture.name)
