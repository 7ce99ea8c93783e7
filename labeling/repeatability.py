"""Repeatability: which frames are labelled again blind, and the labeller's standard deviation that this gives.

It is the noise of the labels, in px and degrees: no network can be shown to be better. Repeat labels are stored in the
notes next to the labels (`notes_file.py`).
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

REPEAT_SHARE = 0.1  # of the labelled frames
# Fewer repeats give no usable estimate: five frames of four points give the standard deviation to a sixth.
_MIN_REPEATS = 5
# With fewer labelled frames the labeller remembers them all.
_MIN_LABELS = 10
# The last frames edited, which the labeller still remembers, are not repeated.
N_RECENT_FRAMES = 8
CONFIDENCE = 0.95  # of the intervals


@dataclass(frozen=True)
class Repeatability:
    """Standard deviation of one label about the labeller's own mean, in px and degrees.

    Attributes
    ----------
    px, px_low, px_high : float
        Standard deviation of one coordinate, px, and its confidence interval.
    n_points, n_frames : int
        Number of points that were placed twice, and of frames with such points.
    deg, deg_low, deg_high : float or None
        Standard deviation of the angle of one frame, degrees, and its confidence interval; None where no frame has
        the angle twice.
    n_angles : int
        Number of frames that have the angle twice.
    confidence : float
        Confidence of the intervals, which assume independent errors of different points.
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
        """Return plain JSON values, rounded to four decimals."""
        return {k: round(v, 4) if isinstance(v, float) else v for k, v in asdict(self).items()}


def estimate_repeatability(
    label_xy: FloatArray, repeat_xy: FloatArray, keypoints: Sequence[str], definition: AngleDefinition
) -> Repeatability | None:
    """Estimate the repeatability from frames that were labelled twice.

    The standard deviation of one label is the root mean square of the differences, divided by sqrt(2).

    Parameters
    ----------
    label_xy, repeat_xy : ndarray of float
        (N, K, 2) px, NaN where not placed.
    keypoints : sequence of str
        K names, in the order of the arrays.
    definition : AngleDefinition
        Definition of the angle.

    Returns
    -------
    Repeatability or None
        None where no point was placed twice.

    Examples
    --------
    >>> label = np.array([[[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]]])
    >>> found = estimate_repeatability(label, label + 2.0, "abc", AngleDefinition("three-point", tuple("abc")))
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
    difference_deg = repeat_deg - label_deg
    difference_deg = difference_deg[np.isfinite(difference_deg)]
    deg, deg_low, deg_high = _sd_with_interval(difference_deg) if difference_deg.size else (None, None, None)
    return Repeatability(
        px=px,
        px_low=px_low,
        px_high=px_high,
        n_points=int(twice.sum()),
        n_frames=int(twice.any(axis=1).sum()),
        deg=deg,
        deg_low=deg_low,
        deg_high=deg_high,
        n_angles=int(difference_deg.size),
    )


def _sd_with_interval(differences: FloatArray) -> tuple[float, float, float]:
    """Estimate the standard deviation of one of two equally precise values from n differences, and its interval.

    The mean difference is known to be zero, so n differences have n degrees of freedom.
    """
    n = differences.size
    sd = math.sqrt(float(np.mean(differences**2)) / 2)
    tail = (1 - CONFIDENCE) / 2
    # chdtri(n, q): the value that a chi-square variable of n degrees of freedom exceeds with probability q.
    low, high = (sd * math.sqrt(n / float(chdtri(n, q))) for q in (tail, 1 - tail))
    return sd, low, high


@dataclass(frozen=True)
class RepeatLabel:
    """A repeat label as it is stored.

    Attributes
    ----------
    points : mapping of str to Point
        Keypoint -> (x, y) px as placed the second time; empty for a frame that was skipped.
    label : mapping of str to Point
        The frame's points at that time, so that a later correction does not change the repeatability.
    """

    points: Mapping[str, Point]
    label: Mapping[str, Point]

    def to_json(self) -> dict[str, Any]:
        """Return the entry of the notes."""
        return {
            name: {keypoint: [x, y] for keypoint, (x, y) in points.items()}
            for name, points in (("points", self.points), ("label", self.label))
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> RepeatLabel | None:
        """Read an entry of the notes; None where it is malformed."""
        try:
            return cls(points_from_json(value["points"]), points_from_json(value["label"]))
        except (KeyError, TypeError, ValueError, IndexError, AttributeError):
            return None


def stored_repeats(folders: Iterable[VideoFolder]) -> list[RepeatLabel]:
    """Return all repeat labels of the folders; malformed ones are left out."""
    found = [RepeatLabel.from_json(entry) for folder in folders for entry in folder.repeats.values()]
    return [repeat for repeat in found if repeat is not None]


def repeatability_of(
    repeats: Sequence[RepeatLabel], keypoints: Sequence[str], definition: AngleDefinition
) -> Repeatability | None:
    """Estimate the repeatability from stored repeat labels, see `estimate_repeatability`.

    Parameters
    ----------
    repeats : sequence of RepeatLabel
        The repeat labels.
    keypoints : sequence of str
        Names of the project's keypoints.
    definition : AngleDefinition
        Definition of the angle.

    Returns
    -------
    Repeatability or None
        None where no point was placed twice.
    """
    if not repeats:
        return None
    label, repeat = (
        np.array([[points.get(k, (np.nan, np.nan)) for k in keypoints] for points in side])
        for side in ([r.label for r in repeats], [r.points for r in repeats])
    )
    return estimate_repeatability(label, repeat, keypoints, definition)


def project_repeatability(annotations: Annotations) -> Repeatability | None:
    """Estimate the labeller's repeatability in a project.

    Parameters
    ----------
    annotations : Annotations
        The project's frames.

    Returns
    -------
    Repeatability or None
        None without repeat labels.

    Raises
    ------
    LabelError
        A label file or the notes are malformed.
    """
    definition = annotations.project.angle_definition(None)
    return repeatability_of(stored_repeats(annotations.folders()), annotations.project.keypoints, definition)


@dataclass(frozen=True)
class RepeatPlan:
    """Which frames are to be labelled again.

    Attributes
    ----------
    target : int
        Number of repeat labels that there should be by now.
    done : int
        Number of repeat labels that there are.
    waiting : tuple of tuple of str
        (video, image) of the frames that can be labelled again, the next one first.
    """

    target: int
    done: int
    waiting: tuple[tuple[str, str], ...]

    @property
    def due(self) -> int:
        """Number of repeat labels to ask for now."""
        return max(0, min(self.target - self.done, len(self.waiting)))


def repeat_plan(
    folders: Sequence[VideoFolder], keypoints: Sequence[str], recent: set[tuple[str, str]], share: float
) -> RepeatPlan:
    """Choose the frames to be labelled again, in pseudo-random order.

    Parameters
    ----------
    folders : sequence of VideoFolder
        All folders of the project.
    keypoints : sequence of str
        Names of the project's keypoints.
    recent : set of tuple of str
        (video, image) of frames edited so recently that the labeller remembers them.
    share : float
        Share in [0, 1] of the labelled frames that is labelled again; 0 for none.

    Returns
    -------
    RepeatPlan
        The frames, and how many are due.
    """
    labelled = [
        (folder.video, image)
        for folder in folders
        for image, state in folder.states.items()
        if state.points and state.progress(keypoints) is Progress.LABELLED
    ]
    repeated = {(folder.video, image) for folder in folders for image in folder.repeats}
    # A skipped repeat counts as done, or the frame would be asked for again and again.
    done = len(repeated)
    target = 0
    if share > 0 and len(labelled) >= _MIN_LABELS:
        target = max(math.ceil(share * len(labelled)), _MIN_REPEATS)
    waiting = sorted(set(labelled) - repeated - recent, key=_shuffle_key)
    return RepeatPlan(target, done, tuple(waiting))


def _shuffle_key(frame: tuple[str, str]) -> bytes:
    """Return a pseudo-random sorting key that is the same in all calls and servers."""
    return hashlib.sha256("/".join(frame).encode()).digest()
