"""Finding an actuator that nobody has labelled: where in a video it is, how large, and which of its ends is fixed.

A network that knows actuators in general (`pretraining.py`) finds canonical points in single pictures. A video tells
more: the fixed end is the one that does not move, so it is where all glimpses together say, and the actuator is the
same one all the time. What comes out is a header for this video, with which the network is put to work like any other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, Detections, FloatArray, Frames
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.crops import CLOSER, crop_end, move_ends
from ..inference.metadata import CheckpointMetadata
from ..inference.roi import RegionOfInterest
from .base_anchor import BaseAnchoredEstimator
from .edge_orientation import orientation_from_edges
from .probe_frames import (
    FIXED,
    MOVING,
    Consensus,
    PseudoLabels,
    inlier_mask,
    lengths_px,
    multi_frame_consensus,
)

MIN_INLIER_SHARE = 0.6
"""Share of the glimpses that must show the same actuator, or the angles would be mostly guessed, and guesses learnt."""

LEAST_SURE, MOST_SURE = 8, 0.95
"""Glimpses that an actuator is learnt from: so many, but not such a share that there is nothing to learn: then the
network is about as exact as it is."""

ACROSS_SHARE = 0.55
"""How far ends lie off across their direction that were seen closer and turned by their sides, as a share of what the
network says of itself (rms over the frames of a video; 26 of 38 looks of the training families err less, one in ten
more than 1.4 times as much). It knows nothing of either."""

Closer = Callable[[Frames, FloatArray, BoolArray, RegionOfInterest], tuple[FloatArray, EndRegressor | None]]
"""From glimpses, positions (N, K, 2) px found in them, which count, and the region: better ones, and what tells in
other frames how the moving end lies."""

Taught = Callable[[Frames, PseudoLabels, RegionOfInterest], CoarseToFineEstimator | None]
"""From glimpses, what can be learnt by them, and the region: a finder that has learnt it, None where that fails."""


@dataclass(frozen=True)
class LocalizedActuator:
    """An actuator in a video.

    Attributes
    ----------
    header : the network's for this video: region, the angle's sign, usual peaks, the moving end's length
    finder : knows where the fixed end is, and the body's length
    fixed : the fixed end's points (1, 2), calibrated, and turned as its sides say
    end_px : length of the moving end
    turn_rad : by which the moving end is to be turned, from x toward y, to point along its sides
    across_share : of what the network says of itself, how far the moving end lies off across its direction
    seen : share of the glimpses in which the actuator was seen, held where it is in the others and of one shape
    """

    header: CheckpointMetadata
    finder: BaseAnchoredEstimator
    fixed: Detections
    end_px: float
    turn_rad: float
    across_share: float
    seen: float

    def believed(self, found: Detections) -> Detections:
        """What was found in frames of the video, with the fixed end where it rests and the moving one turned right.

        Nothing is believed of a frame that shows another actuator.
        """
        same = inlier_mask(found.xy, self.finder.fixed_xy, self.finder.body_px, self.end_px)
        xy, likelihood, covariance = found.xy.copy(), found.likelihood.copy(), found.covariance.copy()
        xy[:, FIXED], likelihood[:, FIXED] = self.fixed.xy, self.fixed.likelihood
        covariance[:, FIXED] = self.fixed.covariance
        xy[:, MOVING] = _turned(xy[:, MOVING], self.turn_rad)
        covariance[:, MOVING] = _narrowed(covariance[:, MOVING], xy[:, MOVING], self.across_share)
        return Detections(xy, np.where(same[:, None], likelihood, 0.0), covariance)


def find_actuator(
    probe_frames: Frames,
    header: CheckpointMetadata,
    finder: CoarseToFineEstimator,
    closer: Closer | None = None,
    taught: Taught | None = None,
) -> LocalizedActuator:
    """Find the actuator in frames spread over a video.

    Parameters
    ----------
    glimpses : (N, H, W, 3) uint8 RGB, of one size
    header, finder : of a network whose keypoints are a chain from the fixed end to the moving one
    closer : looks closer at the moving end (`models.unlabelled`); None leaves that to the finder
    taught : teaches a network this actuator that is not sure of it everywhere (`models.unlabelled`); None does not

    Raises
    ------
    VideoError
        No actuator can be seen.
    """
    shown = _agreed_on(probe_frames, header, finder)
    # Of a network that learnt from labels, where ends lie and how they point is what those say.
    learnt = not header.pretrained
    if not learnt and taught is not None:
        examples = shown.examples(probe_frames, header, finder)
        if examples.right.sum() >= LEAST_SURE and examples.right.mean() < MOST_SURE:
            finder, shown = _again(
                probe_frames, header, (finder, shown), taught(probe_frames, examples, shown.look.region)
            )
    same, region = shown.same, shown.look.region
    xy, align = shown.found.xy, finder.align
    if not learnt and closer is not None:
        xy, align = closer(probe_frames, xy, same, region)
    header = shown.header_from(header)
    fixed = _resting(header.calibration.apply(shown.found), same)
    fixed_rad, moving_rad = (
        0.0 if learnt else _turn_rad(probe_frames, xy[:, end], same, region) for end in (FIXED, MOVING)
    )
    fixed.xy[:] = _turned(fixed.xy, fixed_rad)
    across = 1.0 if learnt or align is None else ACROSS_SHARE
    fixed.covariance[:] = _narrowed(fixed.covariance, fixed.xy, across)
    knowing = shown.finder_from(finder, align, header)
    return LocalizedActuator(header, knowing, fixed, shown.end_px, moving_rad, across, float(same.mean()))


def _agreed_on(probe_frames: Frames, header: CheckpointMetadata, finder: CoarseToFineEstimator) -> Consensus:
    """What the glimpses show together, if they show one actuator; VideoError as `sight`."""
    shown = multi_frame_consensus(probe_frames, header, finder)
    if shown.same.mean() < MIN_INLIER_SHARE:
        raise VideoError(
            f"expected an actuator that keeps its shape, got one that does in {100 * shown.same.mean():.0f} % of the"
            " frames looked at; label some frames: `bendtrack new`"
        )
    return shown


def _again(
    probe_frames: Frames,
    header: CheckpointMetadata,
    before: tuple[CoarseToFineEstimator, Consensus],
    finder: CoarseToFineEstimator | None,
) -> tuple[CoarseToFineEstimator, Consensus]:
    """A finder that has learnt the actuator and what the glimpses show to it, unless that is less than before."""
    if finder is None:
        return before
    try:
        shown = _agreed_on(probe_frames, header, finder)
    except VideoError:
        return before
    return (finder, shown) if shown.same.sum() >= before[1].same.sum() else before


def _turn_rad(probe_frames: Frames, ends: FloatArray, same: BoolArray, region: RegionOfInterest) -> float:
    """By which ends (N, 2, 2) px are to be turned, from x toward y, to point along their sides, as the glimpses that
    count say together."""
    chosen = np.flatnonzero(same).tolist()
    length_px = CLOSER * region.refiner_scale * float(np.median(lengths_px(ends[chosen])))
    return orientation_from_edges(
        [crop_end(probe_frames[i], ends[i], region).picture for i in chosen], length_px
    )


def _turned(ends: FloatArray, turn_rad: float) -> FloatArray:
    """Ends (N, 2, 2) px turned about their middles."""
    return move_ends(ends, np.tile([0.0, 0.0, turn_rad], (len(ends), 1)), 1.0)


def _narrowed(covariance: FloatArray, ends: FloatArray, share: float) -> FloatArray:
    """Covariances (N, 2, 2, 2) px**2 of ends (N, 2, 2) px, the deviations across their directions made smaller."""
    along = ends[:, 1] - ends[:, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    kept = share * np.eye(2) + (1 - share) * along[:, :, None] * along[:, None, :]
    return np.asarray(kept[:, None] @ covariance @ kept[:, None])


def _resting(found: Detections, same: BoolArray) -> Detections:
    """The fixed end's two points (1, 2), as the glimpses (N,) that count say together; as likely as these are many.

    They err alike, so what all say is hardly more exact than what one says.
    """
    xy, covariance = (np.median(part[same, FIXED], axis=0)[None] for part in (found.xy, found.covariance))
    return Detections(xy, np.full((1, 2), same.mean()), covariance)
