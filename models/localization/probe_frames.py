"""What frames spread over a video show of an actuator when they are held against each other: where it is, how large,
which of its ends is fixed, and in which of them it can be believed.

A network that knows actuators in general finds canonical points in single pictures, wrong ones among them, and may take
either end for the fixed one. But the fixed end does not move, so it is where all glimpses together say, and the
actuator is the same one all the time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...tracker.angle import bending_angle
from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, Detections, FloatArray, Frames
from ..inference.calibration import reference_peaks
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.metadata import LONGER, SHORTER, CheckpointMetadata
from ..inference.roi import RegionOfInterest, region_of_interest
from .base_anchor import BaseAnchoredEstimator
from .chain_assembly import assemble_chain

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

LEAST_USUAL = 0.5
"""A video's usual peaks are at least so high, as a share of pretraining's."""

SURE_END, WRONG_END = 0.6, 0.5
"""What is taken for a keypoint is at least so likely where a network can learn that it is there, and less likely where
it can learn that it is not."""

FIXED, MOVING = slice(0, 2), slice(-2, None)
"""Which of the chain's keypoints make up its ends."""

STILL_SHARE = 0.5
"""An end that moves by less than so much of what the other moves is the fixed one."""


@dataclass(frozen=True)
class PseudoLabels:
    """What a network can learn an actuator by that nobody has labelled.

    Attributes
    ----------
    xy : (N, K, 2) px, found in glimpses, the fixed end where it rests in all; NaN where that is not sure
    right : (N,) bool, glimpses in which the moving end is sure
    wrong : (N, 2) bool, which of its points are not: what was taken for them is mostly something else
    """

    xy: FloatArray
    right: BoolArray
    wrong: BoolArray


@dataclass(frozen=True)
class Consensus:
    """What the glimpses show together.

    Attributes
    ----------
    look : what the locator found, within the region where the actuator can be
    found : (N, K), what the refiner found there, not calibrated
    same : (N,) bool, the glimpses in which the actuator is seen, held where it is in the others and of one shape
    fixed_xy : (2,) px, where it is held
    body_px, end_px : lengths of the body and of the moving end
    """

    look: _Look
    found: Detections
    same: BoolArray
    fixed_xy: FloatArray
    body_px: float
    end_px: float

    def header_from(self, header: CheckpointMetadata) -> CheckpointMetadata:
        """The network's header for this video, from what was found in the glimpses that count.

        They stand for the labelled frames of a training: how high the heatmaps' peaks usually are, how long the moving
        end may be, and to which side the actuator bends.
        """
        xy, peak = self.found.xy[self.same], self.found.likelihood[self.same]
        angle_deg, _, _ = bending_angle(xy, header.keypoints, replace(header.definition, sign=1))
        usual = np.clip(
            reference_peaks(peak, np.ones(peak.shape, bool)),
            LEAST_USUAL * header.calibration.usual,
            header.calibration.usual,
        )
        end = self.end_px * self.look.region.refiner_scale
        anything, about = (0.0, np.inf), (SHORTEST * end / SHORTER, LONGEST * end / LONGER)
        return replace(
            header,
            regions=(self.look.region,),
            definition=replace(header.definition, sign=-1 if np.nansum(angle_deg) < 0 else 1),
            calibration=replace(header.calibration, reference_peak=tuple(usual.tolist())),
            lengths=(*[anything] * (peak.shape[1] - 2), about, about),
        )

    def finder_from(
        self, finder: CoarseToFineEstimator, align: EndRegressor | None, header: CheckpointMetadata
    ) -> BaseAnchoredEstimator:
        """A finder that knows where this actuator is held, and with `align` how its moving end lies; `header` is this
        video's."""
        parts = finder.locate, finder.refine, finder.peaks, align
        between = range(len(header.keypoints))[FIXED.stop : MOVING.start]
        return BaseAnchoredEstimator(
            *parts,
            once=tuple(k for k in between if header.keypoints[k] not in header.definition.points),
            fixed_xy=self.fixed_xy,
            body_px=self.body_px,
            calibration=header.calibration,
        )

    def examples(
        self, probe_frames: Frames, header: CheckpointMetadata, finder: CoarseToFineEstimator
    ) -> PseudoLabels:
        """What the network can learn this actuator by, by what it finds once it is known where that is held."""
        header = self.header_from(header)
        found = self.finder_from(finder, None, header).detect(
            probe_frames, self.look.region, header.reference
        )
        found = header.calibrated(found, self.look.region)
        alike = _moving_alike(found.xy, self.fixed_xy, self.body_px, self.end_px)
        likelihood = found.likelihood.copy()
        likelihood[:, MOVING] = np.where(alike[:, None], likelihood[:, MOVING], 0.0)
        unsure: BoolArray = likelihood < WRONG_END
        # Of what is not sure between the ends, and of a fixed end that is hidden, nothing is said.
        xy = np.where(unsure[..., None], np.nan, found.xy)
        xy[:, MOVING] = found.xy[:, MOVING]
        resting = np.median(self.found.xy[self.same, FIXED], axis=0)
        xy[:, FIXED] = np.where(unsure[:, FIXED, None], np.nan, resting)
        held = _held(found.xy, self.fixed_xy, self.body_px)
        right = self.same & held & (likelihood[:, MOVING].min(axis=1) >= SURE_END)
        return PseudoLabels(xy, np.asarray(right), unsure[:, MOVING])


def multi_frame_consensus(
    probe_frames: Frames, header: CheckpointMetadata, finder: CoarseToFineEstimator
) -> Consensus:
    """Hold what a finder finds in single glimpses against each other.

    Raises
    ------
    VideoError
        Too little is seen.
    """
    h, w = probe_frames[0].shape[:2]
    likelihood = header.calibration.likelihood

    def look(region: RegionOfInterest) -> _Look:
        xy, peak = finder.located(probe_frames, region)
        return _agreed(region, xy, likelihood(peak))

    def look_again(region: RegionOfInterest, fixed_xy: FloatArray, body_px: float) -> _Look:
        xy, peak = finder.offered(probe_frames, region)
        return _agreed(region, *assemble_chain(xy, likelihood(peak), fixed_xy, body_px))

    whole = [RegionOfInterest((w, h), 0, 0, w, h, min(1.0, side / max(w, h)), 1.0) for side in FIRST_SIDES]
    best = max((look(region) for region in whole), key=lambda found: found.worth)
    # Once more where it is, at the scale that fits it, until that settles.
    for _ in range(2):
        xy = _seen(best)
        small, large = (
            look_again(_fitting_region(xy, (w, h), side), best.fixed_xy, _body_px(xy)) for side in BODY_SIDES
        )
        best = large if large.worth > small.worth + CLEARLY_MORE else small
    body_px = _body_px(_seen(best))
    found = finder.refined(probe_frames, best.xy, best.region, header.reference)
    fixed_xy = np.median(found.xy[best.sound, 0], axis=0)
    end_px = float(np.median(lengths_px(found.xy[best.sound][:, MOVING])))
    same = best.sound & inlier_mask(found.xy, fixed_xy, body_px, end_px)
    return Consensus(best, found, same, fixed_xy, body_px, end_px)


def oriented(xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (N, K, 2) and likelihoods (N, K), the chain turned round where its last end lies at the fixed place."""
    away = np.linalg.norm(xy[:, [0, -1]] - fixed_xy, axis=2)
    wrong = away[:, 0] > away[:, 1]
    return (
        np.where(wrong[:, None, None], xy[:, ::-1], xy),
        np.where(wrong[:, None], likelihood[:, ::-1], likelihood),
    )


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


def lengths_px(ends: FloatArray) -> FloatArray:
    """Lengths (N,) px of ends (N, 2, 2) px."""
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def inlier_mask(xy: FloatArray, fixed_xy: FloatArray, body_px: float, end_px: float) -> BoolArray:
    """Frames (N,) in which chains (N, K, 2) px are held at the fixed end, reach no further than the body can, and have
    a moving end of the right length."""
    return np.asarray(_held(xy, fixed_xy, body_px) & _moving_alike(xy, fixed_xy, body_px, end_px))


def _moving_alike(xy: FloatArray, fixed_xy: FloatArray, body_px: float, end_px: float) -> BoolArray:
    """Frames (N,) in which the moving end can be where chains (N, K, 2) px have it, and is of the right length."""
    length = lengths_px(xy[:, MOVING])
    alike = (length >= SHORTEST * end_px) & (length <= LONGEST * end_px)
    within_reach = np.linalg.norm(xy[:, -1] - fixed_xy, axis=1) <= FURTHEST_REACH * body_px
    return np.asarray(alike & within_reach)


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

    region: RegionOfInterest
    xy: FloatArray
    clear: BoolArray
    sound: BoolArray
    fixed_xy: FloatArray
    worth: float


def _agreed(region: RegionOfInterest, xy: FloatArray, likelihood: FloatArray) -> _Look:
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


def _fitting_region(xy: FloatArray, frame_wh: tuple[int, int], body_side: int) -> RegionOfInterest:
    """Where bodies found at (N, K, 2) px can be, at the scale at which they are `body_side` input px long."""
    body_px = _body_px(xy)
    region = region_of_interest(xy, frame_wh, body_px)
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
