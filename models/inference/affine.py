"""Affine views: where in a frame a network looks, as a map from frame px to the network's input px.

Both maps speak of pixel centres (see the glossary in `tracker/types.py`), so a resize by s carries x to
(x + 0.5) s - 0.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...tracker.types import FloatArray, ImageArray

PATCH_SIDE = 64
"""Side of the refiner's square input, px."""


@dataclass(frozen=True)
class View:
    """An affine map from one image's px to another's, and the other's size.

    Attributes
    ----------
    matrix : ndarray of float64, shape (2, 3)
        p_input = matrix[:, :2] @ p_source + matrix[:, 2].
    size_wh : tuple of int
        Width and height of the input, px.
    """

    matrix: FloatArray
    size_wh: tuple[int, int]

    def cut(self, image: ImageArray) -> ImageArray:
        """What the view shows of an image (H, W, 3), bilinear; outside the image its border is repeated."""
        return cv2.warpAffine(
            image, self.matrix, self.size_wh, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )

    def to_input(self, xy: FloatArray) -> FloatArray:
        """Positions (..., 2) of the source in input px."""
        return xy @ self.matrix[:, :2].T + self.matrix[:, 2]

    def to_source(self, xy: FloatArray) -> FloatArray:
        """Positions (..., 2) of the input in source px."""
        return (xy - self.matrix[:, 2]) @ np.linalg.inv(self.matrix[:, :2]).T

    def after(self, first: View) -> View:
        """This view of what `first` shows, as one view."""
        matrix = self.matrix[:, :2] @ first.matrix
        matrix[:, 2] += self.matrix[:, 2]
        return View(matrix, self.size_wh)


def centred_view(
    centre_xy: FloatArray, size_wh: tuple[int, int], scale: float = 1.0, angle_rad: float = 0.0
) -> View:
    """A view with `centre_xy` in its middle, scaled, and turned so that direction `angle_rad` points right."""
    c, s = np.cos(angle_rad) * scale, np.sin(angle_rad) * scale
    turn = np.array([[c, s], [-s, c]])
    middle = (np.array(size_wh) - 1) / 2
    return View(np.column_stack([turn, middle - turn @ centre_xy]), size_wh)


def patch_view(centre_xy: FloatArray, zoom: float, turn_rad: float) -> View:
    """The refiner's square view around a position, direction `turn_rad` to the right."""
    return centred_view(centre_xy, (PATCH_SIDE, PATCH_SIDE), zoom, turn_rad)


def resized_view(scale: float, offset_xy: tuple[int, int], size_wh: tuple[int, int]) -> View:
    """What `resize` does to the part of an image that begins at `offset_xy`, as a view."""
    shift = 0.5 * scale - 0.5 - scale * np.array(offset_xy, dtype=float)
    return View(np.column_stack([np.eye(2) * scale, shift]), size_wh)


def stacked(images: Sequence[ImageArray]) -> ImageArray:
    """Images (H, W, 3) of one size in the networks' order, (N, 3, H, W)."""
    return np.ascontiguousarray(np.stack(images).transpose(0, 3, 1, 2))


def resize(image: ImageArray, scale: float) -> ImageArray:
    """An image shrunk by exactly `scale`, at most 1 (its last column and row may be cut), without aliasing."""
    if scale == 1.0:
        return image
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
