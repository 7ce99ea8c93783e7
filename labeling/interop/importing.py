"""From a foreign project into ours: pictures copied, labels checked, all that is left out said.

How each format is read is in its own file; which format it is, in `formats.py`.
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
from ...tracker.project import SETTINGS_FILE, Project
from ...tracker.project_settings import DEFAULT_ACTUATOR
from ...tracker.video import Video, video_stem
from ..label_table import LabelRow, Point
from ..side_data import read_notes, write_notes
from ..store import IMAGE_SUFFIXES, LabelStore, frame_index, image_size_wh, merge_row, picture_size_wh
from .source import ReadPicture, Source, SourceVideo


@dataclass
class ImportReport:
    """What an import did.

    Attributes
    ----------
    videos : number of videos with labels in the source
    labelled : frames whose labels were new or completed
    unchanged : frames whose labels were in the project already, the same
    images : pictures copied, or extracted from a video
    unlabelled : pictures without any label, copied too so that they can be labelled
    skipped : what was left out, "<video>/<image>: <reason>" each
    warnings : what was taken and is worth a look
    """

    videos: int = 0
    labelled: int = 0
    unchanged: int = 0
    images: int = 0
    unlabelled: int = 0
    skipped: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def summary(self) -> str:
        """One line for people."""
        return (
            f"{self.labelled} labelled frames imported, {self.unchanged} already there, "
            f"{self.images} pictures copied, {self.unlabelled} have no labels, {len(self.skipped)} left out"
        )


def project_of(root: str | Path, source: Source) -> Project:
    """Open the project to import into; where there is none, create it with the source's keypoints and scorer.

    Raises
    ------
    ProjectError
        The folder holds something else, or the source's names cannot be keypoints of a project.
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
    """Take over the pictures and labels of a foreign project.

    Importing again changes nothing. Labels of the project that the source contradicts stay (the whole frame)
    and are reported, unless `overwrite`; a point that the project's frame lacks is filled in.

    Parameters
    ----------
    source : what there is
    videos : video files; a picture that the source lacks is decoded from the video of the same stem, at the
        frame that the picture's name tells
    overwrite : let the source's labels and pictures win

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
    pictures = source.pictures
    target = store.labels_dir / source.video
    extractable = {} if video is None else {name: i for name in rows if (i := frame_index(name)) is not None}
    extractable = {name: i for name, i in extractable.items() if name not in pictures}
    for name in [name for name in rows if name not in pictures and name not in extractable]:
        report.skipped.append(f"{source.video}/{name}: no such picture in {source.where}")
        del rows[name]

    sizes = _sizes(source.video, pictures, report)
    if extractable and video is not None:
        sizes |= _extract(video, extractable, source.video, store, report)
    sizes = _of_one_size(source.video, sizes, store, report)
    for name in [name for name in sizes if name in pictures]:
        if not _copy(pictures[name](), target / name, overwrite, source.video, report):
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
    """Rows by image. Of rows that contradict each other the first counts, the others are reported."""
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


def _sizes(
    video: str, pictures: Mapping[str, ReadPicture], report: ImportReport
) -> dict[str, tuple[int, int]]:
    """(width, height) of the pictures that open."""
    sizes = {}
    for name, read in pictures.items():
        size = picture_size_wh(read())
        if size is None:
            report.skipped.append(f"{video}/{name}: expected a picture, got a file that does not open as one")
        elif not name.lower().endswith(IMAGE_SUFFIXES):
            kinds = ", ".join(IMAGE_SUFFIXES)
            report.skipped.append(f"{video}/{name}: expected a picture of one of the kinds {kinds}")
        else:
            sizes[name] = size
    return sizes


def _extract(
    path: Path, wanted: Mapping[str, int], video: str, store: LabelStore, report: ImportReport
) -> dict[str, tuple[int, int]]:
    """Save the wanted frames that the project lacks, in one pass over the video; sizes of all it then has."""
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
    for name, index in missing.items():
        if name not in sizes:
            reason = f"has {count} frames" if index >= count else "cannot be decoded there"
            report.skipped.append(f"{video}/{name}: expected frame {index}, but {path.name} {reason}")
    return sizes


def _of_one_size(
    video: str, sizes: dict[str, tuple[int, int]], store: LabelStore, report: ImportReport
) -> dict[str, tuple[int, int]]:
    """Only the pictures of the video's size: that of the project's pictures, or else the most common one."""
    if not sizes:
        return sizes
    expected = Counter(sizes.values()).most_common(1)[0][0]
    for path in store.images(video)[:1]:
        expected = image_size_wh(path) or expected
    for name, (width, height) in sizes.items():
        if (width, height) != expected:
            report.skipped.append(
                f"{video}/{name}: expected {expected[0]} x {expected[1]} px as other pictures of this video, "
                f"got {width} x {height}"
            )
    return {name: size for name, size in sizes.items() if size == expected}


def _copy(data: bytes, target: Path, overwrite: bool, video: str, report: ImportReport) -> bool:
    """Copy a picture byte for byte; False where the project has another one of that name, which stays."""
    if target.is_file():
        if target.read_bytes() == data:
            return True
        if not overwrite:
            report.skipped.append(
                f"{video}/{target.name}: the project has another picture of that name, kept"
            )
            return False
    target.parent.mkdir(parents=True, exist_ok=True)
    atomic_write_bytes(target, data)
    report.images += 1
    return True


def _points_inside(
    row: LabelRow, video: str, size_wh: tuple[int, int], report: ImportReport
) -> dict[str, Point]:
    """The row's points that are numbers and lie in the picture (from half a px before the first centre)."""
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
    """Decide what becomes of a frame's labels, given what the project has for it."""
    known = {name: present.point(name) for name in points} if present else {}
    against = [name for name, point in points.items() if known.get(name) not in (None, point)]
    if against and not overwrite:
        report.skipped.append(
            f"{video}/{image}: labelled otherwise in the project ({', '.join(against)}), kept"
        )
    elif any(known.get(name) != point for name, point in points.items()):
        changes[image] = points
        report.labelled += 1
    elif points:
        report.unchanged += 1


def _assign_actuator(source: SourceVideo, project: Project, report: ImportReport) -> None:
    """List a video under the actuator that the source names; what the project's settings say stays."""
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
