"""Are pictures interlaced, though their file does not say so? Then moving edges look like a comb.

In an interlaced picture every second line shows a moment half a frame later. Where something moves, a line is less like
its neighbours than like the lines next to these; in a progressive picture it never is. Only the lines that moved since
the picture before are looked at, in a few thousand samples of each picture, until the answer is known.
"""

from __future__ import annotations

from typing import Literal

import av
import numpy as np

from .types import FloatArray

FieldOrder = Literal["progressive", "tff", "bff"]
"""Of two fields, the top one or the bottom one is first."""

# Groups of four neighbouring lines, and samples along each.
_GROUPS, _COLUMNS = 64, 160
# Grey levels by which a sample differs from the picture before where something moves.
_MOVED = 12
# With fewer moving samples a picture says nothing.
_LEAST_MOVED = 40
# Neighbouring lines differ so much more than those two apart. 0.5 to 1.0 in progressive pictures, noise included.
_COMBED = 1.2
# So many pictures must say the same, and twice as many as say the other.
_INTERLACED, _PROGRESSIVE = 3, 12


class CombTest:
    """Takes sound pictures of one size in order, until it knows."""

    def __init__(self) -> None:
        self._last: list[FloatArray] = []
        self._layout: tuple[str, int, int] | None = None
        self._combed = self._smooth = 0
        self._top_first = 0.0

    def add(self, picture: av.VideoFrame) -> FieldOrder | None:
        """Take the next picture; None as long as it is not known."""
        layout = (picture.format.name, picture.width, picture.height)
        lines = _lines(picture)
        if lines is None:
            return "progressive"
        if layout != self._layout:
            self._last, self._layout = [], layout
        if self._last:
            self._judge(lines, self._last[-1])
        self._last = [*self._last[-2:], lines]
        if len(self._last) == 3:
            self._top_first += _top_first(*self._last)
        if self._combed >= _INTERLACED and self._combed > 2 * self._smooth:
            return "tff" if self._top_first >= 0 else "bff"
        return "progressive" if self._smooth >= _PROGRESSIVE and self._smooth > 2 * self._combed else None

    def _judge(self, lines: FloatArray, before: FloatArray) -> None:
        moved = (np.abs(lines - before) > _MOVED).any(axis=1)
        if np.count_nonzero(moved) < _LEAST_MOVED:
            return
        next_to = np.abs(np.diff(lines, axis=1)).mean(axis=1)[moved].mean()
        two_apart = np.abs(lines[:, 2:] - lines[:, :2]).mean(axis=1)[moved].mean()
        if next_to > _COMBED * two_apart:
            self._combed += 1
        else:
            self._smooth += 1


def _lines(picture: av.VideoFrame) -> FloatArray | None:
    """Samples (G, 4, C) of groups of four lines that begin with a line of the top field; None of a very low picture."""
    plane = picture.planes[0]
    if plane.height < 8:
        return None
    components = picture.format.components
    bits = components[0].bits
    wide = bits > 8
    values = np.frombuffer(memoryview(plane), "<u2" if wide else np.uint8)
    values = values.reshape(plane.height, -1)
    pixel = max(1, len(components)) if len(picture.planes) == 1 else 1
    columns = np.linspace(0, plane.width - 1, min(plane.width, _COLUMNS)).astype(int) * pixel
    groups = np.unique(np.linspace(0, (plane.height - 4) // 2, _GROUPS).astype(int)) * 2
    found = values[(groups[:, None] + np.arange(4))[:, :, None], columns].astype(np.float32)
    return found / 2.0 ** (bits - 8)


def _top_first(before: FloatArray, now: FloatArray, after: FloatArray) -> float:
    """How much better the bottom field of `now` fits between its top field and the next one than between the last two.

    Positive where the top field is first.
    """

    def top(lines: FloatArray) -> FloatArray:
        return (lines[:, 0] + lines[:, 2]) / 2

    bottom = now[:, 1]
    moved = np.abs(top(after) - top(before)) > _MOVED
    if not moved.any():
        return 0.0
    later = np.abs(bottom - (top(now) + top(after)) / 2)[moved].sum()
    earlier = np.abs(bottom - (top(before) + top(now)) / 2)[moved].sum()
    return float(earlier - later)
