"""Finding an actuator that nobody has labelled: where in a video it is, how large, and which of its ends is fixed.

A network that knows actuators in general (`pretraining.py`) finds canonical points in single pictures. A video tells
more: the fixed end is the one that does not move, and the actuator is the same one all the time. What comes out is a
header for this video, with which the network is put to work like any other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..tracker.angle import bending_angle
from ..tracker.errors import VideoError
from ..tracker.types import FloatArray, Frames
from .calibration import LEAST_PEAK
from .finder import Finder
from .header import Header
from .regions import WorkingRegion, find_region

FIRST_SIDES = (128, 192, 256)
"""Input px of a whole frame's long side at a first look: actuators fill a fifth of a picture, or nearly all of it."""

SURE = 0.5
"""A keypoint counts as seen from this share of its usual peak on."""

LEAST_SEEN = 0.3
"""Share of the glimpses in which most of the keypoints must be seen."""

STILL_SHARE = 0.5
"""An end that moves by less than so much of what the other moves is the fixed one."""


@dataclass(frozen=True)
class Sighting:
    """An actuator in a video.

    Attributes
    ----------
    header : the network's for this video: keypoints named from the fixed end, region, the angle's sign
    fixed : 0 where the network's first keypoint is the fixed end, -1 where its last is
    fixed_xy : (2,) px, where the fixed end is
    seen : share of the glimpses in which the actuator was seen
    """

    header: Header
    fixed: int
    fixed_xy: FloatArray
    seen: float


@dataclass(frozen=True)
class OrientedFinder(Finder):
    """A finder that knows where the fixed end is: a body that is found the wrong way round is turned.

    Attributes
    ----------
    fixed, fixed_xy : as `Sighting`'s
    """

    fixed: int
    fixed_xy: FloatArray

    def located(self, frames: Frames, region: WorkingRegion) -> tuple[FloatArray, FloatArray]:
        """As `Finder.located`."""
        return oriented(*super().located(frames, region), self.fixed, self.fixed_xy)


def oriented(
    xy: FloatArray, likelihood: FloatArray, fixed: int, fixed_xy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Positions (N, K, 2) and likelihoods (N, K), the chain turned round where its other end lies at the fixed one."""
    away = np.linalg.norm(xy[:, [fixed, -1 - fixed]] - fixed_xy, axis=2)
    wrong = away[:, 0] > away[:, 1]
    return (
        np.where(wrong[:, None, None], xy[:, ::-1], xy),
        np.where(wrong[:, None], likelihood[:, ::-1], likelihood),
    )


def sight(glimpses: Frames, header: Header, finder: Finder) -> Sighting:
    """Find the actuator in frames spread over a video.

    Parameters
    ----------
    glimpses : (N, H, W, 3) uint8 RGB, of one size
    header, finder : of a network whose keypoints are a chain from the fixed end to the moving one

    Raises
    ------
    VideoError
        No actuator can be seen.
    """
    h, w = glimpses[0].shape[:2]
    usual = np.maximum(header.calibration.usual_peak or 1.0, LEAST_PEAK)

    def look(region: WorkingRegion) -> tuple[FloatArray, FloatArray]:
        xy, peak = finder.located(glimpses, region)
        return xy, np.minimum(peak / usual, 1.0)

    whole = [WorkingRegion((w, h), 0, 0, w, h, min(1.0, side / max(w, h)), 1.0) for side in FIRST_SIDES]
    xy, likelihood = max((look(region) for region in whole), key=lambda found: float(found[1].mean()))
    region = whole[0]
    # Once more where it is, at the scale that fits it, until that settles.
    for _ in range(2):
        clear = _clear(likelihood)
        region = find_region(xy[clear], (w, h))
        xy, likelihood = look(region)
    clear = _clear(likelihood)
    fixed, fixed_xy = _fixed_end(xy[clear])
    xy, _ = oriented(xy, likelihood, fixed, fixed_xy)
    if fixed:
        header = replace(header, keypoints=header.keypoints[::-1])
    angle_deg, _, _ = bending_angle(xy[clear], header.keypoints, replace(header.definition, sign=1))
    known = angle_deg[np.isfinite(angle_deg)]
    sign = -1 if known.size and known[np.argmax(np.abs(known))] < 0 else 1
    definition = replace(header.definition, sign=sign)
    return Sighting(
        replace(header, regions=(region,), definition=definition), fixed, fixed_xy, float(clear.mean())
    )


def _clear(likelihood: FloatArray) -> np.ndarray:
    """Glimpses (N,) bool in which most keypoints are seen.

    Raises
    ------
    VideoError
        There are too few.
    """
    clear = np.median(likelihood, axis=1) >= SURE
    if clear.mean() < LEAST_SEEN:
        raise VideoError(
            f"expected an actuator in sight, got one in {100 * clear.mean():.0f} % of the frames looked at;"
            " label some frames: `bendtrack new`"
        )
    return np.asarray(clear)


def _fixed_end(xy: FloatArray) -> tuple[int, FloatArray]:
    """Which end (0 or -1) does not move, and where it is; the first one where neither is clearly at rest.

    The network may take one end for the other in any of the frames: a place is at rest when in most of them either end
    lies there.
    """
    ends = xy[:, [0, -1]]
    # From each end in each frame to the nearer end in every frame: (N, 2, N).
    away = np.linalg.norm(ends[:, :, None, None] - ends, axis=-1).min(axis=3)
    moved = np.median(away, axis=2)
    best = moved.argmin(axis=0)
    end = 1 if moved[best[1], 1] < STILL_SHARE * moved[best[0], 0] else 0
    fixed_xy = ends[best[end], end]
    nearer = np.linalg.norm(ends - fixed_xy, axis=2).argmin(axis=1)
    return (-1 if nearer.mean() > 0.5 else 0), fixed_xy
