"""What may be wrong with labels: found by comparing them with the pictures and with each other.

Only looks; nothing is mended. The form of the files is checked where they are read (`store.py`).
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations, permutations
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np

from ..tracker.errors import LabelError
from ..tracker.project import Project
from ..tracker.types import FloatArray, LabelledFrame
from .label_shape import LEAST_FRAMES, LabelShape, fit_shape
from .side_data import read_notes
from .store import LabelStore

# Two points of one frame closer than this are one click counted twice.
_ONE_PLACE_PX = 1.0
# A label is suspect when it lies so many standard deviations, and so many px, from where the others put it.
_FAR_SD = 7.0
_FAR_PX = 6.0
# Another order of a frame's points is the right one when it lies so much nearer to the others.
_NEARER = 3.0
# Videos in which the first two points lie within this part of the body's length of each other are seen alike.
_SAME_VIEW = 0.06
# Of more points only the exchange of two and the reverse order are tried.
_ALL_ORDERS = 5


class Problem(StrEnum):
    """What a finding is about."""

    MISSING = "missing point"
    OUTSIDE = "point outside"
    ONE_PLACE = "points at one place"
    SAME_PICTURE = "same picture"
    SWAPPED = "swapped points"
    SEGMENT = "segment length"
    OUTLIER = "outlier"


@dataclass(frozen=True)
class Finding:
    """Something to look at.

    Attributes
    ----------
    video, image : which frame
    image_path : its picture
    problem : what it is about
    message : what is odd, for people
    keypoints : the points concerned
    """

    video: str
    image: str
    image_path: Path
    problem: Problem
    message: str
    keypoints: tuple[str, ...] = ()

    @property
    def link(self) -> str:
        """What opens the frame when put behind the label page's address."""
        return f"#{quote(self.video)}/{quote(self.image)}"


@dataclass(frozen=True)
class CheckReport:
    """What came of checking labels.

    Attributes
    ----------
    labelled : number of labelled frames
    findings : in the order of the frames
    notes : what could not be checked, a line each
    """

    labelled: int
    findings: list[Finding]
    notes: list[str]


def check_labels(project: Project) -> CheckReport:
    """Look for mistakes in a project's labels.

    A point is compared with where the other labels of its actuator put it, by a robust fit (see `label_shape`), once
    there are `LEAST_FRAMES` of them that were filmed from one place. Points marked as not visible are not missed,
    frames that are skipped are passed over.

    Raises
    ------
    LabelError
        Labels that cannot be read, or none at all.
    """
    store = LabelStore.of(project)
    remarks = {video: read_notes(store.labels_dir / video) for video in store.videos()}
    frames = [
        frame
        for frame in store.read()
        if not remarks[frame.video].get(frame.image_path.name, {}).get("skipped")
    ]
    if not frames:
        raise LabelError(f"{project.root}: expected labelled frames to check, got none")
    names = project.keypoints
    pictures = {frame.image_path: _read_picture(frame.image_path) for frame in frames}
    findings: list[Finding] = []
    for frame in frames:
        unseen = remarks[frame.video].get(frame.image_path.name, {}).get("not_visible", [])
        findings += _in_itself(frame, pictures[frame.image_path], names, unseen)
    findings += _same_pictures(frames, pictures)
    notes = []
    for actuator, group in _views(frames):
        complete = sum(bool(np.isfinite(frame.xy).all()) for frame in group)
        if complete < LEAST_FRAMES:
            videos = ", ".join(sorted({frame.video for frame in group}))
            notes.append(
                f"{actuator} ({videos}): {complete} frames with all points, fewer than {LEAST_FRAMES}: "
                "not compared with each other"
            )
            continue
        shape = fit_shape(np.stack([frame.xy for frame in group]))
        for frame in group:
            findings += _against(shape, frame, names)
    place = {frame.image_path: number for number, frame in enumerate(frames)}
    findings.sort(key=lambda finding: place[finding.image_path])
    return CheckReport(len(frames), findings, notes)


def _finding(frame: LabelledFrame, problem: Problem, message: str, keypoints: Sequence[str] = ()) -> Finding:
    return Finding(frame.video, frame.image_path.name, frame.image_path, problem, message, tuple(keypoints))


@dataclass(frozen=True)
class _Picture:
    size_wh: tuple[int, int]
    digest: bytes  # of its pixels, whatever format they are kept in


def _read_picture(path: Path) -> _Picture:
    image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise LabelError(f"{path}: expected a picture, got a file that does not open as one")
    return _Picture((image.shape[1], image.shape[0]), hashlib.sha256(image.tobytes()).digest())


def _in_itself(
    frame: LabelledFrame, picture: _Picture, names: Sequence[str], unseen: Sequence[str]
) -> Iterator[Finding]:
    """What a frame's own picture and points tell."""
    placed = np.isfinite(frame.xy).all(axis=1)
    missing = [name for name, there in zip(names, placed, strict=True) if not there and name not in unseen]
    if missing:
        yield _finding(frame, Problem.MISSING, f"{', '.join(missing)} not labelled", missing)
    width, height = picture.size_wh
    for name, (x, y) in zip(names, frame.xy, strict=True):
        if x < -0.5 or y < -0.5 or x > width - 0.5 or y > height - 0.5:
            message = f"{name} at ({x:.1f}, {y:.1f}) lies outside the picture of {width} x {height} px"
            yield _finding(frame, Problem.OUTSIDE, message, [name])
    for first, second in combinations(np.flatnonzero(placed), 2):
        away = float(np.linalg.norm(frame.xy[first] - frame.xy[second]))
        if away < _ONE_PLACE_PX:
            pair = names[first], names[second]
            yield _finding(frame, Problem.ONE_PLACE, f"{pair[0]} and {pair[1]} are {away:.1f} px apart", pair)


def _same_pictures(frames: Sequence[LabelledFrame], pictures: Mapping[Path, _Picture]) -> Iterator[Finding]:
    """Frames whose picture has been labelled before, under another name."""
    first: dict[bytes, LabelledFrame] = {}
    for frame in frames:
        other = first.setdefault(pictures[frame.image_path].digest, frame)
        if other is not frame:
            message = f"the same picture as {other.video}/{other.image_path.name}, which is labelled too"
            yield _finding(frame, Problem.SAME_PICTURE, message)


def _views(frames: Sequence[LabelledFrame]) -> Iterator[tuple[str, list[LabelledFrame]]]:
    """Frames of one actuator filmed from one place, by where its fixed end lies; with the actuator's name."""
    videos: dict[tuple[str, str], list[LabelledFrame]] = defaultdict(list)
    for frame in frames:
        videos[frame.actuator, frame.video].append(frame)
    groups: list[tuple[str, FloatArray, list[LabelledFrame]]] = []
    for (actuator, _), members in videos.items():
        points = np.stack([frame.xy for frame in members])
        with np.errstate(invalid="ignore"):
            base = _median(points[:, :2].mean(axis=1))
            body = _median(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1))
        for name, place, group in groups:
            if name == actuator and np.linalg.norm(place - base) <= _SAME_VIEW * body:
                group += members
                break
        else:
            groups.append((actuator, base, list(members)))
    for name, _, group in groups:
        yield name, group


def _median(values: FloatArray) -> FloatArray:
    """Median over the first axis of what is known, NaN where nothing is."""
    known = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]
    return np.asarray(np.median(known, axis=0) if len(known) else np.full(values.shape[1:], np.nan))


def _against(shape: LabelShape, frame: LabelledFrame, names: Sequence[str]) -> Iterator[Finding]:
    """What comparing a frame with the curve through all labels tells."""
    far = _far_points(shape, frame.xy)
    if far.any():
        order = _better_order(shape, frame.xy)
        if order is not None:
            yield _swapped(frame, names, order)
            return
    expected = shape.curve[shape.best(frame.xy)]
    told = set()
    for point in np.flatnonzero(far):
        away = float(np.linalg.norm(frame.xy[point] - expected[point]))
        message = f"{names[point]} lies {away:.1f} px from where the other labels put it"
        jumps = [s for s in _jumps(shape, frame.xy, expected) if point in s]
        told.update(jumps)
        for start, end in jumps[:1]:
            message += f"; {_length(frame.xy, expected, start, end, names)}"
        yield _finding(frame, Problem.SEGMENT if jumps else Problem.OUTLIER, message, [names[point]])
    for start, end in _jumps(shape, frame.xy, expected):
        if (start, end) not in told:
            message = _length(frame.xy, expected, start, end, names)
            yield _finding(frame, Problem.SEGMENT, message, [names[start], names[end]])


def _far_points(shape: LabelShape, xy: FloatArray) -> np.ndarray:
    """(K,) bool, the points that are not where the curve has them."""
    away = np.linalg.norm(xy - shape.curve[shape.best(xy)], axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray((shape.deviations(xy) > _FAR_SD) & (away > _FAR_PX))


def _jumps(shape: LabelShape, xy: FloatArray, expected: FloatArray) -> list[tuple[int, int]]:
    """Neighbouring points whose distance is not that of the curve."""
    lengths, usual = (np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (xy, expected))
    limits = np.maximum(_FAR_SD * np.hypot(shape.sd_px[:-1], shape.sd_px[1:]), _FAR_PX)
    with np.errstate(invalid="ignore"):
        return [(int(i), int(i) + 1) for i in np.flatnonzero(np.abs(lengths - usual) > limits)]


def _length(xy: FloatArray, expected: FloatArray, start: int, end: int, names: Sequence[str]) -> str:
    found, usual = (float(np.linalg.norm(points[end] - points[start])) for points in (xy, expected))
    return f"{names[start]} to {names[end]} is {found:.1f} px long, in the other labels {usual:.1f}"


def _better_order(shape: LabelShape, xy: FloatArray) -> tuple[int, ...] | None:
    """The order in which the points fit the other labels, when this one does not and one does."""
    k = len(xy)
    if k <= _ALL_ORDERS:
        orders = list(permutations(range(k)))
    else:
        orders = [tuple(reversed(range(k)))]
        for first, second in combinations(range(k), 2):
            order = list(range(k))
            order[first], order[second] = second, first
            orders.append(tuple(order))

    def away(order: Sequence[int]) -> float:
        points = xy[list(order)]
        return float(np.nansum(np.linalg.norm(points - shape.curve[shape.best(points)], axis=1)))

    best = min(orders, key=away)
    return best if away(best) * _NEARER < away(range(k)) else None


def _swapped(frame: LabelledFrame, names: Sequence[str], order: Sequence[int]) -> Finding:
    moved = [place for place, index in enumerate(order) if place != index]
    concerned = [names[place] for place in moved]
    if len(moved) == 2:
        message = f"{concerned[0]} and {concerned[1]} seem to be swapped"
    elif list(order) == list(reversed(range(len(order)))):
        message = f"base and tip seem to be swapped: the points run from {names[-1]} to {names[0]}"
    else:
        message = f"seem to be swapped: what is {', '.join(concerned)} looks like " + ", ".join(
            names[list(order).index(place)] for place in moved
        )
    return _finding(frame, Problem.SWAPPED, message, concerned)
