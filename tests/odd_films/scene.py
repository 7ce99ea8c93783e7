"""What the odd films show, and a detector that needs no network: four coloured discs on a textured ground.

The truth is drawn, never measured: `angle_deg` gives the angle at any time. Files are in `encoding.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.types import Detections, Frames, ImageArray

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
ANGLE = AngleDefinition("two-vector", KEYPOINTS)
FRAMES, RATE = 30, 30
SIZE_WH = (160, 120)

_COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], np.uint8)
_RADIUS_PX = 7.0
# L1 distance in RGB below which a pixel belongs to a disc: far beyond what chroma subsampling changes.
_NEAR = 200


def angle_deg(time_s: np.ndarray | float) -> np.ndarray:
    """The angle (degrees) at a time: from 0 to 120 and back in a second, 12.5 degrees between frames at most."""
    return np.asarray(60 - 60 * np.cos(2 * np.pi * np.asarray(time_s)))


def centres_xy(angle: float, size_wh: tuple[int, int] = SIZE_WH) -> np.ndarray:
    """Centres (4, 2) of the discs in px: a level base, and an end that is turned by the angle (degrees).

    Lengths follow the frame's height, so that the angle is right in every frame wider than high.
    """
    width, height = size_wh
    unit = min(width, height * 4 / 3)
    base = np.array([[0.5 * width - 0.3 * unit, 0.3 * height], [0.5 * width - 0.05 * unit, 0.3 * height]])
    half, turn = np.radians(angle / 2), np.radians(angle)
    tip = base[1] + 0.18 * unit * np.array([np.cos(half), np.sin(half)])
    return np.stack([*base, tip, tip + 0.2 * unit * np.array([np.cos(turn), np.sin(turn)])])


def draw(
    angle: float,
    size_wh: tuple[int, int] = SIZE_WH,
    *,
    noise_seed: int | None = None,
    pixel_aspect: float = 1.0,
) -> ImageArray:
    """An image (H, W, 3) of the scene at an angle (degrees).

    Parameters
    ----------
    angle : float
        Degrees.
    size_wh : tuple of (int, int)
        Size as stored, px.
    noise_seed : int or None
        Seed of the camera's noise; None draws without.
    pixel_aspect : float
        Width over height of a pixel as displayed: the scene is right once it is stretched so.
    """
    width, height = size_wh
    ground = np.random.default_rng(7).normal(0, 1, (height // 4 + 2, width // 4 + 2))
    texture = np.kron(ground, np.ones((4, 4)))[:height, :width] * 12 + 95
    image = np.repeat(texture[:, :, None], 3, axis=2)
    if noise_seed is not None:
        image += np.random.default_rng(noise_seed).normal(0, 1.5, image.shape)
    y, x = np.mgrid[:height, :width].astype(float)
    x = (x + 0.5) * pixel_aspect - 0.5
    scale = min(width * pixel_aspect, height * 4 / 3) / SIZE_WH[0]
    displayed_wh = (round(width * pixel_aspect), height)
    for (u, v), colour in zip(centres_xy(angle, displayed_wh), _COLOURS, strict=True):
        inside = np.clip(_RADIUS_PX * scale - np.hypot(x - u, y - v) + 0.5, 0, 1)[:, :, None]
        image = image * (1 - inside) + inside * colour
    return np.clip(image, 0, 255).astype(np.uint8)


class DiscDetector:
    """Finds the discs by their colour; a disc that is not seen has likelihood 0."""

    keypoints = KEYPOINTS
    batch_size = 8
    provenance: Mapping[str, Any] = {"name": "coloured discs"}

    def detect(self, frames: Frames) -> Detections:
        """Centroid of the pixels of each colour."""
        xy = np.full((len(frames), 4, 2), np.nan)
        likelihood = np.zeros((len(frames), 4))
        for n, image in enumerate(frames):
            signed = np.asarray(image).astype(np.int16)
            for k, colour in enumerate(_COLOURS.astype(np.int16)):
                v, u = np.nonzero(np.abs(signed - colour).sum(axis=2) < _NEAR)
                if len(u):
                    # Single pixels elsewhere that damage gave the colour do not count.
                    near = np.hypot(u - np.median(u), v - np.median(v)) < 2 * _RADIUS_PX * max(
                        1, image.shape[0] / 120
                    )
                    if near.any():
                        xy[n, k] = u[near].mean(), v[near].mean()
                        likelihood[n, k] = 1.0
        covariance = np.broadcast_to(0.04 * np.eye(2), (len(frames), 4, 2, 2)).copy()
        return Detections(xy, likelihood, covariance)
