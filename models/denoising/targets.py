"""Where keypoints are in the frames trained on, as far as the labels and what a network finds there tell together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..data.prepared import PreparedFrame
from ..inference.coarse_to_fine import CoarseToFineEstimator, concatenated
from ..inference.crops import CropGeometry
from ..inference.tta import FlipAugmentedPredictor
from ..networks.end_regressor import EndRegressionNetwork
from ..networks.heatmap_network import FirstStage
from .end_regression import fit_end_regression
from .registration import register_ends
from .robust_fit import denoised_positions


@dataclass(frozen=True)
class TargetDenoiser:
    """What N frames with labels tell of K keypoints.

    Attributes
    ----------
    frames, pictures, videos : the frames, and which video each is from; `frames[i].xy` are the labels
    partner : from `regions.partners`
    consensus : how far positions follow what the network finds, from 0 to 1
    features : what moving ends are compared by; None leaves them
    """

    frames: Sequence[PreparedFrame]
    pictures: Sequence[ImageArray]
    videos: Sequence[str]
    reference: Sequence[int]
    consensus: float
    features: FirstStage | None

    @property
    def labels(self) -> FloatArray:
        """(N, K, 2) px, NaN where not labelled."""
        return np.stack([frame.xy for frame in self.frames])

    @property
    def patch_scale(self) -> FloatArray:
        """Patch px per px of the frames, (N,)."""
        return np.array([frame.region.refiner_scale for frame in self.frames])

    def known_before(self, estimator: CoarseToFineEstimator, known: BoolArray) -> FloatArray:
        """Positions (N, K, 2) px by a network that knows some of the keypoints before it has learnt anything here.

        estimator : CoarseToFineEstimator
            With that network.
        known : (K,), which it knows
        """
        labels = self.labels
        labelled: BoolArray = np.logical_not(np.isnan(labels).any(axis=2))
        both = labelled & labelled[:, list(self.reference)] & known
        near = np.where(both[..., None], labels, np.nan)
        # What comes with bendtrack was pretrained with mirrored pictures.
        estimator = replace(estimator, refiner=FlipAugmentedPredictor(estimator.refiner))
        found = [
            estimator.refine(picture[None], own[None], CropGeometry(frame.region, tuple(self.reference)))
            for picture, own, frame in zip(self.pictures, near, self.frames, strict=True)
        ]
        return self.less_noisy(concatenated(found).xy)

    def less_noisy(self, found: FloatArray) -> FloatArray:
        """The labels less their noise, as far as `consensus` says, from what was found (N, K, 2) px."""
        labels = self.labels
        return labels + self.consensus * (self.believed(found)[0] - labels)

    def believed(self, found: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Positions (N, K, 2) px from what was found, and which of them (N, K) are not just the label."""
        better, counts = denoised_positions(self.labels, found, self.reference, self.patch_scale, self.videos)
        if self.features is not None:
            better = register_ends(self.frames, better, counts, self.reference, self.videos, self.features)
        return better, counts

    def aligner(self, found: FloatArray, seed: int) -> EndRegressionNetwork | None:
        """What tells from closer pictures how moving ends lie, learnt from what was found (N, K, 2) px; None where
        there are none whose pictures do. Needs `features`."""
        assert self.features is not None
        xy, counts = self.believed(found)
        regions = [frame.region for frame in self.frames]
        return fit_end_regression(
            self.pictures, regions, xy, counts, self.reference, self.videos, self.features, seed
        )
