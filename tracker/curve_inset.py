"""The small chart in a corner of the overlay: the whole curve in grey, the part up to the current frame in yellow."""

from __future__ import annotations

import cv2
import numpy as np

from . import drawing
from .drawing import DARK, WHITE, YELLOW
from .types import FloatArray, ImageArray

_PANEL_STRENGTH = 0.62


class CurveInset:
    """Angle over time, in the corner of the frame with the fewest keypoints.

    Parameters
    ----------
    time_s, angle_deg : ndarray of float
        (T,) times in s and angles in degrees of the whole video.
    xy : ndarray of float
        (T, K, 2) px keypoints, which the chart must not cover.
    size_wh : tuple of (int, int)
        Width and height of the frame, px.
    scale : float
        Scale of marks and letters; 1 for a 640 x 480 frame.
    """

    def __init__(
        self,
        time_s: FloatArray,
        angle_deg: FloatArray,
        xy: FloatArray,
        size_wh: tuple[int, int],
        scale: float,
    ) -> None:
        self._scale = scale
        letter = max(8, round(11 * scale))
        margin = round(10 * scale)
        width = min(round(0.36 * size_wh[0]), size_wh[0] - 2 * margin)
        height = min(round(0.25 * size_wh[1]), round(0.8 * width))
        self._wh = (width, height)
        self._left, self._top = _emptiest_corner(xy, size_wh, (width, height), margin)
        self.box = (self._left, self._top, self._left + width, self._top + height)

        low, high, ticks = _round_range(angle_deg)
        labels = [f"{tick:g}°".replace("-", "\N{MINUS SIGN}") for tick in ticks]
        end = f"{time_s[-1]:.1f} s"
        pad = round(7 * scale)
        letter_h = drawing.text_size("0", letter)[1]
        x0 = pad + max(drawing.text_size(label, letter)[0] for label in labels)
        x1 = width - pad - round(2 * scale)
        y0, y1 = pad + letter_h // 2, height - pad - letter_h
        # Not drawn on frames too small to read it.
        self._shown = y1 - y0 >= 2 * letter_h and x1 - x0 >= 3 * letter_h
        if not self._shown:
            self.box = (0, 0, 0, 0)
            return
        span = max(float(time_s[-1] - time_s[0]), 1e-9)
        self._x = x0 + (x1 - x0) * (time_s - time_s[0]) / span
        self._y = y1 - (y1 - y0) * (angle_deg - low) / (high - low)

        self._corners = np.zeros((height, width), np.uint8)
        _rounded(self._corners, round(6 * scale))
        # White marks (axis, letters, faint curve) are drawn once; the bright curve grows.
        self._marks = np.zeros((height, width), np.uint8)
        self._bright = np.zeros((height, width), np.uint8)
        for tick, label in zip(ticks, labels, strict=True):
            y = y1 - (y1 - y0) * (tick - low) / (high - low)
            drawing.lines(self._marks, np.array([[x0, y], [x1, y]]), (70,), 1)
            at = (x0 - pad / 3, y)
            drawing.text(self._marks[..., None], label, at, letter, (225,), anchor=(1, 0.5), halo=False)
        for label, x, lean in (("0", x0, 0.3), (end, x1 + pad / 2, 1.0)):
            at = (x, y1 + pad / 3)
            drawing.text(self._marks[..., None], label, at, letter, (225,), anchor=(lean, 0), halo=False)
        for t in range(len(time_s)):
            self._step(self._marks, t, 120, 1.0 * scale)
        # The panel's pixels become (pixel * keep + add) / 256, the only operation on most frames.
        self._keep = np.zeros((height, width, 1), np.uint16)
        self._add = np.zeros((height, width, 3), np.uint16)
        self._mix(0, width)

    def draw(self, image: ImageArray, index: int) -> None:
        """Draw the chart as of frame `index`; call for 0, 1, 2, ... in order.

        Parameters
        ----------
        image : ndarray of uint8
            RGB uint8 (H, W, 3), drawn on in place.
        index : int
            Index of the frame.
        """
        if not self._shown:
            return
        if self._step(self._bright, index, 255, 2.0 * self._scale):
            reach = 3 + round(2 * self._scale)
            self._mix(int(self._x[index - 1]) - reach, int(self._x[index]) + reach)
        part = image[self._top : self._top + self._wh[1], self._left : self._left + self._wh[0]]
        part[:] = (part * self._keep + self._add) >> 8
        if np.isfinite(self._y[index]):
            here = np.array([self._left + self._x[index], self._top + self._y[index]])
            drawing.disc(image, here, 4.2 * self._scale, DARK)
            drawing.disc(image, here, 3.0 * self._scale, YELLOW)

    def _mix(self, left: int, right: int) -> None:
        """Update `_keep` and `_add` in some columns: panel below, white marks over it, the curve on top."""
        columns = np.s_[:, max(left, 0) : right]
        keep = 1 - _PANEL_STRENGTH / 255 * self._corners[columns][..., None].astype(np.float32)
        add = (1 - keep) * np.array(DARK)
        for mask, colour in ((self._marks, WHITE), (self._bright, YELLOW)):
            alpha = mask[columns][..., None].astype(np.float32) / 255
            keep, add = keep * (1 - alpha), add * (1 - alpha) + alpha * np.array(colour)
        self._keep[columns] = np.round(256 * keep)
        self._add[columns] = np.floor(255.99 * add)

    def _step(self, layer: ImageArray, index: int, level: int, width: float) -> bool:
        """Draw the piece of the curve that ends at a frame; False where there is none (start, gaps)."""
        if index == 0 or not np.isfinite(self._y[index - 1 : index + 1]).all():
            return False
        piece = np.stack([self._x[index - 1 : index + 1], self._y[index - 1 : index + 1]], axis=1)
        drawing.lines(layer, piece, (level,), width)
        return True


def _emptiest_corner(
    xy: FloatArray, size_wh: tuple[int, int], inset_wh: tuple[int, int], margin: int
) -> tuple[int, int]:
    """Left and top of the corner with the fewest keypoints over the video; bottom right if they tie."""
    (width, height), (w, h) = size_wh, inset_wh
    corners = [
        (width - w - margin, height - h - margin),
        (margin, height - h - margin),
        (width - w - margin, margin),
    ]  # the top left holds the readout

    def count(corner: tuple[int, int]) -> int:
        inside = (xy > np.array(corner) - margin) & (xy < np.array(corner) + inset_wh + margin)
        return int(inside.all(axis=-1).sum())

    return min(corners, key=count)


def _round_range(angle_deg: FloatArray) -> tuple[float, float, list[float]]:
    """Limits of the angle axis, and two to four round ticks within them."""
    known = angle_deg[np.isfinite(angle_deg)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 90.0)
    low, high = min(low, 0.0), max(high, 10.0)
    step = next(step for step in (5, 10, 20, 30, 45, 90, 180, 360, 1e9) if (high - low) / step <= 3)
    ticks = [float(tick) for tick in np.arange(np.ceil(low / step), high / step + 1e-9) * step + 0.0]
    pad = 0.04 * (high - low)
    return low - pad, high + pad, ticks


def _rounded(mask: ImageArray, radius: int) -> None:
    """Fill a mask (h, w) except for its rounded corners."""
    height, width = mask.shape
    cv2.rectangle(mask, (radius, 0), (width - 1 - radius, height - 1), 255, -1)
    cv2.rectangle(mask, (0, radius), (width - 1, height - 1 - radius), 255, -1)
    for x in (radius, width - 1 - radius):
        for y in (radius, height - 1 - radius):
            cv2.circle(mask, (x, y), radius, 255, -1, cv2.LINE_AA)
