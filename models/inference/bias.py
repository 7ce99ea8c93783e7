"""Where labels lie beside what the network finds: along each keypoint's own axes, as its end turns in the frame.

How it is told from labels is in `learning.consensus`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import FloatArray
from .roi import orientations, turned


def fourier_series(orientation_rad: FloatArray, count: int) -> FloatArray:
    """1, cosines and sines of 1 to `count` times attitudes (...), (..., 1 + 2 count)."""
    turn = orientation_rad[..., None] * np.arange(1, count + 1)
    return np.concatenate([np.ones((*orientation_rad.shape, 1)), np.cos(turn), np.sin(turn)], axis=-1)


def correct_bias(
    xy: FloatArray, offset: FloatArray, reference: Sequence[int], patch_scale: FloatArray | float
) -> FloatArray:
    """Positions (N, K, 2) px moved by offsets (K, 1 + 2 W, 2), of `waves` and in px of the upright patch.

    patch_scale : px of the refiner's patches for one px of each frame, (N,), or of all
    """
    direction = orientations(xy, reference)
    wave = fourier_series(direction, offset.shape[1] // 2)
    steps = np.einsum("nkw,kwi->nki", wave, offset)
    return xy + turned(steps / np.broadcast_to(patch_scale, len(xy))[:, None, None], direction)
