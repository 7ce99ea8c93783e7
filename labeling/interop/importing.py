"""Importing a foreign project: images are copied, labels checked, and everything that is left out is reported.

Each format is read in its own file; the format is detected in `formats.py`.
"""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path

from ...tracker.atomic import atomic_write_bytes
from ...tracker.errors import LabelError, ProjectError
from ...tracker.links import make_folder
from ...tracker.project import SETTINGS_FILE, Project
from ...tracker.project_settings import DEFAULT_ACTUATOR
from ...tracker.video import Video, video_stem
from ..label_table import LabelRow, Point
from ..notes_file import read_notes, write_notes
from ..store import IMAGE_SUFFIXES, LabelStore, encoded_size_wh, frame_index, image_size_wh, merge_row
from ..video_record import remember_video
from .source import ReadImage, Source, SourceVideo


@dataclass
class ImportReport:
    """Outcome of an import.

    Attributes
    ----------
    videos : int
        Number of videos with labels in the source.
    labelled : int
        Number of frames whose labels were new or completed.
    unchanged : int
        Number of frames whose labels were in the project already.
    images : int
        Number of images copied, or extracted from a video.
    unlabelled : int
        Number of images without labels, copied so that they can be labelled.
    skipped : list of str
        What was left out, "<video>/<image>: <reason>" each.
    warnings : list of str
        Warnings about what was imported, one line each.
    """

    videos: int = 0
    labelled: int = 0
    unchanged: int = 0
    images: int = 0
    unlabelled: int = 0
    skipped: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def summary(self) -> str:
        """Return one line to show."""
        return (
            f"{self.labelled} labelled frames imported, {self.unchanged} already there, "
            f"{self.images} images copied, {self.unlabelled} have no labels, {len(self.skipped)} left out"
        )


def project_of(root: str | Path, source: Source) -> Project:
    """Open the project to import into; where there is none, create it with the source's keypoints and scorer.

    Parameters
    ----------
    root : str or Path
        Folder of the project.
    source : Source
        The labels to import.

    Returns
    -------
    Project
        The project.

    Raises
    ------
    ProjectError
        The folder holds something else, or the source's names are not valid keypoints.
    """
    if (Path(root) / SETTINGS_FILE).exists():
        return Project.open(root)
    try:
        return Project.create(root, keypoints=source.keypoints, scorer=source.scorer)
    except ProjectError as error:
        raise ProjectError(f"cannot create a project from {source.path}: {error}") from error


def import_source(
    source: Source,
    project: Project,
    *,
    videos: Sequence[str | Path] = (),
    overwrite: bool = False,
) -> ImportReport:
    """Import the images and labels of a foreign project.

    Importing again changes nothing. Where the source contradicts a frame's labels in the project, the whole frame
    stays as it is and is reported, unless `overwrite`. A point that the project's frame lacks is added.

    Parameters
    ----------
    source : Source
        The images and labels to import.
    project : Project
        The project that gets them.
    videos : sequence of str or Path, optional
        Video files. An image that the source lacks is decoded from the video of the same stem, at the frame index in
        the image's name.
    overwrite : bool, optional
        Replace labels and images of the project that differ.

    Returns
    -------
    ImportReport
        What was imported, and what was left out.

    Raises
    ------
    LabelError
        None of the source's names is a keypoint of the project, or two of `videos` have one name.
    VideoError
        One of `videos` cannot be read.
    OSError
        The project cannot be written.
    """
    store = LabelStore.of(project)
    report = ImportReport(
        videos=len(source.videos), warnings=list(source.warnings), skipped=list(source.skipped)
    )
    _compare_keypoints(source, project.keypoints, report)
    files = by_stem(videos)
    for name in files.keys() - {video.video for video in source.videos}:
        report.warnings.append(f"{files[name].name}: no labels are named after this video")
    for video in source.videos:
        _import_video(video, files.get(video.video) or video.file, store, overwrite, report)
        _assign_actuator(video, project, report)
    return report


def by_stem(videos: Sequence[str | Path]) -> dict[str, Path]:
    """Return video files by their stem, which their labels are named after.

    Parameters
    ----------
    videos : sequence of str or Path
        Video files.

    Returns
    -------
    dict of str to Path
        Stem -> video file.

    Raises
    ------
    LabelError
        Two files have one stem, so their labels are ambiguous.
    """
    files: dict[str, Path] = {}
    for path in map(Path, videos):
        first = files.setdefault(video_stem(path), path)
        if first.resolve() != path.resolve():
            raise LabelError(
                f"expected videos of different names, as labels go by them, got {first} and {path}"
            )
    return files


def _compare_keypoints(source: Source, keypoints: tuple[str, ...], report: ImportReport) -> None:
    unknown = [name for name in source.keypoints if name not in keypoints]
    if len(unknown) == len(source.keypoints):
        raise LabelError(
            f"{source.path}: expected labels of the project's keypoints {', '.join(keypoints)}, "
            f"got {', '.join(unknown) or 'none'}"
        )
    for name in unknown:
        close = difflib.get_close_matches(name, keypoints, n=1)
        hint = f" (did someone mean '{close[0]}'?)" if close else ""
        report.warnings.append(f"'{name}' is no keypoint of the project{hint}: its labels are kept, not used")
    for name in keypoints:
        if name not in source.keypoints:
            report.warnings.append(f"keypoint '{name}' is not labelled in the source")


def _import_video(
    source: SourceVideo, video: Path | None, store: LabelStore, overwrite: bool, report: ImportReport
) -> None:
    rows = _distinct(source, report)
    images = source.images
    target = store.labels_dir / source.video
    extractable = {} if video is None else {name: i for name in rows if (i := frame_index(name)) is not None}
    extractable = {name: i for name, i in extractable.items() if name not in images}
    for name in [name for name in rows if name not in images and name not in extractable]:
        report.skipped.append(f"{source.video}/{name}: no such image in {source.where}")
        del rows[name]

    sizes = _sizes(source.video, images, report)
    if extractable and video is not None:
        sizes |= _extract(video, extractable, source.video, store, report)
    sizes = _of_one_size(source.video, sizes, store, report)
    for name in [name for name in sizes if name in images]:
        if not _copy(images[name](), target / name, overwrite, source.video, report):
            del sizes[name]
    report.unlabelled += sum(not (name in rows and rows[name].cells) for name in sizes)

    changes: dict[str, Mapping[str, Point | None]] = {}
    present = {row.image: row for row in store.table(source.video).rows}
    for name, row in rows.items():
        if name in sizes:
            points = _points_inside(row, source.video, sizes[name], report)
            _merge(name, points, present.get(name), source.video, overwrite, changes, report)
    if changes:
        store.write_points(source.video, changes)
    notes = read_notes(target) if source.not_visible else {}
    for name, hidden in source.not_visible.items():
        if name in sizes and not notes.get(name, {}).get("not_visible"):
            write_notes(target, name, {"not_visible": list(hidden)})


def _distinct(source: SourceVideo, report: ImportReport) -> dict[str, LabelRow]:
    """Return rows by image. Of rows that contradict each other the first counts; the others are reported."""
    rows: dict[str, LabelRow] = {}
    for row in source.rows:
        try:
            rows[row.image] = merge_row(rows[row.image], row) if row.image in rows else row
        except LabelError as error:
            report.skipped.append(f"{source.video}/{row.image}: {error}")
    frames: dict[int, str] = {}
    for image in rows:
        index = frame_index(image)
        if index is not None and frames.setdefault(index, image) != image:
            report.warnings.append(f"{source.video}: {frames[index]} and {image} name the same frame")
    return rows


def _sizes(video: str, images: Mapping[str, ReadImage], report: ImportReport) -> dict[str, tuple[int, int]]:
    """Return (width, height) in px of the images that can be decoded."""
    sizes = {}
    for name, read in images.items():
        size = encoded_size_wh(read())
        if size is None:
            report.skipped.append(f"{video}/{name}: expected an image, got a file that does not open as one")
        elif not name.lower().endswith(IMAGE_SUFFIXES):
            kinds = ", ".join(IMAGE_SUFFIXES)
            report.skipped.append(f"{video}/{name}: expected an image of one of the kinds {kinds}")
        else:
            sizes[name] = size
    return sizes


def _extract(
    path: Path, wanted: Mapping[str, int], video: str, store: LabelStore, report: ImportReport
) -> dict[str, tuple[int, int]]:
    """Save the wanted frames that the project lacks, in one pass over the video; return the sizes of all."""
    reader = Video(path)
    missing = {n: i for n, i in wanted.items() if not (store.labels_dir / video / n).is_file()}
    sizes = {name: reader.size_wh for name in wanted if name not in missing}
    count, last = 0, max(missing.values(), default=-1)
    with closing(iter(reader)) as frames:
        for frame in frames if missing else ():
            count = frame.index + 1
            for name in [name for name, index in missing.items() if index == frame.index]:
                if frame.image is not None:
                    store.add_image(video, name, frame.image)
                    sizes[name] = reader.size_wh
                    report.images += 1
            if count > last:
                break
    if (store.labels_dir / video).is_dir():
        remember_video(store.labels_dir / video, path)
    for name, index in missing.items():
        if name not in sizes:
            reason = f"has {count} frames" if index >= count else "cannot be decoded there"
            report.skipped.append(f"{video}/{name}: expected frame {index}, but {path.name} {reason}")
    return sizes


def _of_one_size(
    video: str, sizes: dict[str, tuple[int, int]], store: LabelStore, report: ImportReport
) -> dict[str, tuple[int, int]]:
    """Return the images of the video's size: that of the project's images, or else the most common one."""
    if not sizes:
        return sizes
    expected = Counter(sizes.values()).most_common(1)[0][0]
    for path in store.images(video)[:1]:
        expected = image_size_wh(path) or expected
    for name, (width, height) in sizes.items():
        if (width, height) != expected:
            report.skipped.append(
                f"{video}/{name}: expected {expected[0]} x {expected[1]} px as other images of this video, "
                f"got {width} x {height}"
            )
    return {name: size for name, size in sizes.items() if size == expected}


def _copy(data: bytes, target: Path, overwrite: bool, video: str, report: ImportReport) -> bool:
    """Copy an image byte for byte; return False where the project has another one of that name, which stays."""
    if target.is_file():
        if target.read_bytes() == data:
            return True
        if not overwrite:
            report.skipped.append(f"{video}/{target.name}: the project has another image of that name, kept")
            return False
    make_folder(target.parent)
    atomic_write_bytes(target, data)
    report.images += 1
    return True


def _points_inside(
    row: LabelRow, video: str, size_wh: tuple[int, int], report: ImportReport
) -> dict[str, Point]:
    """Return the row's points that are numbers inside the image, which starts 0.5 px before the first centre."""
    points = {}
    for bodypart in dict.fromkeys(part for part, _ in row.cells):
        try:
            point = row.point(bodypart)
        except LabelError as error:
            report.skipped.append(f"{video}/{row.image}: {error}")
            continue
        if point is None:
            continue
        if not all(-0.5 <= value <= size - 0.5 for value, size in zip(point, size_wh, strict=True)):
            report.skipped.append(
                f"{video}/{row.image}: expected '{bodypart}' inside the {size_wh[0]} x {size_wh[1]} px, "
                f"got ({point[0]:g}, {point[1]:g})"
            )
            continue
        points[bodypart] = point
    return points


def _merge(
    image: str,
    points: Mapping[str, Point],
    present: LabelRow | None,
    video: str,
    overwrite: bool,
    changes: dict[str, Mapping[str, Point | None]],
    report: ImportReport,
) -> None:
    """Decide which labels of a frame to write, given those of the project; fills `changes` and `report`."""
    known = {name: present.point(name) for name in points} if present else {}
    conflicting = [name for name, point in points.items() if known.get(name) not in (None, point)]
    if conflicting and not overwrite:
        report.skipped.append(
            f"{video}/{image}: labelled otherwise in the project ({', '.join(conflicting)}), kept"
        )
    elif any(known.get(name) != point for name, point in points.items()):
        changes[image] = points
        report.labelled += 1
    elif points:
        report.unchanged += 1


def _assign_actuator(source: SourceVideo, project: Project, report: ImportReport) -> None:
    """List a video under the source's actuator, unless the project's settings name one."""
    listed = project.actuator_of(source.video)
    if source.actuator is None or source.actuator == listed:
        return
    if listed != DEFAULT_ACTUATOR:
        report.warnings.append(
            f"{source.video}: actuator '{listed}' in the project, '{source.actuator}' in the source; kept"
        )
        return
    try:
        project.assign_actuator(source.actuator, [source.video])
    except ProjectError as error:
        report.warnings.append(f"{source.video}: left to the actuator '{listed}': {error}")
