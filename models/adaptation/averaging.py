"""A network that has learnt an actuator by itself, held back by what it said before.

What it learnt from carries the errors of the network that found it, and it adds its own. It sees the actuator where
that one does not; where both see it in the same place, it lies halfway. (In six looks of the training families angles
are off by 1.8 degrees so, by 2.1 as the taught network says alone.)
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import Detections, ImageArray
from ..inference.coarse_to_fine import AGREED_PATCH_PX, Predictor


class AveragedPredictor:
    """A reader of patches that sees what `taught` sees, halfway to where `before` sees the same."""

    def __init__(self, taught: Predictor, before: Predictor) -> None:
        self._taught = taught
        self._before = before

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8."""
        found, before = self._taught(pictures), self._before(pictures)
        near = np.linalg.norm(found.xy - before.xy, axis=2, keepdims=True) <= AGREED_PATCH_PX
        return Detections(
            np.where(near, (found.xy + before.xy) / 2, found.xy), found.likelihood, found.covariance
        )
