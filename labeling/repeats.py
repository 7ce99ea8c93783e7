"""Repeat labelling: which frames come back blind, and the labeller's own spread that follows, in px and degrees.

No network can be judged to be better than that. The answers lie in the notes beside the labels (`side_data.py`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import chdtri

from ..tracker.angle import AngleDefinition, bending_angle
from ..tracker.types import FloatArray
from .annotations import Annotations, VideoFolder
from .frame_state import Progress, points_from_json
from .label_table import Point

REPEAT_SHARE = 0.1
# Fewer than this say next to nothing about a spread: five frames of four points know it to a sixth.
_LEAST_REPEATS = 5
# Before so many labels there is nothing to come back to.
_LEAST_LABELS = 10
# Frames edited so lately are remembered.
REMEMBERED = 8
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Spread:
    """How far a labeller is from himself. Standard deviations of one label.

    Attributes
    ----------
    px, px_low, px_high : of one coordinate, with its interval
    n_points, n_frames : points that were placed twice, and in how many frames
    deg, deg_low, deg_high, n_angles : of the angle of one frame; None where no frame has the angle twice
    confidence : of the intervals, which take errors of different points for independent
    """

    px: float
    px_low: float
    px_high: float
    n_points: int
    n_frames: int
    deg: float | None
    deg_low: float | None
    deg_high: float | None
    n_angles: int
    confidence: float = CONFIDENCE

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values, rounded for reading."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


def labeller_spread(
    label_xy: FloatArray, repeat_xy: FloatArray, keypoints: Sequence[str], definition: AngleDefinition
) -> Spread | None:
    """Spread from frames that were labelled twice.

    The standard deviation of one label is the root mean square of the differences, divided by sqrt(2).

    Parameters
    ----------
    label_xy, repeat_xy : (N, K, 2) px, NaN where not placed
    keypoints : K names
    definition : which angle

    Returns
    -------
    None where no point was placed twice.

    Examples
    --------
    >>> label = np.array([[[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]])
    >>> found = labeller_spread(label, label + 2.0, "abc", AngleDefinition("three-point", tuple("abc")))
    >>> round(found.px, 3), found.n_points, found.deg
    (1.414, 3, 0.0)
    """
    differences = repeat_xy - label_xy
    twice = np.asarray(np.isfinite(differences).all(axis=2))
    if not twice.any():
        return None
    px, px_low, px_high = _sd_with_interval(differences[twice].ravel())
    label_deg, _, _ = bending_angle(label_xy, keypoints, definition)
    repeat_deg, _, _ = bending_angle(repeat_xy, keypoints, definition)
    turned = repeat_deg - label_deg
    turned = turned[np.isfinite(turned)]
    deg, deg_low, deg_high = _sd_with_interval(turned) if turned.size else (None, None, None)
    return Spread(
        px=px,
        px_low=px_low,
        px_high=px_high,
        n_points=int(twice.sum()),
        n_frames=int(twice.any(axis=1).sum()),
        deg=deg,
        deg_low=deg_low,
        deg_high=deg_high,
        n_angles=int(turned.size),
    )


def _sd_with_interval(differences: FloatArray) -> tuple[float, float, float]:
    """Standard deviation of one of two equally good values, from n of their differences, and its interval.

    The mean difference is known to be zero, so n differences have n degrees of freedom.
    """
    n = differences.size
    sd = math.sqrt(float(np.mean(differences**2)) / 2)
    tail = (1 - CONFIDENCE) / 2
    # chdtri(n, q): what a chi-square of n degrees of freedom exceeds with probability q.
    low, high = (sd * math.sqrt(n / float(chdtri(n, q))) for q in (tail, 1 - tail))
    return sd, low, high


@dataclass(frozen=True)
class Repeat:
    """A repeat label as it is kept.

    Attributes
    ----------
    points : keypoint -> (x, y) px as placed the second time; empty: passed over
    label : the frame's points as they were then; who corrects a label later does not change the spread
    """

    points: Mapping[str, Point]
    label: Mapping[str, Point]

    def to_json(self) -> dict[str, Any]:
        """As it stands in the notes."""
        return {
            name: {keypoint: [x, y] for keypoint, (x, y) in points.items()}
            for name, points in (("points", self.points), ("label", self.label))
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Repeat | None:
        """What `to_json` gave; None for anything else."""
        try:
            return cls(points_from_json(value["points"]), points_from_json(value["label"]))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError):
            return None


def stored_repeats(folders: Iterable[VideoFolder]) -> list[Repeat]:
    """All repeat labels that were given."""
    found = [Repeat.from_json(entry) for folder in folders for entry in folder.repeats.values()]
    return [repeat for repeat in found if repeat is not None]


def spread_of(
    repeats: Sequence[Repeat], keypoints: Sequence[str], definition: AngleDefinition
) -> Spread | None:
    """As `labeller_spread`, of repeat labels as they are kept."""
    if not repeats:
        return None
    label, again = (
        np.array([[points.get(k, (np.nan, np.nan)) for k in keypoints] for points in side])
        for side in ([r.label for r in repeats], [r.points for r in repeats])
    )
    return labeller_spread(label, again, keypoints, definition)


def project_spread(annotations: Annotations) -> Spread | None:
    """The labeller's own spread in a project; None without repeat labels. Errors as in `Annotations.folder`."""
    definition = annotations.project.angle_definition(None)
    return spread_of(stored_repeats(annotations.folders()), annotations.project.keypoints, definition)


@dataclass(frozen=True)
class RepeatPlan:
    """Which frames are to come back.

    Attributes
    ----------
    target : how many repeat labels there should be by now
    done : how many there are
    waiting : (video, image) of those that may come back, the next first
    """

    target: int
    done: int
    waiting: tuple[tuple[str, str], ...]

    @property
    def due(self) -> int:
        """How many to ask for now."""
        return max(0, min(self.target - self.done, len(self.waiting)))


def repeat_plan(
    folders: Sequence[VideoFolder], keypoints: Sequence[str], lately: set[tuple[str, str]], share: float
) -> RepeatPlan:
    """Choose the frames to be labelled again, in an order that has nothing to do with how they look.

    Parameters
    ----------
    folders : all of the project
    lately : (video, image) of frames edited so lately that they are remembered
    share : of the labelled frames
    """
    labelled = [
        (folder.video, image)
        for folder in folders
        for image, state in folder.states.items()
        if state.points and state.progress(keypoints) is Progress.LABELLED
    ]
    again = {(folder.video, image) for folder in folders for image in folder.repeats}
    # Passed over is answered, too, or it would be asked for ever.
    done = len(again)
    target = 0
    if share > 0 and len(labelled) >= _LEAST_LABELS:
        target = max(math.ceil(share * len(labelled)), _LEAST_REPEATS)
    waiting = sorted(set(labelled) - again - lately, key=_shuffled)
    return RepeatPlan(target, done, tuple(waiting))


def _shuffled(frame: tuple[str, str]) -> bytes:
    """A sorting key without meaning that stays the same across calls and servers."""
    return hashlib.sha256("/".join(frame).encode()).digest()
