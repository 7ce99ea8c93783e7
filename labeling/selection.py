"""Choosing frames to label: they span the whole range of motion, leave small gaps, are sharp and all different.

What is known of the videos comes from `survey.py`; by what poses are put in order from `motion_axis.py` (appearance),
or from the time; saving the chosen frames is in `new_frames.py`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..tracker.types import FloatArray
from .gap_filling import Target, fill_gaps
from .glimpses import Glimpse, brightness_ratio
from .motion_axis import Movement, find_movement, motion_coordinate, views
from .pose_cells import Cell, rms_distances
from .survey import Survey

# How far from its place a frame may lie, in spacings of the places: room to find one that is not blurred.
_SLACK = 0.45
# A frame is blurred when it has less than this part of the detail that the sharpest like it has.
_SHARP = 0.85
# Looks about a place differ from the most typical one by less than this many times the median.
_ALIKE = 2.0
# Two pictures that differ by no more than this many times the noise are one to a labeller.
_SAME = 1.5
# A place whose frames are all unfit goes to the widest gap that is then left.
_ROUNDS = 3

PlaceOf = Callable[[float], float | None]


@dataclass(frozen=True)
class _Pose:
    """A cell, and which video it is of."""

    video: int
    cell: Cell


def choose(
    surveys: Sequence[Survey], count: int, place_of: Sequence[PlaceOf] | None = None
) -> list[list[Glimpse]]:
    """Choose `count` frames among the videos of an actuator, so that they and the known ones leave small gaps.

    About each place the sharpest frame is taken, judged among frames that look alike and where the picture moves.
    Videos take turns, and so do branches (loading, unloading).

    Parameters
    ----------
    surveys : of all the actuator's videos
    count : how many; fewer are chosen when the videos do not show so many different pictures
    place_of : for each video, where a time_s of it lies on the line that frames are spread evenly over; None
        puts them in order by appearance

    Returns
    -------
    For each video the glimpses of its chosen frames, by frame.
    """
    sets = list(_comparable(surveys, by_appearance=place_of is None))
    chosen: list[list[Glimpse]] = [[] for _ in surveys]
    for poses, share in zip(sets, _shares(sets, count), strict=True):
        for video, glimpse in _Line(surveys, poses, place_of).choose(share):
            chosen[video].append(glimpse)
    return [sorted(glimpses, key=lambda glimpse: glimpse.frame) for glimpses in chosen]


def _comparable(surveys: Sequence[Survey], *, by_appearance: bool) -> Iterator[list[_Pose]]:
    """Sets of poses that can lie on one line: looks of one size and, by appearance, of one view."""
    shapes: dict[tuple[int, ...], list[_Pose]] = {}
    for video, found in enumerate(surveys):
        for cell in found.cells:
            shapes.setdefault(cell.members[0].look.shape, []).append(_Pose(video, cell))
    for poses in shapes.values():
        if not by_appearance:
            yield poses
            continue
        view = views(rms_distances(_looks(surveys, poses)), _counts(poses))
        for number in range(view.max() + 1):
            yield [pose for pose, own in zip(poses, view, strict=True) if own == number]


def _shares(sets: Sequence[Sequence[_Pose]], count: int) -> list[int]:
    """How many of `count` frames each set gets: as many as its part of the videos, each weighing the same."""
    frames = Counter[int]()
    for poses in sets:
        for pose in poses:
            frames[pose.video] += pose.cell.count
    parts = [sum(pose.cell.count / frames[pose.video] for pose in poses) for poses in sets]
    exact = [count * part / sum(parts) for part in parts]
    shares = [int(part) for part in exact]
    for place in sorted(range(len(exact)), key=lambda i: shares[i] - exact[i])[: count - sum(shares)]:
        shares[place] += 1
    return shares


class _Line:
    """Poses in order on a line, and the frames chosen along it."""

    def __init__(
        self, surveys: Sequence[Survey], poses: Sequence[_Pose], place_of: Sequence[PlaceOf] | None
    ) -> None:
        self._poses = poses
        self._gain = _gains(surveys, poses)
        looks, counts = _looks(surveys, poses), _counts(poses)
        self._movement = find_movement(looks, counts)
        self._looks = looks[:, self._movement.moving]
        self._tiles = _tile_weights(self._movement, poses[0].cell.members[0])
        shape = poses[0].cell.members[0].look.shape
        known = [
            (video, glimpse)
            for video in sorted({pose.video for pose in poses})
            for glimpse in surveys[video].known
            if glimpse.look.shape == shape
        ]
        if place_of is None:
            self._value = motion_coordinate(rms_distances(self._looks), self._movement.weight)
            nearest = [int(np.argmin(self._differences(video, glimpse))) for video, glimpse in known]
            self._taken = [float(self._value[place]) for place in nearest]
        else:
            self._value = np.array([_place(place_of[p.video], p.cell.members[0]) for p in poses])
            self._taken = [_place(place_of[video], glimpse) for video, glimpse in known]
        self._seen = [self._look(video, glimpse) for video, glimpse in known]  # chosen or known
        self._turns = Counter[object](video for video, _ in known)

    def choose(self, count: int) -> list[tuple[int, Glimpse]]:
        """Up to `count` frames, with their videos."""
        chosen: list[tuple[int, Glimpse]] = []
        for _ in range(_ROUNDS):
            targets = fill_gaps(self._value.min(), self._value.max(), self._taken, count - len(chosen))
            for target in targets:
                found = self._fit(target)
                if found is not None:
                    place, glimpse = found
                    pose = self._poses[place]
                    chosen.append((pose.video, glimpse))
                    self._taken.append(float(self._value[place]))
                    self._seen.append(self._look(pose.video, glimpse))
                    self._turns.update([pose.video, self._kind(place)])
        return chosen

    def _fit(self, target: Target) -> tuple[int, Glimpse] | None:
        """The best frame for a place, with its pose: a sharp one nearby that is no picture twice."""
        away = np.abs(self._value - target.value)
        near = np.flatnonzero(away <= max(_SLACK * target.room, away.min()))
        turn = min(
            (self._kind(place) for place in near), key=lambda kind: (self._turns[kind[0]], self._turns[kind])
        )
        near = near[[self._kind(place) == turn for place in near]]
        # A hand in the picture is no rival in sharpness: only what looks like most about here counts.
        between = rms_distances(self._looks[near])
        typical = int(np.argmin(between @ self._movement.weight[near]))
        alike = near[between[typical] <= max(_ALIKE * np.median(between[typical]), self._movement.noise)]
        members = [(place, glimpse) for place in alike for glimpse in self._poses[place].cell.members]
        sharpness = np.array([self._sharpness(glimpse) for _, glimpse in members])
        is_sharp = sharpness >= _SHARP * sharpness.max()
        # The nearest of the sharp ones, then the sharpest of the others.
        distance = np.array([away[place] for place, _ in members])
        order = np.lexsort((np.where(is_sharp, distance, -sharpness), ~is_sharp))
        return next((members[i] for i in order if self._is_new(*members[i])), None)

    def _kind(self, place: int) -> tuple[int, int]:
        """What takes turns: a pose's video and branch."""
        return self._poses[place].video, self._poses[place].cell.branch

    def _is_new(self, place: int, glimpse: Glimpse) -> bool:
        look = self._look(self._poses[place].video, glimpse)
        return not self._seen or bool(
            rms_distances(look[None], np.stack(self._seen)).min() > _SAME * self._movement.noise
        )

    def _look(self, video: int, glimpse: Glimpse) -> FloatArray:
        """What moves in a look, as bright as the others."""
        return _centred(glimpse, self._gain[video])[self._movement.moving]

    def _differences(self, video: int, glimpse: Glimpse) -> FloatArray:
        return rms_distances(self._look(video, glimpse)[None], self._looks)[0]

    def _sharpness(self, glimpse: Glimpse) -> float:
        return float((glimpse.detail * self._tiles).sum())


def _place(place_of: PlaceOf, glimpse: Glimpse) -> float:
    """Place of a glimpse, NaN where nothing is known of its time."""
    value = place_of(glimpse.time_s)
    return np.nan if value is None else value


def _counts(poses: Sequence[_Pose]) -> FloatArray:
    return np.array([pose.cell.count for pose in poses], dtype=np.float64)


def _gains(surveys: Sequence[Survey], poses: Sequence[_Pose]) -> dict[int, float]:
    """What makes each video as bright as the first, by its first look."""
    first = {
        video: surveys[video].cells[0].members[0].look for video in sorted({pose.video for pose in poses})
    }
    reference = next(iter(first.values()))
    return {video: brightness_ratio(reference, look) for video, look in first.items()}


def _looks(surveys: Sequence[Survey], poses: Sequence[_Pose]) -> FloatArray:
    """The poses' looks, (n, P) float32."""
    gain = _gains(surveys, poses)
    return np.stack([_centred(pose.cell.members[0], gain[pose.video]) for pose in poses])


def _centred(glimpse: Glimpse, gain: float) -> FloatArray:
    """A look (P,) about a grey of 128, so that float32 keeps the differences of long vectors."""
    return np.asarray(glimpse.look.ravel() * np.float32(gain) - np.float32(128))


def _tile_weights(movement: Movement, glimpse: Glimpse) -> FloatArray:
    """How much of what moves lies in each tile of a glimpse's detail, (rows, columns) adding up to 1."""
    moving = movement.moving.reshape(glimpse.look.shape).astype(np.float32)
    rows, columns = glimpse.detail.shape
    weights = cv2.resize(moving, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(weights / weights.sum())
