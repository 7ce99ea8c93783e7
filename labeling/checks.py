"""Checks of labels: likely mistakes, found by comparing labels with their images and with each other.

Nothing is corrected. The format of the files is checked where they are read (`store.py`).
"""

from __future__ import annotations

import hashlib
import shlex
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
from ..tracker.image_files import decode_image
from ..tracker.project import Project
from ..tracker.types import FloatArray, LabelledFrame
from .notes_file import read_notes
from .principal_curve import MIN_FRAMES, PrincipalCurve, fit_principal_curve
from .store import LabelStore

# Two points of one frame closer than this are one click counted twice.
_COINCIDENT_PX = 1.0
# An outlier is farther than both from the curve through the other labels: in standard deviations, and in px.
_OUTLIER_SD = 7.0
_OUTLIER_PX = 6.0
# Largest standard deviation about the curve, as a part of the body's length: above, the labels follow no single motion.
_MAX_RELATIVE_SD = 0.05
# Points are swapped when another order is this many times nearer to the curve.
_SWAP_RATIO = 3.0
# Videos share a view when their fixed ends are no farther apart than this part of the body's length.
_SAME_VIEW = 0.06
# Up to so many points all orders are tried; of more, exchanges of two and the reverse order.
_MAX_PERMUTED = 5


class Problem(StrEnum):
    """Kind of a finding."""

    MISSING = "missing point"
    OUTSIDE = "point outside"
    COINCIDENT = "coincident points"
    DUPLICATE = "duplicate image"
    SWAPPED = "swapped points"
    SEGMENT = "segment length"
    OUTLIER = "outlier"


@dataclass(frozen=True)
class Finding:
    """A likely mistake.

    Attributes
    ----------
    video, image : str
        Video stem and image name of the frame.
    image_path : Path
        Its image file.
    problem : Problem
        Kind of mistake.
    message : str
        Description to show.
    keypoints : tuple of str
        Keypoints concerned.
    """

    video: str
    image: str
    image_path: Path
    problem: Problem
    message: str
    keypoints: tuple[str, ...] = ()

    @property
    def link(self) -> str:
        """Fragment that opens the frame when appended to the labelling page's address."""
        return f"#{quote(self.video)}/{quote(self.image)}"


@dataclass(frozen=True)
class CheckReport:
    """Outcome of checking labels.

    Attributes
    ----------
    labelled : int
        Number of labelled frames.
    points : int
        Number of points that are placed in them.
    findings : list of Finding
        Likely mistakes, in the order of the frames.
    notes : list of str
        What could not be checked, one line each.
    """

    labelled: int
    points: int
    findings: list[Finding]
    notes: list[str]


def check_labels(project: Project) -> CheckReport:
    """Look for mistakes in a project's labels.

    Points are compared with a curve fitted to all labels of their actuator (see `fit_principal_curve`), where there
    are at least `MIN_FRAMES` frames of one view. Keypoints marked as not visible are not reported as missing. Skipped
    frames are left out.

    Parameters
    ----------
    project : Project
        The project.

    Returns
    -------
    CheckReport
        Likely mistakes, and what could not be checked.

    Raises
    ------
    LabelError
        The labels cannot be read, or there are none.
    """
    store = LabelStore.of(project)
    entries = {video: read_notes(store.labels_dir / video) for video in store.videos()}
    frames = [
        frame
        for frame in store.read()
        if not entries[frame.video].get(frame.image_path.name, {}).get("skipped")
    ]
    if not frames:
        root = shlex.quote(str(project.root))
        raise LabelError(
            f"{project.root}: expected labelled frames to check, got none:"
            f" `bendtrack label {root}` opens the page to label them"
        )
    names = project.keypoints
    contents = {frame.image_path: _read_image(frame.image_path) for frame in frames}
    findings: list[Finding] = []
    for frame in frames:
        unseen = entries[frame.video].get(frame.image_path.name, {}).get("not_visible", [])
        findings += _check_frame(frame, contents[frame.image_path], names, unseen)
    findings += _duplicate_images(frames, contents)
    notes = []
    for actuator, group in _views(frames):
        complete = sum(bool(np.isfinite(frame.xy).all()) for frame in group)
        if complete < MIN_FRAMES:
            videos = ", ".join(sorted({frame.video for frame in group}))
            notes.append(
                f"{actuator} ({videos}): {complete} frames with all points, fewer than {MIN_FRAMES}: "
                "not compared with each other"
            )
            continue
        points = np.stack([frame.xy for frame in group])
        curve = fit_principal_curve(points)
        body_px = float(np.nanmedian(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1)))
        if np.median(curve.sd_px) > _MAX_RELATIVE_SD * body_px:
            notes.append(f"{actuator}: the labels do not follow one motion: not compared with each other")
            continue
        for frame in group:
            findings += _check_against_curve(curve, frame, names)
    order = {frame.image_path: number for number, frame in enumerate(frames)}
    findings.sort(key=lambda finding: order[finding.image_path])
    n_points = sum([int(np.isfinite(frame.xy).all(axis=1).sum()) for frame in frames])
    return CheckReport(len(frames), n_points, findings, notes)


def _finding(frame: LabelledFrame, problem: Problem, message: str, keypoints: Sequence[str] = ()) -> Finding:
    return Finding(frame.video, frame.image_path.name, frame.image_path, problem, message, tuple(keypoints))


@dataclass(frozen=True)
class _ImageContent:
    size_wh: tuple[int, int]
    digest: bytes  # SHA-256 of the decoded pixels, independent of the file format


def _read_image(path: Path) -> _ImageContent:
    try:
        image = decode_image(path.read_bytes(), cv2.IMREAD_COLOR)
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from error
    if image is None:
        raise LabelError(f"{path}: expected an image, got a file that does not open as one")
    return _ImageContent((image.shape[1], image.shape[0]), hashlib.sha256(image.tobytes()).digest())


def _check_frame(
    frame: LabelledFrame, content: _ImageContent, names: Sequence[str], unseen: Sequence[str]
) -> Iterator[Finding]:
    """Check a frame's points by themselves: missing, outside the image, or coincident."""
    placed = np.asarray(np.isfinite(frame.xy).all(axis=1))
    missing = [name for name, done in zip(names, placed, strict=True) if not done and name not in unseen]
    if missing:
        yield _finding(frame, Problem.MISSING, f"{', '.join(missing)} not labelled", missing)
    width, height = content.size_wh
    for name, (x, y) in zip(names, frame.xy, strict=True):
        if x < -0.5 or y < -0.5 or x > width - 0.5 or y > height - 0.5:
            message = f"{name} at ({x:.1f}, {y:.1f}) lies outside the image of {width} x {height} px"
            yield _finding(frame, Problem.OUTSIDE, message, [name])
    for first, second in combinations(np.flatnonzero(placed).tolist(), 2):
        away = float(np.linalg.norm(frame.xy[first] - frame.xy[second]))
        if away < _COINCIDENT_PX:
            pair = names[first], names[second]
            yield _finding(
                frame, Problem.COINCIDENT, f"{pair[0]} and {pair[1]} are {away:.1f} px apart", pair
            )


def _duplicate_images(
    frames: Sequence[LabelledFrame], contents: Mapping[Path, _ImageContent]
) -> Iterator[Finding]:
    """Find frames whose image is labelled under another name, too."""
    first: dict[bytes, LabelledFrame] = {}
    for frame in frames:
        other = first.setdefault(contents[frame.image_path].digest, frame)
        if other is not frame:
            message = f"the same image as {other.video}/{other.image_path.name}, which is labelled, too"
            yield _finding(frame, Problem.DUPLICATE, message)


def _views(frames: Sequence[LabelledFrame]) -> Iterator[tuple[str, list[LabelledFrame]]]:
    """Group frames by actuator and view, which is given by the position of the fixed end; (actuator, frames)."""
    videos: dict[tuple[str, str], list[LabelledFrame]] = defaultdict(list)
    for frame in frames:
        videos[frame.actuator, frame.video].append(frame)
    groups: list[tuple[str, FloatArray, list[LabelledFrame]]] = []
    for (actuator, _), members in videos.items():
        points = np.stack([frame.xy for frame in members])
        with np.errstate(invalid="ignore"):
            base = _median(points[:, :2].mean(axis=1))
            body = _median(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1))
        for name, other_base, group in groups:
            if name == actuator and np.linalg.norm(other_base - base) <= _SAME_VIEW * body:
                group += members
                break
        else:
            groups.append((actuator, base, list(members)))
    for name, _, group in groups:
        yield name, group


def _median(values: FloatArray) -> FloatArray:
    """Return the median over the first axis without NaN rows; NaN where there is none."""
    known = values[np.isfinite(values).all(axis=tuple(range(1, values.ndim)))]
    return np.asarray(np.median(known, axis=0) if len(known) else np.full(values.shape[1:], np.nan))


def _check_against_curve(
    curve: PrincipalCurve, frame: LabelledFrame, names: Sequence[str]
) -> Iterator[Finding]:
    """Check a frame's points against the curve through all labels: swapped, outliers, segment lengths."""
    far = _outliers(curve, frame.xy)
    if far.any():
        order = _better_order(curve, frame.xy)
        if order is not None:
            yield _swapped(frame, names, order)
            return
    expected = curve.points[curve.best(frame.xy)]
    reported = set()
    for point in np.flatnonzero(far).tolist():
        away = float(np.linalg.norm(frame.xy[point] - expected[point]))
        message = f"{names[point]} lies {away:.1f} px from where the other labels put it"
        jumps = [s for s in _jumps(curve, frame.xy, expected) if point in s]
        reported.update(jumps)
        for start, end in jumps[:1]:
            message += f"; {_length(frame.xy, expected, start, end, names)}"
        yield _finding(frame, Problem.SEGMENT if jumps else Problem.OUTLIER, message, [names[point]])
    for start, end in _jumps(curve, frame.xy, expected):
        if (start, end) not in reported:
            message = _length(frame.xy, expected, start, end, names)
            yield _finding(frame, Problem.SEGMENT, message, [names[start], names[end]])


def _outliers(curve: PrincipalCurve, xy: FloatArray) -> np.ndarray:
    """Return the outliers, (K,) bool."""
    away = np.linalg.norm(xy - curve.points[curve.best(xy)], axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray((curve.deviations(xy) > _OUTLIER_SD) & (away > _OUTLIER_PX))


def _jumps(curve: PrincipalCurve, xy: FloatArray, expected: FloatArray) -> list[tuple[int, int]]:
    """Return pairs of neighbouring points whose distance differs from the curve's."""
    lengths, usual = (np.linalg.norm(np.diff(points, axis=0), axis=1) for points in (xy, expected))
    limits = np.maximum(_OUTLIER_SD * np.hypot(curve.sd_px[:-1], curve.sd_px[1:]), _OUTLIER_PX)
    with np.errstate(invalid="ignore"):
        return [(int(i), int(i) + 1) for i in np.flatnonzero(np.abs(lengths - usual) > limits)]


def _length(xy: FloatArray, expected: FloatArray, start: int, end: int, names: Sequence[str]) -> str:
    found, usual = (float(np.linalg.norm(points[end] - points[start])) for points in (xy, expected))
    return f"{names[start]} to {names[end]} is {found:.1f} px long, in the other labels {usual:.1f}"


def _better_order(curve: PrincipalCurve, xy: FloatArray) -> tuple[int, ...] | None:
    """Return the order in which the points fit the curve, None where no other order is much better."""
    k = len(xy)
    if k <= _MAX_PERMUTED:
        orders = list(permutations(range(k)))
    else:
        orders = [tuple(reversed(range(k)))]
        for first, second in combinations(range(k), 2):
            order = list(range(k))
            order[first], order[second] = second, first
            orders.append(tuple(order))

    def away(order: Sequence[int]) -> float:
        points = xy[list(order)]
        return float(np.nansum(np.linalg.norm(points - curve.points[curve.best(points)], axis=1)))

    best = min(orders, key=away)
    return best if away(best) * _SWAP_RATIO < away(range(k)) else None


def _swapped(frame: LabelledFrame, names: Sequence[str], order: Sequence[int]) -> Finding:
    moved = [position for position, index in enumerate(order) if position != index]
    concerned = [names[position] for position in moved]
    if len(moved) == 2:
        message = f"{concerned[0]} and {concerned[1]} seem to be swapped"
    elif list(order) == list(reversed(range(len(order)))):
        message = f"base and tip seem to be swapped: the points run from {names[-1]} to {names[0]}"
    else:
        message = f"seem to be swapped: what is {', '.join(concerned)} looks like " + ", ".join(
            names[list(order).index(position)] for position in moved
        )
    return _finding(frame, Problem.SWAPPED, message, concerned)
