"""Random fields that cost next to nothing: cut from fields that are drawn once."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from ...types import FloatArray

_SIDE = 640


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], cell_px: float) -> FloatArray:
    """Random field of about unit variance that varies over `cell_px`, float32."""
    height, width = shape
    rows, columns = max(2, round(height / cell_px) + 2), max(2, round(width / cell_px) + 2)
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    field: FloatArray = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * 1.3
    return field


@lru_cache(maxsize=12)
def _pool(cell_px: float) -> FloatArray:
    """A field of unit variance, the same in every process."""
    rng = np.random.default_rng([int(10 * cell_px), 31])
    if cell_px <= 1:
        return rng.standard_normal((_SIDE, _SIDE), dtype=np.float32)
    field = smooth_noise(rng, (_SIDE, _SIDE), cell_px)
    return np.asarray(field / field.std(), np.float32)


def noise_field(rng: np.random.Generator, shape: tuple[int, int], cell_px: float = 1.0) -> FloatArray:
    """Field of about unit variance that varies over `cell_px`, (h, w) float32; read it only."""
    pool = _pool(float(cell_px))
    rows, columns = shape
    if rows > _SIDE - 8 or columns > _SIDE - 8:
        # Once mirrored, the field has no seam.
        pool = cv2.copyMakeBorder(
            pool, 0, max(rows - _SIDE + 8, 0), 0, max(columns - _SIDE + 8, 0), cv2.BORDER_REFLECT
        )
    field = _anywhere(rng, pool, shape)
    turn = int(rng.integers(4))
    # OpenCV wants a flipped field copied, and flips it faster.
    return cv2.flip(field, turn - 2) if turn else field


@lru_cache(maxsize=4)
def _sensor_pool(cell_px: float) -> FloatArray:
    rng = np.random.default_rng([int(10 * cell_px), 32])
    grey = rng.standard_normal((_SIDE, _SIDE, 1), dtype=np.float32)
    colour = rng.standard_normal((_SIDE, _SIDE, 3), dtype=np.float32)
    # The colour filter array spreads colour noise over neighbours.
    field = 0.8 * grey + 1.2 * cv2.GaussianBlur(colour, (0, 0), 0.8)
    if cell_px > 1:
        field = cv2.GaussianBlur(field, (0, 0), 0.5 * cell_px)
    return np.asarray(field / field.std(), np.float32)


def sensor_noise(rng: np.random.Generator, shape: tuple[int, int], cell_px: float) -> FloatArray:
    """Noise of unit variance as a colour camera has it, (h, w, 3) float32; read it only."""
    pool = _sensor_pool(float(cell_px))
    rows, columns = shape
    if rows > _SIDE - 8 or columns > _SIDE - 8:
        pool = np.tile(pool, (-(-(rows + 8) // _SIDE), -(-(columns + 8) // _SIDE), 1))
    return _anywhere(rng, pool, shape)


def _anywhere(rng: np.random.Generator, pool: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """A part of a pool."""
    rows, columns = shape
    top = int(rng.integers(pool.shape[0] - rows + 1))
    left = int(rng.integers(pool.shape[1] - columns + 1))
    return pool[top : top + rows, left : left + columns]
