"""A network that is asked twice about every patch, as it is and mirrored, where nobody has labelled anything.

Both sides of an actuator are alike to a network that was pretrained with mirrored pictures: what it takes one for the
other in by chance cancels. (On rendered looks the ends' directions are off by a fifth less.)
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import Detections, ImageArray
from .coarse_to_fine import AGREED_PATCH_PX, Predictor, agreed, halves


class FlipAugmentedPredictor:
    """A reader of square patches whose keypoints' direction is upright, that asks another one about both sides."""

    def __init__(self, reader: Predictor) -> None:
        self._reader = reader

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8."""
        height = pictures.shape[2]
        one, other = halves(self._reader(np.concatenate([pictures, pictures[:, :, ::-1]])))
        turned_back = Detections(
            np.stack([other.xy[..., 0], height - 1 - other.xy[..., 1]], axis=-1),
            other.likelihood,
            other.covariance * np.array([[1, -1], [-1, 1]]),
        )
        return agreed(one, turned_back, AGREED_PATCH_PX)
