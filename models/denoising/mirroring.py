"""Mirrored prediction: each crop is predicted as it is and mirrored, and both predictions are averaged.

For networks pretrained on mirrored images, at the first guess of what to train on. Both sides of an actuator look alike
to such a network, so errors that depend on the side cancel.
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import Detections, ImageArray
from ..inference.coarse_to_fine import Predictor

AGREEMENT_CROP_PX = 8.0
"""Two predictions further apart, in crop px, are not of the same thing: the likelier one is taken, not the mean."""


class MirroredPredictor:
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
        plain, mirrored = _halves(self._predictor(np.concatenate([images, images[:, :, ::-1]])))
        flipped_back = Detections(
            np.stack([mirrored.xy[..., 0], height - 1 - mirrored.xy[..., 1]], axis=-1),
            mirrored.likelihood,
            mirrored.covariance * np.array([[1, -1], [-1, 1]]),
        )
        return average_predictions(plain, flipped_back)


def _halves(both: Detections) -> tuple[Detections, Detections]:
    """The first and the second half of detections (2 N, K)."""
    n = len(both.xy) // 2
    first, second = (
        Detections(both.xy[side], both.likelihood[side], both.covariance[side])
        for side in (slice(n), slice(n, None))
    )
    return first, second


def average_predictions(first: Detections, second: Detections) -> Detections:
    """The mean of two predictions (N, K) of the same keypoints, or the likelier one where they are not of one thing."""
    near = np.linalg.norm(second.xy - first.xy, axis=2) <= AGREEMENT_CROP_PX
    weight = np.where(near, 0.5, first.likelihood >= second.likelihood)
    return Detections(
        weight[..., None] * first.xy + (1 - weight[..., None]) * second.xy,
        weight * first.likelihood + (1 - weight) * second.likelihood,
        weight[..., None, None] * first.covariance + (1 - weight[..., None, None]) * second.covariance,
    )
