"""Zero-shot localisation: the actuator of a video that nobody has labelled.

From probe frames spread over the video: their consensus, a network fitted to the video where it is needed, the pose of
the moving end, the direction of both ends. The result measures every frame of the video.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, Detections, FloatArray, Frames
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.crops import END_MAGNIFICATION, crop_end, move_ends
from ..inference.metadata import CheckpointMetadata
from ..inference.roi import RegionOfInterest
from .base_anchor import BaseAnchoredEstimator
from .edge_orientation import orientation_from_edges
from .probe_frames import (
    FIXED,
    MOVING,
    Consensus,
    KnownEnds,
    PseudoLabels,
    inlier_mask,
    lengths_px,
    multi_frame_consensus,
)

MIN_INLIER_SHARE = 0.6
"""Share of the probe frames that must agree on one actuator; with fewer, most angles would be guesses."""

MIN_SURE, MAX_SURE_SHARE = 8, 0.95
"""Positive probe frames that self-training needs, and the share of all from which it is not worth its time."""

ACROSS_SD_SHARE = 0.55
"""Factor on the predicted sd across the end's axis after both corrections (end regression, edge orientation): rms over
the frames of a video; 26 of 38 training looks fall below it, one in ten is more than 1.4 times above."""


class FitEnds(Protocol):
    """Registers ends over the probe frames and fits an end regressor to them."""

    def __call__(
        self,
        probe_frames: Frames,
        xy: FloatArray,
        inlier: BoolArray,
        region: RegionOfInterest,
        base_moves: bool = False,
    ) -> tuple[FloatArray, EndRegressor | None]:
        """Corrected positions, and the regressor.

        Parameters
        ----------
        probe_frames : ndarray of uint8, shape (N, H, W, 3)
        xy : ndarray of float, shape (N, K, 2)
            Positions found in them, px.
        inlier : ndarray of bool, shape (N,)
            Frames that are used.
        region : RegionOfInterest
            Of frames of this size.
        base_moves : bool, optional
            Whether the fixed end moves too, and is treated as the moving end is.
        """


FitNetwork = Callable[[Frames, PseudoLabels, RegionOfInterest], CoarseToFineEstimator | None]
"""From probe frames, their pseudo-labels and the region: an estimator fitted to the video; None where that fails."""


@dataclass(frozen=True)
class MeasuredBase:
    """A fixed end that yields, so that it is measured in every frame.

    Attributes
    ----------
    turn_rad : float
        Correction of its direction, rad, from x toward y.
    across_sd_share : float
        Factor on its predicted sd across its direction.
    """

    turn_rad: float
    across_sd_share: float


@dataclass(frozen=True)
class LocalizedActuator:
    """An actuator found in a video.

    Attributes
    ----------
    metadata : CheckpointMetadata
        The network's for this video: region, the angle's sign, reference peaks, the moving end's length.
    estimator : BaseAnchoredEstimator
        Knows the fixed end and the body's length.
    fixed : Detections
        Both points of the fixed end (1, 2), calibrated, with their direction corrected: where it is held.
    end_px : float
        Length of the moving end, px.
    turn_rad : float
        Correction of the moving end's direction, rad, from x toward y.
    across_sd_share : float
        Factor on the moving end's predicted sd across its direction.
    inlier_share : float
        Share of the probe frames that agree on this actuator.
    base : MeasuredBase or None
        How the fixed end is measured in every frame where it yields; None where it is held.
    """

    metadata: CheckpointMetadata
    estimator: BaseAnchoredEstimator
    fixed: Detections
    end_px: float
    turn_rad: float
    across_sd_share: float
    inlier_share: float
    base: MeasuredBase | None = None

    def anchored(self, found: Detections) -> Detections:
        """Calibrated detections (N, K) with the fixed end at its place and the moving end's direction corrected.

        A fixed end that yields stays where it is found, with its direction corrected and its own likelihood. A frame
        whose chain is not this actuator gets likelihoods of zero.
        """
        inlier = inlier_mask(found.xy, self.estimator.fixed_xy, self.estimator.body_px, self.end_px)
        xy, likelihood, covariance = found.xy.copy(), found.likelihood.copy(), found.covariance.copy()
        if self.base is None:
            xy[:, FIXED], likelihood[:, FIXED] = self.fixed.xy, self.fixed.likelihood
            covariance[:, FIXED] = self.fixed.covariance
        else:
            xy[:, FIXED] = _turn_ends(xy[:, FIXED], self.base.turn_rad)
            covariance[:, FIXED] = _scale_across(
                covariance[:, FIXED], xy[:, FIXED], self.base.across_sd_share
            )
        xy[:, MOVING] = _turn_ends(xy[:, MOVING], self.turn_rad)
        covariance[:, MOVING] = _scale_across(covariance[:, MOVING], xy[:, MOVING], self.across_sd_share)
        return Detections(xy, np.where(inlier[:, None], likelihood, 0.0), covariance)


def find_actuator(
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
    fit_ends: FitEnds | None = None,
    fit_network: FitNetwork | None = None,
) -> LocalizedActuator:
    """Find the actuator in probe frames spread over a video.

    Parameters
    ----------
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB.
    metadata, estimator
        Of a network whose keypoints are a chain from the fixed end to the moving end.
    fit_ends : callable, optional
        Registers the moving end over the probe frames and fits an end regressor (`adaptation/adapt.py`).
    fit_network : callable, optional
        Fits the network to the video where it is not sure of the actuator everywhere (`adaptation/adapt.py`).

    Returns
    -------
    LocalizedActuator

    Raises
    ------
    VideoError
        No actuator can be seen.
    """
    consensus = _accepted_consensus(probe_frames, metadata, estimator)
    # For a network trained on labels, the labels say where ends lie and how they point.
    zero_shot = metadata.pretrained
    yields = _base_yields(consensus, probe_frames, metadata, estimator)
    if zero_shot and fit_network is not None:
        labels = consensus.pseudo_labels(probe_frames, metadata, estimator, base_is_held=not yields)
        before = consensus
        estimator, consensus = fit_where_unsure(
            probe_frames, metadata, (estimator, consensus), labels, fit_network
        )
        if consensus is not before:
            yields = _base_yields(consensus, probe_frames, metadata, estimator)
    inlier, region = consensus.inlier, consensus.view.region
    xy, regressor = consensus.found.xy, estimator.end_regressor
    if zero_shot and fit_ends is not None:
        moves = {"base_moves": True} if yields else {}
        xy, regressor = fit_ends(probe_frames, xy, inlier, region, **moves)
    metadata = consensus.metadata_for(metadata)
    fixed = _fixed_end(metadata.calibration.apply(consensus.found), inlier)
    fixed_rad = moving_rad = 0.0
    if zero_shot and estimator.stages.edge_orientation:
        fixed_rad, moving_rad = (
            _turn_rad(probe_frames, xy[:, end], inlier, region) for end in (FIXED, MOVING)
        )
    across = ACROSS_SD_SHARE if zero_shot and regressor is not None else 1.0
    base = None
    if yields:
        # Each end has what the regressor does for it, and only that.
        base_across, across = (
            _across_sd_share(regressor, end, xy.shape[1], across) for end in (FIXED, MOVING)
        )
        base = MeasuredBase(fixed_rad, base_across)
    fixed_xy = _turn_ends(fixed.xy, fixed_rad)
    fixed = Detections(fixed_xy, fixed.likelihood, _scale_across(fixed.covariance, fixed_xy, across))
    anchored = consensus.anchored_estimator(estimator, regressor, metadata)
    return LocalizedActuator(
        metadata, anchored, fixed, consensus.end_px, moving_rad, across, float(inlier.mean()), base
    )


def _base_yields(
    consensus: Consensus,
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
) -> bool:
    """Whether the probe frames show that the fixed end turns."""
    if not estimator.stages.base_measurement:
        return False
    calibrated = consensus.metadata_for(metadata).calibration.apply(consensus.found)
    return consensus.base_yields(probe_frames, calibrated)


def _across_sd_share(regressor: EndRegressor | None, end: slice, k: int, share: float) -> float:
    """`share` where one of a chain's ends (of K keypoints) is regressed, else 1."""
    keypoints = tuple(range(k)[end])
    return share if regressor is not None and keypoints in map(tuple, regressor.ends) else 1.0


def _accepted_consensus(
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
    known: KnownEnds | None = None,
) -> Consensus:
    """The probe frames' consensus, if most of them agree on one actuator; VideoError as `find_actuator`."""
    consensus = multi_frame_consensus(probe_frames, metadata, estimator, known)
    if consensus.inlier.mean() < MIN_INLIER_SHARE:
        raise VideoError(
            f"expected an actuator that keeps its shape, got one that does in {100 * consensus.inlier.mean():.0f} %"
            " of the frames looked at; label one frame: `bendtrack angle --label`"
        )
    return consensus


def fit_where_unsure(
    probe_frames: Frames,
    metadata: CheckpointMetadata,
    before: tuple[CoarseToFineEstimator, Consensus],
    labels: PseudoLabels,
    fit_network: FitNetwork,
    known: KnownEnds | None = None,
) -> tuple[CoarseToFineEstimator, Consensus]:
    """Fit a network to the video where it is sure of the actuator in enough frames, but not in nearly all.

    Parameters
    ----------
    probe_frames, metadata
        As `find_actuator`'s.
    before : tuple of CoarseToFineEstimator and Consensus
        The network, and what it finds.
    labels : PseudoLabels
        Of that consensus.
    fit_network : callable
        As `find_actuator`'s.
    known : KnownEnds, optional
        As `multi_frame_consensus`'s.

    Returns
    -------
    tuple of CoarseToFineEstimator and Consensus
        Fitted; or `before` where there is nothing to fit, that fails, or fewer probe frames agree then.
    """
    if labels.positive.sum() < MIN_SURE or labels.positive.mean() >= MAX_SURE_SHARE:
        return before
    fitted = fit_network(probe_frames, labels, before[1].view.region)
    if fitted is None:
        return before
    try:
        consensus = _accepted_consensus(probe_frames, metadata, fitted, known)
    except VideoError:
        return before
    return (fitted, consensus) if consensus.inlier.sum() >= before[1].inlier.sum() else before


def _turn_rad(probe_frames: Frames, ends: FloatArray, inlier: BoolArray, region: RegionOfInterest) -> float:
    """Correction of the direction of ends (N, 2, 2) px, rad from x toward y, from their edges in all inliers."""
    chosen = np.flatnonzero(inlier).tolist()
    length_px = END_MAGNIFICATION * region.refiner_scale * float(np.median(lengths_px(ends[chosen])))
    crops = [crop_end(probe_frames[i], ends[i], region).image for i in chosen]
    return orientation_from_edges(crops, length_px)


def _turn_ends(ends: FloatArray, turn_rad: float) -> FloatArray:
    """Ends (N, 2, 2) px turned about their centres."""
    return move_ends(ends, np.tile([0.0, 0.0, turn_rad], (len(ends), 1)), 1.0)


def _scale_across(covariance: FloatArray, ends: FloatArray, share: float) -> FloatArray:
    """Covariances (N, 2, 2, 2) px^2 of ends (N, 2, 2) px with the sd across the ends' directions times `share`."""
    along = ends[:, 1] - ends[:, 0]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    scaled = share * np.eye(2) + (1 - share) * along[:, :, None] * along[:, None, :]
    return np.asarray(scaled[:, None] @ covariance @ scaled[:, None])


def _fixed_end(found: Detections, inlier: BoolArray) -> Detections:
    """Both points of the fixed end (1, 2): the median over the inliers, with the share of inliers as likelihood.

    All frames err alike, so the median is hardly more exact than one frame, and the covariance is one frame's.
    """
    xy, covariance = (np.median(part[inlier, FIXED], axis=0)[None] for part in (found.xy, found.covariance))
    return Detections(xy, np.full((1, 2), inlier.mean()), covariance)
