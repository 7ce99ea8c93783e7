"""Probe frames: frames spread over a video, taken together.

A network that knows actuators in general finds canonical points in single frames, wrong ones among them, and may take
either end for the fixed one. But the fixed end hardly moves, so it is where all probe frames together say, and the
actuator is the same one in all of them. What the frames agree on is their consensus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...tracker.angle import bending_angle
from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, Detections, FloatArray, Frames, IntArray
from ..inference.calibration import reference_peaks
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.crops import CropGeometry
from ..inference.metadata import LONGER, SHORTER, CheckpointMetadata
from ..inference.roi import RegionOfInterest, region_of_interest
from .base_anchor import BaseAnchoredEstimator
from .base_motion import base_yields
from .chain_assembly import assemble_chain, likeliest_points
from .motion import MotionEvidence, motion_evidence

FIRST_SIDES = (96, 128, 192, 256)
"""Input px of a whole frame's long side in the first search: actuators fill a fifth of a frame, or nearly all of it."""

BODY_SIDES = (64, 96)
"""Input px of the body's length in the second search: as in most of pretraining's images, or as in the largest ones
where more is seen then."""

CLEARLY_MORE = 0.02
"""Gain in score that justifies the larger input, which takes longer in every frame."""

SEEN_LIKELIHOOD = 0.5
"""A keypoint counts as seen from this likelihood on."""

MIN_SEEN_SHARE = 0.3
"""Share of the probe frames in which most of the keypoints must be seen, and the fixed end at its place."""

LONGEST_STEP, MANY_STEPS = 2.0, 6
"""Neighbours on a chain that lie further apart, in medians of all neighbours' distances, are not both on the body. Only
for chains with so many steps that the ends' own lengths do not make the median."""

ANCHOR_SHARE = 0.1
"""Largest distance of the first keypoint from the fixed end, as a share of the body's length."""

SHORTEST, LONGEST = 0.5, 2.0
"""Range of the moving end's length, as a share of its median. It does not stretch but may turn away from the camera.
Where a smooth body begins to bend is hard to see, which does not matter to the end's direction."""

MAX_REACH = 1.3
"""Largest distance of the tip from the fixed end, in body lengths: more only where the body stretches."""

MIN_REFERENCE_SHARE = 0.5
"""A video's reference peaks are at least so high, as a share of pretraining's."""

SURE_END, WRONG_END = 0.6, 0.5
"""Pseudo-label thresholds: a positive needs likelihood >= SURE_END, a negative < WRONG_END; the rest is ignored."""

FIXED, MOVING = slice(0, 2), slice(-2, None)
"""The keypoints of the chain's two ends."""

STATIC_SHARE = 0.5
"""An end that moves by less than this share of the other end's motion is the fixed one."""


@dataclass(frozen=True)
class KnownEnds:
    """What labels say of the actuator before it is looked for.

    Attributes
    ----------
    fixed_xy : ndarray of float, shape (2,)
        The first keypoint at the fixed end, px.
    body_px : float
        About the body's length, px.
    rows : ndarray of int, shape (L,)
        Labelled frames among the probe frames.
    xy : ndarray of float, shape (L, K, 2)
        Keypoints labelled there, px; NaN where not labelled.
    """

    fixed_xy: FloatArray
    body_px: float
    rows: IntArray
    xy: FloatArray

    def put_in(self, xy: FloatArray, likelihood: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Candidates (N, K, M, 2) px and their likelihoods (N, K, M) with the labelled ones in their place."""
        xy, likelihood = xy.copy(), likelihood.copy()
        labelled = ~np.isnan(self.xy).any(axis=2)
        of_row, keypoint = np.nonzero(labelled)
        xy[self.rows[of_row], keypoint] = self.xy[labelled][:, None]
        likelihood[self.rows[of_row], keypoint] = 1.0
        return xy, likelihood


@dataclass(frozen=True)
class PseudoLabels:
    """Positions in probe frames that stand for labels in self-training.

    Attributes
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Positions, px, a fixed end that is held at its place in all frames; NaN where not sure.
    positive : ndarray of bool, shape (N,)
        Frames in which the moving end is sure.
    negative : ndarray of bool, shape (N, 2)
        Points of the moving end that are not sure: what was taken for them is mostly something else.
    """

    xy: FloatArray
    positive: BoolArray
    negative: BoolArray


@dataclass(frozen=True)
class Consensus:
    """What the probe frames show together.

    Attributes
    ----------
    view : RegionView
        What the locator found, in the region where the actuator can be.
    found : Detections
        (N, K), what the refiner found there, not calibrated.
    inlier : ndarray of bool, shape (N,)
        Frames that show the actuator at the common fixed end and with the common shape.
    fixed_xy : ndarray of float, shape (2,)
        The fixed end, px.
    body_px, end_px : float
        Lengths of the body and of the moving end, px.
    """

    view: RegionView
    found: Detections
    inlier: BoolArray
    fixed_xy: FloatArray
    body_px: float
    end_px: float

    def metadata_for(self, metadata: CheckpointMetadata) -> CheckpointMetadata:
        """The network's metadata for this video, estimated from the inliers.

        They stand for the labelled frames of a training: reference peaks, the moving end's length, and the side to
        which the actuator bends.
        """
        xy, peak = self.found.xy[self.inlier], self.found.likelihood[self.inlier]
        angle_deg, _, _ = bending_angle(xy, metadata.keypoints, replace(metadata.definition, sign=1))
        pretrained_peak = metadata.calibration.normalising_peak
        peaks = np.clip(
            reference_peaks(peak, np.ones(peak.shape, bool)),
            MIN_REFERENCE_SHARE * pretrained_peak,
            pretrained_peak,
        )
        end = self.end_px * self.view.region.refiner_scale
        anything, about = (0.0, np.inf), (SHORTEST * end / SHORTER, LONGEST * end / LONGER)
        return replace(
            metadata,
            regions=(self.view.region,),
            definition=replace(metadata.definition, sign=-1 if np.nansum(angle_deg) < 0 else 1),
            calibration=replace(metadata.calibration, reference_peak=tuple(peaks.tolist())),
            distance_range=(*[anything] * (peak.shape[1] - 2), about, about),
        )

    def anchored_estimator(
        self,
        estimator: CoarseToFineEstimator,
        end_regressor: EndRegressor | None,
        metadata: CheckpointMetadata,
    ) -> BaseAnchoredEstimator:
        """An estimator anchored at this actuator's fixed end.

        Parameters
        ----------
        estimator : CoarseToFineEstimator
            With the networks.
        end_regressor : EndRegressor or None
            Of this actuator's moving end.
        metadata : CheckpointMetadata
            This video's (`metadata_for`).
        """
        return BaseAnchoredEstimator(
            estimator.locator,
            estimator.refiner,
            estimator.candidates,
            end_regressor,
            estimator.stages,
            fixed_xy=self.fixed_xy,
            body_px=self.body_px,
            calibration=metadata.calibration,
        )

    def base_yields(self, probe_frames: Frames, calibrated: Detections) -> bool:
        """Whether the fixed end turns, in the inliers that show it; `calibrated` is `found`, calibrated."""
        seen = self.inlier & (calibrated.likelihood[:, FIXED].min(axis=1) >= SEEN_LIKELIHOOD)
        images = [probe_frames[i] for i in np.flatnonzero(seen).tolist()]
        return base_yields(images, self.found.xy[seen, FIXED], self.view.region)

    def pseudo_labels(
        self,
        probe_frames: Frames,
        metadata: CheckpointMetadata,
        estimator: CoarseToFineEstimator,
        base_is_held: bool = True,
    ) -> PseudoLabels:
        """Pseudo-labels for self-training, from what an estimator anchored at the fixed end finds."""
        metadata = self.metadata_for(metadata)
        geometry = CropGeometry(self.view.region, metadata.reference)
        found = self.anchored_estimator(estimator, None, metadata).detect(probe_frames, geometry)
        found = metadata.calibrated(found, geometry)
        plausible = _moving_end_plausible(found.xy, self.fixed_xy, self.body_px, self.end_px)
        likelihood = found.likelihood.copy()
        likelihood[:, MOVING] = np.where(plausible[:, None], likelihood[:, MOVING], 0.0)
        unsure: BoolArray = likelihood < WRONG_END
        # Unsure points between the ends, and a fixed end that is hidden, are neither positives nor negatives.
        xy = np.where(unsure[..., None], np.nan, found.xy)
        xy[:, MOVING] = found.xy[:, MOVING]
        fixed = found.xy[:, FIXED]
        if base_is_held:
            fixed = np.median(self.found.xy[self.inlier, FIXED], axis=0)
        xy[:, FIXED] = np.where(unsure[:, FIXED, None], np.nan, fixed)
        anchored = _at_fixed_end(found.xy, self.fixed_xy, self.body_px)
        positive = self.inlier & anchored & (likelihood[:, MOVING].min(axis=1) >= SURE_END)
        return PseudoLabels(xy, np.asarray(positive), unsure[:, MOVING])


@dataclass(frozen=True)
class RegionView:
    """What the locator found in the probe frames within one region.

    Attributes
    ----------
    region : RegionOfInterest
    xy : ndarray of float, shape (N, K, 2)
        Chains from the fixed end, px.
    clear : ndarray of bool, shape (N,)
        Frames in which most keypoints are seen.
    anchored : ndarray of bool, shape (N,)
        Clear frames whose fixed end is at the common place.
    fixed_xy : ndarray of float, shape (2,)
        That place, px.
    score : float
        Mean likelihood of the keypoints, counting anchored frames only; 0 to 1.
    """

    region: RegionOfInterest
    xy: FloatArray
    clear: BoolArray
    anchored: BoolArray
    fixed_xy: FloatArray
    score: float


def multi_frame_consensus(
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
    known: KnownEnds | None = None,
) -> Consensus:
    """Find the actuator that most probe frames agree on.

    Parameters
    ----------
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB.
    metadata, estimator
        Of a network whose keypoints are a chain from the fixed end to the moving end.
    known : KnownEnds, optional
        From labels in some of these frames, in which the keypoints then stay where they are labelled.

    Raises
    ------
    VideoError
        Too little is seen.
    """
    motion = motion_evidence(probe_frames) if estimator.stages.motion_evidence else None
    if motion is None or not motion.is_known:
        return _consensus(probe_frames, metadata, estimator, None, known)
    try:
        return _consensus(probe_frames, metadata, estimator, motion, known)
    except VideoError:
        # What moves is no actuator: hands at work, say, next to one that rests.
        return _consensus(probe_frames, metadata, estimator, None, known)


def _consensus(
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
    motion: MotionEvidence | None,
    known: KnownEnds | None,
) -> Consensus:
    """The consensus of the chains that fit what moves; of any where no motion is given."""
    h, w = probe_frames[0].shape[:2]
    likelihood = metadata.calibration.likelihood

    def candidates(region: RegionOfInterest) -> tuple[FloatArray, FloatArray, FloatArray]:
        xy, peak = estimator.candidate_peaks(probe_frames, region)
        likely = likelihood(peak)
        if known is not None:
            xy, likely = known.put_in(xy, likely)
        return xy, likely, np.ones(peak.shape) if motion is None else motion.at(xy)

    def search(region: RegionOfInterest) -> RegionView:
        return _view_of(region, *likeliest_points(*candidates(region)))

    def search_chains(xy: FloatArray, fixed_xy: FloatArray | None, body_px: float) -> RegionView:
        """The better of two scales in the region of chains (N, K, 2) px."""

        def at(side: int) -> RegionView:
            region = _fitting_region(xy, (w, h), side, body_px)
            found, peaks, moving = candidates(region)
            chains = assemble_chain(found, peaks, fixed_xy, body_px, moving)
            return _view_of(region, *chains, None if known is None else known.fixed_xy)

        small, large = (at(side) for side in BODY_SIDES)
        return large if large.score > small.score + CLEARLY_MORE else small

    if known is not None:
        around = known.fixed_xy + known.body_px * np.array([[[-1, -1], [1, 1]]])
        best = search_chains(np.clip(around, 0, (w - 1, h - 1)), known.fixed_xy, known.body_px)
        xy = _anchored_chains(best)
        best = search_chains(xy, known.fixed_xy, _body_px(xy))
    else:
        whole = [
            RegionOfInterest((w, h), 0, 0, w, h, min(1.0, side / max(w, h)), 1.0) for side in FIRST_SIDES
        ]
        best = max((search(region) for region in whole), key=lambda view: view.score)
        # Twice more around the actuator, at the scale that fits it. Points found one by one do not say yet where it
        # is fixed: their first may lie on something else.
        for is_anchored in (False, True):
            xy = _anchored_chains(best)
            fixed_xy = best.fixed_xy if is_anchored or motion is None else None
            best = search_chains(xy, fixed_xy, _body_px(xy))
    body_px = _body_px(_anchored_chains(best))
    found = estimator.refine(probe_frames, best.xy, CropGeometry(best.region, metadata.reference))
    fixed_xy = np.median(found.xy[best.anchored, 0], axis=0)
    end_px = float(np.median(lengths_px(found.xy[best.anchored][:, MOVING])))
    inlier = best.anchored & inlier_mask(found.xy, fixed_xy, body_px, end_px)
    return Consensus(best, found, inlier, fixed_xy, body_px, end_px)


def from_fixed_end(
    xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Chains (N, K, 2) px and likelihoods (N, K), reversed where the last keypoint is the one at the fixed end."""
    distance = np.linalg.norm(xy[:, [0, -1]] - fixed_xy, axis=2)
    reverse = distance[:, 0] > distance[:, 1]
    return (
        np.where(reverse[:, None, None], xy[:, ::-1], xy),
        np.where(reverse[:, None], likelihood[:, ::-1], likelihood),
    )


def _body_px(xy: FloatArray) -> float:
    """Median length of the body along chains (N, K, 2) px; 0 without any.

    A keypoint that lies far away in one of them adds little to its length.
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
    """Frames (N,) whose chains (N, K, 2) px are this actuator.

    They begin at the fixed end, reach no further than the body can, and have a moving end of the right length.
    """
    return np.asarray(
        _at_fixed_end(xy, fixed_xy, body_px) & _moving_end_plausible(xy, fixed_xy, body_px, end_px)
    )


def _moving_end_plausible(xy: FloatArray, fixed_xy: FloatArray, body_px: float, end_px: float) -> BoolArray:
    """Frames (N,) in which the moving end of chains (N, K, 2) px is within reach and of the right length."""
    length = lengths_px(xy[:, MOVING])
    right_length = (length >= SHORTEST * end_px) & (length <= LONGEST * end_px)
    within_reach = np.linalg.norm(xy[:, -1] - fixed_xy, axis=1) <= MAX_REACH * body_px
    return np.asarray(right_length & within_reach)


def _at_fixed_end(xy: FloatArray, fixed_xy: FloatArray, body_px: float) -> BoolArray:
    """Frames (N,) whose chains (N, K, 2) px begin at the fixed end."""
    return np.asarray(np.linalg.norm(xy[:, 0] - fixed_xy, axis=1) <= ANCHOR_SHARE * body_px)


def _view_of(
    region: RegionOfInterest, xy: FloatArray, likelihood: FloatArray, fixed_xy: FloatArray | None = None
) -> RegionView:
    """Take single frames together: where the fixed end is, if that is not known, and in which frames it is there."""
    clear = np.median(likelihood, axis=1) >= SEEN_LIKELIHOOD
    if fixed_xy is None:
        fixed_xy = _static_end(xy[clear]) if clear.any() else np.full(2, np.nan)
    xy, likelihood = from_fixed_end(xy, likelihood, fixed_xy)
    anchored = clear & _at_fixed_end(xy, fixed_xy, _body_px(xy[clear]))
    score = float(np.where(anchored, likelihood.mean(axis=1), 0.0).mean())
    return RegionView(region, xy, clear, anchored, fixed_xy, score)


def _anchored_chains(view: RegionView) -> FloatArray:
    """Chains (M, K, 2) px of the anchored frames.

    Raises
    ------
    VideoError
        There are too few.
    """
    clear, anchored = (100 * float(share.mean()) for share in (view.clear, view.anchored))
    if clear < 100 * MIN_SEEN_SHARE:
        raise VideoError(
            f"expected an actuator in sight, got one in {clear:.0f} % of the frames looked at; label one frame:"
            " `bendtrack angle --label`"
        )
    if anchored < 100 * MIN_SEEN_SHARE:
        raise VideoError(
            f"expected an actuator that is held at one end, got one there in {anchored:.0f} % of the frames looked"
            " at; label one frame: `bendtrack angle --label`"
        )
    return view.xy[view.anchored]


def _fitting_region(
    xy: FloatArray, frame_wh: tuple[int, int], body_side: int, body_px: float
) -> RegionOfInterest:
    """Where bodies found at (N, K, 2) px can be, at the scale at which they are `body_side` input px long."""
    region = region_of_interest(xy, frame_wh, body_px)
    fits = body_side / max(body_px, 1.0), FIRST_SIDES[-1] / max(region.width, region.height)
    return replace(region, locator_scale=min(1.0, *fits))


def _static_end(xy: FloatArray) -> FloatArray:
    """Position (2,) of the end that does not move; the network's first one where neither is clearly static.

    The network may take one end for the other in any of the frames: a place is static when in most of them either end
    lies there.
    """
    ends = xy[:, [0, -1]]
    # From each end in each frame to the nearer end in every frame: (N, 2, N).
    distance = np.linalg.norm(ends[:, :, None, None] - ends, axis=-1).min(axis=3)
    motion = np.median(distance, axis=2)
    best = motion.argmin(axis=0)
    end = 1 if motion[best[1], 1] < STATIC_SHARE * motion[best[0], 0] else 0
    fixed_xy: FloatArray = ends[best[end], end]
    return fixed_xy
