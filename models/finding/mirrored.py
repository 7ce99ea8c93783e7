"""A network that is asked twice about every patch, as it is and mirrored, where nobody has labelled anything.

Both sides of an actuator are alike to a network that was pretrained with mirrored pictures: what it takes one for the
other in by chance cancels. (On rendered looks the ends' directions are off by a fifth less.)
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import Detections, ImageArray
from .finder import Reader

AGREED_PX = 8.0
"""Positions further apart are not of the same thing: the likelier is taken."""


class MirroredReader:
    """A reader of square patches whose keypoints' direction is upright, that asks another one about both sides."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8."""
        n, height = len(pictures), pictures.shape[2]
        both = self._reader(np.concatenate([pictures, pictures[:, :, ::-1]]))
        xy, likelihood, covariance = (part[:n] for part in (both.xy, both.likelihood, both.covariance))
        other, other_likelihood = both.xy[n:].copy(), both.likelihood[n:]
        other[..., 1] = height - 1 - other[..., 1]
        other_covariance = both.covariance[n:] * np.array([[1, -1], [-1, 1]])
        agreed = np.linalg.norm(other - xy, axis=2) <= AGREED_PX
        first = agreed | (likelihood >= other_likelihood)
        second = agreed | ~first
        share = first / (first.astype(float) + second)
        return Detections(
            share[..., None] * xy + (1 - share[..., None]) * other,
            share * likelihood + (1 - share) * other_likelihood,
            share[..., None, None] * covariance + (1 - share[..., None, None]) * other_covariance,
        )
