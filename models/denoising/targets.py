"""Denoised targets: where keypoints are in the frames trained on, estimated from labels, predictions and images.

Puts the steps of this floor in order; each is in its own module.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..data.prepared import PreparedFrame
from ..inference.coarse_to_fine import CoarseToFineEstimator, concatenated
from ..inference.crops import CropGeometry
from ..networks.end_regressor import EndRegressionNetwork
from ..networks.heatmap_network import FirstStage
from .end_regression import fit_end_regression
from .geometry import FrameGeometry
from .mirroring import MirroredPredictor
from .registration import register_ends
from .robust_fit import denoised_positions


@dataclass(frozen=True)
class TargetDenoiser:
    """N labelled frames, and what positions to train on follow from them.

    Attributes
    ----------
    frames : sequence of N PreparedFrame
        Their `xy` are the labels.
    images : sequence of N (H, W, 3) uint8 arrays
        The same frames as they were read, RGB.
    videos : sequence of N str
        The video that each frame is from.
    reference : sequence of K int
        From `roi.reference_keypoints`.
    consensus : float
        Share of the way from the label to the denoised position that a target goes, 0 to 1.
    features : FirstStage or None
        What moving ends are registered by; None skips registration.
    """

    frames: Sequence[PreparedFrame]
    images: Sequence[ImageArray]
    videos: Sequence[str]
    reference: Sequence[int]
    consensus: float
    features: FirstStage | None

    @cached_property
    def labels(self) -> FloatArray:
        """(N, K, 2) px, NaN where not labelled."""
        return np.stack([frame.xy for frame in self.frames])

    @cached_property
    def geometry(self) -> FrameGeometry:
        """Of the N frames."""
        return FrameGeometry.of([frame.region for frame in self.frames], self.reference, self.videos)

    def initial_targets(self, estimator: CoarseToFineEstimator, known: BoolArray) -> FloatArray:
        """Targets by a network that knows some of the keypoints before it has been trained on any label.

        Parameters
        ----------
        estimator : CoarseToFineEstimator
            With that network.
        known : (K,) bool array
            The keypoints that it knows.

        Returns
        -------
        (N, K, 2) float array
            px.
        """
        labels = self.labels
        labelled: BoolArray = np.logical_not(np.isnan(labels).any(axis=2))
        both = labelled & labelled[:, list(self.reference)] & known
        near = np.where(both[..., None], labels, np.nan)
        # The shipped network was pretrained with mirrored images, so it knows both mirror images.
        estimator = replace(estimator, refiner=MirroredPredictor(estimator.refiner))
        found = [
            estimator.refine(image[None], own[None], CropGeometry(frame.region, tuple(self.reference)))
            for image, own, frame in zip(self.images, near, self.frames, strict=True)
        ]
        return self.targets(concatenated(found).xy)

    def targets(self, found: FloatArray) -> FloatArray:
        """Positions to train on, (N, K, 2) px, from predictions (N, K, 2) px: `consensus` of the way from the labels to
        the denoised positions."""
        labels = self.labels
        return labels + self.consensus * (self.denoised(found)[0] - labels)

    def denoised(self, found: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Denoised positions from predictions.

        Parameters
        ----------
        found : (N, K, 2) float array
            Predictions, px.

        Returns
        -------
        positions : (N, K, 2) float array
            px, the moving ends registered where there are `features`.
        denoised : (N, K) bool array
            Which of them are more than the label.
        """
        positions, denoised = denoised_positions(self.labels, found, self.geometry)
        if self.features is not None:
            positions = register_ends(
                self.frames, positions, denoised, self.reference, self.videos, self.features
            )
        return positions, denoised

    def resting(self, found: FloatArray) -> FloatArray:
        """Places (N, K, 2) px of the keypoints that rest in their video, NaN of those that move.

        Parameters
        ----------
        found : (N, K, 2) float array
            Predictions, px.
        """
        positions, denoised = self.denoised(found)
        resting = np.full_like(positions, np.nan)
        for _, of_video in self.geometry.frames_by_video():
            for k in range(positions.shape[1]):
                rows = of_video & denoised[:, k]
                if rows.sum() > 1 and not np.ptp(positions[rows, k], axis=0).any():
                    resting[rows, k] = positions[rows, k]
        return resting

    def end_regressor(self, found: FloatArray, seed: int) -> EndRegressionNetwork | None:
        """The end-pose regressor, fitted on denoised positions. Needs `features`.

        Parameters
        ----------
        found : (N, K, 2) float array
            Predictions, px.
        seed : int
            Of `fit_end_regression`.

        Returns
        -------
        EndRegressionNetwork or None
            None where no moving end's pose can be regressed.
        """
        assert self.features is not None
        positions, denoised = self.denoised(found)
        regions = [frame.region for frame in self.frames]
        return fit_end_regression(
            self.images, regions, positions, denoised, self.reference, self.videos, self.features, seed
        )
