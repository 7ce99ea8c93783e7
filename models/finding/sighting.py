"""Finding an actuator that nobody has labelled: where in a video it is, how large, and which of its ends is fixed.

A network that knows actuators in general (`pretraining.py`) finds canonical points in single pictures. A video tells
more: the fixed end is the one that does not move, so it is where all glimpses together say, and the actuator is the
same one all the time. What comes out is a header for this video, with which the network is put to work like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...tracker.angle import bending_angle
from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, Detections, FloatArray, Frames
from .assembly import assembled
from .calibration import usual_peaks
from .finder import Aligner, Finder
from .header import LONGER, SHORTER, Header
from .held import HeldFinder
from .patches import CLOSER, cut_end, moved_ends
from .regions import WorkingRegion, find_region
from .sides import turn_by_sides

FIRST_SIDES = (96, 128, 192, 256)
"""Input px of a whole frame's long side at a first look: actuators fill a fifth of a picture, or nearly all of it."""

BODY_SIDES = (64, 96)
"""Input px of the body's length where it is looked at once more: as large as in most of pretraining's pictures, or as
in the largest where more is seen then."""

CLEARLY_MORE = 0.02
"""How much more must be seen for a larger input, which takes longer in every frame."""

SURE = 0.5
"""A keypoint counts as seen from this share of its usual peak on."""

LEAST_SEEN = 0.3
"""Share of the glimpses in which most of the keypoints must be seen, and the fixed end where it is held."""

LONGEST_STEP, MANY_STEPS = 2.0, 6
"""Neighbours on a chain that lie further apart, in medians of all of its neighbours, are not both on the body, where
there are so many that the ends' own lengths do not make the median."""

HELD_SHARE = 0.1
"""The fixed end is found where it is held, within so much of the body's length."""

SHORTEST, LONGEST = 0.5, 2.0
"""How long the moving end may be, as a share of its usual length: it does not stretch, but may turn away, and where a
smooth body begins to bend is hard to see, which does not matter to its direction."""

FURTHEST_REACH = 1.3
"""The tip is no further from the fixed end than the body is long, or much longer only where it stretches."""

LEAST_SAME = 0.6
"""Share of the glimpses that must show the same actuator, or the angles would be mostly guessed."""

LEAST_USUAL = 0.5
"""A video's usual peaks are at least so high, as a share of pretraining's."""

FIXED, MOVING = slice(0, 2), slice(-2, None)
"""Which of the chain's keypoints make up its ends."""

STILL_SHARE = 0.5
"""An end that moves by less than so much of what the other moves is the fixed one."""


Closer = Callable[[Frames, FloatArray, BoolArray, WorkingRegion], tuple[FloatArray, Aligner | None]]
"""From glimpses, positions (N, K, 2) px found in them, which count, and the region: better ones, and what tells in
other frames how the moving end lies."""


@dataclass(frozen=True)
class Sighting:
    """An actuator in a video.

    Attributes
    ----------
    header : the network's for this video: region, the angle's sign, usual peaks, the moving end's length
    finder : knows where the fixed end is, and the body's length
    fixed : the fixed end's points (1, 2), calibrated, and turned as its sides say
    end_px : length of the moving end
    turn_rad : by which the moving end is to be turned, from x toward y, to point along its sides
    seen : share of the glimpses in which the actuator was seen, held where it is in the others and of one shape
    """

    header: Header
    finder: HeldFinder
    fixed: Detections
    end_px: float
    turn_rad: float
    seen: float

    def believed(self, found: Detections) -> Detections:
        """What was found in frames of the video, with the fixed end where it rests and the moving one turned right.

        Nothing is believed of a frame that shows another actuator.
        """
        same = _same(found.xy, self.finder.fixed_xy, self.finder.body_px, self.end_px)
        xy, likelihood, covariance = found.xy.copy(), found.likelihood.copy(), found.covariance.copy()
        xy[:, FIXED], likelihood[:, FIXED] = self.fixed.xy, self.fixed.likelihood
        covariance[:, FIXED] = self.fixed.covariance
        xy[:, MOVING] = _turned(xy[:, MOVING], self.turn_rad)
        return Detections(xy, np.where(same[:, None], likelihood, 0.0), covariance)


def oriented(xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (N, K, 2) and likelihoods (N, K), the chain turned round where its last end lies at the fixed place."""
    away = np.linalg.norm(xy[:, [0, -1]] - fixed_xy, axis=2)
    wrong = away[:, 0] > away[:, 1]
    return (
        np.where(wrong[:, None, None], xy[:, ::-1], xy),
        np.where(wrong[:, None], likelihood[:, ::-1], likelihood),
    )


def sight(glimpses: Frames, header: Header, finder: Finder, closer: Closer | None = None) -> Sighting:
    """Find the actuator in frames spread over a video.

    Parameters
    ----------
    glimpses : (N, H, W, 3) uint8 RGB, of one size
    header, finder : of a network whose keypoints are a chain from the fixed end to the moving one
    closer : looks closer at the moving end (`models.unlabelled`); None leaves that to the finder

    Raises
    ------
    VideoError
        No actuator can be seen.
    """
    h, w = glimpses[0].shape[:2]
    likelihood = header.calibration.likelihood

    def look(region: WorkingRegion) -> _Look:
        xy, peak = finder.located(glimpses, region)
        return _agreed(region, xy, likelihood(peak))

    def look_again(region: WorkingRegion, fixed_xy: FloatArray, body_px: float) -> _Look:
        xy, peak = finder.offered(glimpses, region)
        return _agreed(region, *assembled(xy, likelihood(peak), fixed_xy, body_px))

    whole = [WorkingRegion((w, h), 0, 0, w, h, min(1.0, side / max(w, h)), 1.0) for side in FIRST_SIDES]
    best = max((look(region) for region in whole), key=lambda found: found.worth)
    # Once more where it is, at the scale that fits it, until that settles.
    for _ in range(2):
        xy = _seen(best)
        small, large = (
            look_again(_fitting_region(xy, (w, h), side), best.fixed_xy, _body_px(xy)) for side in BODY_SIDES
        )
        best = large if large.worth > small.worth + CLEARLY_MORE else small
    body_px = _body_px(_seen(best))
    found = finder.refined(glimpses, best.xy, best.region, header.partner)
    xy = found.xy
    fixed_xy = np.median(xy[best.sound, 0], axis=0)
    end_px = float(np.median(_lengths_px(xy[best.sound][:, MOVING])))
    same = best.sound & _same(xy, fixed_xy, body_px, end_px)
    if same.mean() < LEAST_SAME:
        raise VideoError(
            f"expected an actuator that keeps its shape, got one that does in {100 * same.mean():.0f} % of the"
            " frames looked at; label some frames: `bendtrack new`"
        )
    header = _header_of(header, found, same, best.region, end_px)
    # Where the ends of a network that learnt from labels lie, and how they point, is what those say.
    learnt = not header.pretrained
    xy, align = (xy, finder.align) if learnt or closer is None else closer(glimpses, xy, same, best.region)
    parts = finder.locate, finder.refine, finder.peaks, align
    knowing = HeldFinder(*parts, fixed_xy=fixed_xy, body_px=body_px, calibration=header.calibration)
    fixed = _resting(header.calibration.apply(found), same)
    fixed_rad, moving_rad = (
        0.0 if learnt else _turn_rad(glimpses, xy[:, end], same, best.region) for end in (FIXED, MOVING)
    )
    fixed.xy[:] = _turned(fixed.xy, fixed_rad)
    return Sighting(header, knowing, fixed, end_px, moving_rad, float(same.mean()))


def _turn_rad(glimpses: Frames, ends: FloatArray, same: BoolArray, region: WorkingRegion) -> float:
    """By which ends (N, 2, 2) px are to be turned, from x toward y, to point along their sides, as the glimpses that
    count say together."""
    chosen = np.flatnonzero(same).tolist()
    length_px = CLOSER * region.refiner_scale * float(np.median(_lengths_px(ends[chosen])))
    return turn_by_sides([cut_end(glimpses[i], ends[i], region).picture for i in chosen], length_px)


def _turned(ends: FloatArray, turn_rad: float) -> FloatArray:
    """Ends (N, 2, 2) px turned about their middles."""
    return moved_ends(ends, np.tile([0.0, 0.0, turn_rad], (len(ends), 1)), 1.0)


def _header_of(
    header: Header, found: Detections, same: BoolArray, region: WorkingRegion, end_px: float
) -> Header:
    """The network's header for this video, from what was found in the glimpses (N,) that count.

    They stand for the labelled frames of a training: how high the heatmaps' peaks usually are, how long the moving end
    may be, and to which side the actuator bends.
    """
    xy, peak = found.xy[same], found.likelihood[same]
    angle_deg, _, _ = bending_angle(xy, header.keypoints, replace(header.definition, sign=1))
    usual = np.clip(
        usual_peaks(peak, np.ones(peak.shape, bool)),
        LEAST_USUAL * header.calibration.usual,
        header.calibration.usual,
    )
    end = end_px * region.refiner_scale
    anything, about = (0.0, np.inf), (SHORTEST * end / SHORTER, LONGEST * end / LONGER)
    return replace(
        header,
        regions=(region,),
        definition=replace(header.definition, sign=-1 if np.nansum(angle_deg) < 0 else 1),
        calibration=replace(header.calibration, usual_peak=tuple(usual.tolist())),
        lengths=(*[anything] * (peak.shape[1] - 2), about, about),
    )


def _resting(found: Detections, same: BoolArray) -> Detections:
    """The fixed end's two points (1, 2), as the glimpses (N,) that count say together; as likely as these are many.

    They err alike, so what all say is hardly more exact than what one says.
    """
    xy, covariance = (np.median(part[same, FIXED], axis=0)[None] for part in (found.xy, found.covariance))
    return Detections(xy, np.full((1, 2), same.mean()), covariance)


def _body_px(xy: FloatArray) -> float:
    """Length of the body along chains (N, K, 2) px, the median; 0 without any.

    A keypoint that is something far away in one of them adds little to its length.
    """
    if not len(xy):
        return 0.0
    steps = np.linalg.norm(np.diff(xy, axis=1), axis=2)
    if steps.shape[1] >= MANY_STEPS:
        steps = np.minimum(steps, LONGEST_STEP * np.median(steps, axis=1, keepdims=True))
    return float(np.median(steps.sum(axis=1)))


def _lengths_px(ends: FloatArray) -> FloatArray:
    """Lengths (N,) px of ends (N, 2, 2) px."""
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def _same(xy: FloatArray, fixed_xy: FloatArray, body_px: float, end_px: float) -> BoolArray:
    """Frames (N,) in which chains (N, K, 2) px are held at the fixed end, reach no further than the body can, and have
    a moving end of the right length."""
    length = _lengths_px(xy[:, MOVING])
    alike = (length >= SHORTEST * end_px) & (length <= LONGEST * end_px)
    within_reach = np.linalg.norm(xy[:, -1] - fixed_xy, axis=1) <= FURTHEST_REACH * body_px
    return np.asarray(_held(xy, fixed_xy, body_px) & alike & within_reach)


def _held(xy: FloatArray, fixed_xy: FloatArray, body_px: float) -> BoolArray:
    """Frames (N,) in which chains (N, K, 2) px begin where the actuator is held."""
    return np.asarray(np.linalg.norm(xy[:, 0] - fixed_xy, axis=1) <= HELD_SHARE * body_px)


@dataclass(frozen=True)
class _Look:
    """What is found in the glimpses within one region.

    Attributes
    ----------
    xy : (N, K, 2) px, from the fixed end
    clear : (N,) bool, most keypoints are seen
    sound : (N,) bool, clear, and the fixed end is where it always is
    worth : how much speaks for it: sound glimpses, and how well their keypoints are seen
    """

    region: WorkingRegion
    xy: FloatArray
    clear: BoolArray
    sound: BoolArray
    fixed_xy: FloatArray
    worth: float


def _agreed(region: WorkingRegion, xy: FloatArray, likelihood: FloatArray) -> _Look:
    """Single glimpses held against each other: where the fixed end is, and in which of them it is found there."""
    clear = np.median(likelihood, axis=1) >= SURE
    fixed_xy = _fixed_end(xy[clear]) if clear.any() else np.full(2, np.nan)
    xy, likelihood = oriented(xy, likelihood, fixed_xy)
    sound = clear & _held(xy, fixed_xy, _body_px(xy[clear]))
    worth = float(np.where(sound, likelihood.mean(axis=1), 0.0).mean())
    return _Look(region, xy, clear, sound, fixed_xy, worth)


def _seen(found: _Look) -> FloatArray:
    """Keypoints (M, K, 2) px in the sound glimpses.

    Raises
    ------
    VideoError
        There are too few.
    """
    clear, sound = (100 * float(share.mean()) for share in (found.clear, found.sound))
    if clear < 100 * LEAST_SEEN:
        raise VideoError(
            f"expected an actuator in sight, got one in {clear:.0f} % of the frames looked at; label some frames:"
            " `bendtrack new`"
        )
    if sound < 100 * LEAST_SEEN:
        raise VideoError(
            f"expected an actuator that is held at one end, got one there in {sound:.0f} % of the frames looked at;"
            " label some frames: `bendtrack new`"
        )
    return found.xy[found.sound]


def _fitting_region(xy: FloatArray, frame_wh: tuple[int, int], body_side: int) -> WorkingRegion:
    """Where bodies found at (N, K, 2) px can be, at the scale at which they are `body_side` input px long."""
    body_px = _body_px(xy)
    region = find_region(xy, frame_wh, body_px)
    fits = body_side / max(body_px, 1.0), FIRST_SIDES[-1] / max(region.width, region.height)
    return replace(region, locator_scale=min(1.0, *fits))


def _fixed_end(xy: FloatArray) -> FloatArray:
    """Where the end is that does not move; the network's first one where neither is clearly at rest.

    The network may take one end for the other in any of the frames: a place is at rest when in most of them either end
    lies there.
    """
    ends = xy[:, [0, -1]]
    # From each end in each frame to the nearer end in every frame: (N, 2, N).
    away = np.linalg.norm(ends[:, :, None, None] - ends, axis=-1).min(axis=3)
    moved = np.median(away, axis=2)
    best = moved.argmin(axis=0)
    end = 1 if moved[best[1], 1] < STILL_SHARE * moved[best[0], 0] else 0
    fixed_xy: FloatArray = ends[best[end], end]
    return fixed_xy
