"""Flip test-time augmentation: each crop is predicted as it is and mirrored, and both predictions are averaged.

For networks pretrained on mirrored images, in videos without labels. Both sides of an actuator look alike to such a
network, so errors that depend on the side cancel. On rendered actuators the ends' directions are off by a fifth less.
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import Detections, ImageArray
from .coarse_to_fine import AGREEMENT_CROP_PX, Predictor, average_predictions, halves


class FlipAugmentedPredictor:
    """A predictor that averages another one over both mirror images of a square, upright crop.

    Parameters
    ----------
    predictor : Predictor
        Asked for both images of every crop.
    """

    def __init__(self, predictor: Predictor) -> None:
        self._predictor = predictor

    def __call__(self, images: ImageArray) -> Detections:
        """Predict every keypoint in images (N, 3, H, W) uint8."""
        height = images.shape[2]
        plain, mirrored = halves(self._predictor(np.concatenate([images, images[:, :, ::-1]])))
        flipped_back = Detections(
            np.stack([mirrored.xy[..., 0], height - 1 - mirrored.xy[..., 1]], axis=-1),
            mirrored.likelihood,
            mirrored.covariance * np.array([[1, -1], [-1, 1]]),
        )
        return average_predictions(plain, flipped_back, AGREEMENT_CROP_PX)
