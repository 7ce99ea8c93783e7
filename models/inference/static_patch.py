"""The static-patch test: whether a crop still shows what it showed, so that its keypoint has not moved.

The fixed end of an actuator does not move, and between two pulses nothing does.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from ...tracker.types import FloatArray, ImageArray
from .affine import PATCH_SIDE

WINDOW_PX = 10.0
"""Standard deviation of the window around the crop's centre in which images are compared, px."""

MAX_SHIFT_PX = 0.05
"""An image that moved by less, in crop px, did not move."""

MAX_DIFFERENCE_LEVELS = 2.0
"""Root mean square difference in grey levels that noise and compression make of a static image."""

_CENTRE = slice(PATCH_SIDE // 2 - 20, PATCH_SIDE // 2 + 20)
"""The rows and columns that the window reaches."""

_AXIS = np.exp(-0.5 * ((np.arange(PATCH_SIDE)[_CENTRE] - (PATCH_SIDE - 1) / 2) / WINDOW_PX) ** 2)
_WINDOW: FloatArray = np.outer(_AXIS, _AXIS).astype(np.float32) / np.float32(_AXIS.sum() ** 2)


class StaticPatchTest:
    """A crop as it was when its keypoint was found in it.

    Parameters
    ----------
    image : ndarray of uint8, shape (PATCH_SIDE, PATCH_SIDE, 3)
        RGB.
    """

    def __init__(self, image: ImageArray) -> None:
        self._image = image

    def is_static(self, image: ImageArray) -> bool:
        """Whether a later crop at the same pose shows the same, up to noise and the light's level."""
        difference = _grey(image) - self._grey
        difference -= float(np.vdot(_WINDOW, difference))
        if float(np.vdot(_WINDOW, difference**2)) > MAX_DIFFERENCE_LEVELS**2:
            return False
        weighted, inverse = self._least_squares
        shift = inverse @ (weighted @ difference.ravel())
        return float(shift @ shift) <= MAX_SHIFT_PX**2

    # Most crops are never compared with another: what a comparison needs is computed at the first one.
    @cached_property
    def _grey(self) -> FloatArray:
        return _grey(self._image)

    @cached_property
    def _least_squares(self) -> tuple[FloatArray, FloatArray]:
        """Shift = -inverse @ weighted @ difference (Lucas & Kanade 1981), weighted by the window."""
        slopes = np.array(np.gradient(self._grey))[::-1]
        weighted = (slopes * _WINDOW).reshape(2, -1)
        normal = weighted @ slopes.reshape(2, -1).T
        # Along a direction without contrast no shift can be seen: a small ridge makes it zero there.
        return weighted, np.linalg.inv(normal + np.eye(2) * (1e-3 * np.trace(normal) + 1e-9))


def _grey(image: ImageArray) -> FloatArray:
    return np.asarray(cv2.cvtColor(image[_CENTRE, _CENTRE], cv2.COLOR_RGB2GRAY), dtype=np.float32)
