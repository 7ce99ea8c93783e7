"""The network's systematic bias against the labels, along each keypoint's own axes, as its end turns in the frame.

Labels are denoised with it (`denoising/robust_fit.py`). Networks trained by earlier versions are corrected by it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import FloatArray
from .roi import orientations, turned


def fourier_series(orientation_rad: FloatArray, harmonics: int) -> FloatArray:
    """The basis 1, cos, sin of 1 to `harmonics` times an orientation.

    Parameters
    ----------
    orientation_rad : ndarray of float, shape (...)
    harmonics : int

    Returns
    -------
    ndarray of float, shape (..., 1 + 2 harmonics)
    """
    turn = orientation_rad[..., None] * np.arange(1, harmonics + 1)
    return np.concatenate([np.ones((*orientation_rad.shape, 1)), np.cos(turn), np.sin(turn)], axis=-1)


def correct_bias(
    xy: FloatArray, bias: FloatArray, reference: Sequence[int], crop_scale: FloatArray | float
) -> FloatArray:
    """Positions moved by the bias of their orientation.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Predicted positions, px of the frames.
    bias : ndarray of float, shape (K, 1 + 2 H, 2)
        Coefficients of `fourier_series`, px of the upright crop, along the keypoint's direction and across it.
    reference : sequence of int
        From `roi.reference_keypoints`.
    crop_scale : float or ndarray of float, shape (N,)
        Crop px of the refiner per px of each frame.

    Returns
    -------
    ndarray of float, shape (N, K, 2)
    """
    direction = orientations(xy, reference)
    basis = fourier_series(direction, bias.shape[1] // 2)
    steps = np.einsum("nkw,kwi->nki", basis, bias)
    return xy + turned(steps / np.broadcast_to(crop_scale, len(xy))[:, None, None], direction)
