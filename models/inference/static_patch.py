"""Whether a patch still shows what it showed: then its keypoint is where it was, and need not be looked for again.

The fixed end of an actuator does not move, and between two pulses nothing does.
"""

from __future__ import annotations

from functools import cached_property

import cv2
import numpy as np

from ...tracker.types import FloatArray, ImageArray
from .affine import PATCH_SIDE

WINDOW_PX = 10.0
"""Standard deviation of the window around the patch's middle in which pictures are compared."""

STILL_PX = 0.05
"""A picture that moved by less, in patch px, did not move."""

STILL_LEVELS = 2.0
"""Root mean square difference in grey levels that noise and compression make of a still picture."""

_MIDDLE = slice(PATCH_SIDE // 2 - 20, PATCH_SIDE // 2 + 20)
"""What the window reaches."""

_AXIS = np.exp(-0.5 * ((np.arange(PATCH_SIDE)[_MIDDLE] - (PATCH_SIDE - 1) / 2) / WINDOW_PX) ** 2)
_WINDOW: FloatArray = np.outer(_AXIS, _AXIS).astype(np.float32) / np.float32(_AXIS.sum() ** 2)


class StaticPatchTest:
    """A patch as it was when its keypoint was found in it.

    Parameters
    ----------
    picture : (PATCH_SIDE, PATCH_SIDE, 3) uint8 RGB
    """

    def __init__(self, picture: ImageArray) -> None:
        self._picture = picture

    def is_still(self, picture: ImageArray) -> bool:
        """Whether a later picture of the same place shows the same, but for noise and the light's level."""
        difference = _grey(picture) - self._grey
        difference -= float(np.vdot(_WINDOW, difference))
        if float(np.vdot(_WINDOW, difference**2)) > STILL_LEVELS**2:
            return False
        weighted, inverse = self._least_squares
        shift = inverse @ (weighted @ difference.ravel())
        return float(shift @ shift) <= STILL_PX**2

    # Most patches are never compared with another: what that takes is made when it is needed.
    @cached_property
    def _grey(self) -> FloatArray:
        return _grey(self._picture)

    @cached_property
    def _least_squares(self) -> tuple[FloatArray, FloatArray]:
        """Shift = -inverse @ weighted @ difference (Lucas & Kanade 1981), weighted by the window."""
        slopes = np.array(np.gradient(self._grey))[::-1]
        weighted = (slopes * _WINDOW).reshape(2, -1)
        normal = weighted @ slopes.reshape(2, -1).T
        # A flat direction has no shift that could be seen: a little is added so that it has none.
        return weighted, np.linalg.inv(normal + np.eye(2) * (1e-3 * np.trace(normal) + 1e-9))


def _grey(picture: ImageArray) -> FloatArray:
    return np.asarray(cv2.cvtColor(picture[_MIDDLE, _MIDDLE], cv2.COLOR_RGB2GRAY), dtype=np.float32)
