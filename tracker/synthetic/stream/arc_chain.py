"""A chain of circular arcs, mapped from body coordinates to the plane and back, in closed form.

All truth of a rendered image starts here. Bodies, keypoints and the camera are in `chain.py`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray


class ArcChain:
    """A straight base, circular arcs of one length, a straight tip without an end, in image px.

    Parameters
    ----------
    base_px, arc_px : float
        Length of the base and of each arc.
    turn_rad : ndarray
        (N,) turn of each arc, toward the inner side.
    whole_rad : float
        Their sum, which carries no rounding: the tip's direction.
    base_xy, direction_rad : tuple of float or float
        Where the base begins and its direction, from +x toward +y.
    side : int
        +1 turns clockwise on the screen, -1 counterclockwise.

    Attributes
    ----------
    s : ndarray
        (P,) where the pieces begin; piece 0 is the base, the last the tip.
    curvature : ndarray
        (P,) 1/px, positive toward the inner side.
    heading : ndarray
        (P,) direction where each piece begins, radians, not wrapped.
    origin, along, inward : ndarray
        (P, 2) where each piece begins, its direction there, and the inner normal there.
    """

    def __init__(
        self,
        base_px: float,
        arc_px: float,
        turn_rad: FloatArray,
        whole_rad: float,
        base_xy: tuple[float, float],
        direction_rad: float,
        side: int,
    ) -> None:
        self.side = side
        self.s = np.concatenate([[0.0], base_px + arc_px * np.arange(len(turn_rad) + 1)])
        self.curvature = np.concatenate([[0.0], turn_rad / arc_px, [0.0]])
        turned = np.concatenate([[0.0, 0.0], np.cumsum(turn_rad)])
        turned[-1] = whole_rad
        heading = direction_rad + side * turned
        self.heading = heading
        self.along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        self.inward = side * np.stack([-self.along[:, 1], self.along[:, 0]], axis=1)
        lengths = np.diff(self.s)
        chord = self._local(np.arange(len(lengths)), lengths)
        steps = chord[:, :1] * self.along[:-1] + chord[:, 1:] * self.inward[:-1]
        self.origin = np.asarray(base_xy) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    def _local(self, piece: NDArray[np.intp], length: FloatArray) -> FloatArray:
        """Along and inward offset after `length` on each piece, (N, 2). sinc keeps straight pieces exact."""
        half = 0.5 * self.curvature[piece] * length
        chord = length * np.sinc(half / np.pi)
        return np.stack([chord * np.cos(half), chord * np.sin(half)], axis=-1)

    def heading_at(self, s: FloatArray) -> FloatArray:
        """Direction of the midline at s, radians from +x toward +y, not wrapped."""
        piece = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        heading: FloatArray = self.heading[piece] + self.side * self.curvature[piece] * (s - self.s[piece])
        return heading

    def point(self, s: FloatArray | float, t: FloatArray | float = 0.0) -> FloatArray:
        """Image position of body coordinates, (..., 2) px."""
        s, t = np.broadcast_arrays(np.asarray(s, dtype=float), np.asarray(t, dtype=float))
        piece = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        local = self._local(piece, s - self.s[piece])
        heading = self.heading_at(s)
        outward = self.side * np.stack([np.sin(heading), -np.cos(heading)], axis=-1)
        on_line = (
            self.origin[piece] + local[..., :1] * self.along[piece] + local[..., 1:] * self.inward[piece]
        )
        result: FloatArray = on_line + t[..., None] * outward
        return result

    def body_coordinates(
        self, x: FloatArray, y: FloatArray, piece: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """s and t of image points, each seen from its piece. The inverse of `point`.

        Each piece is taken from its middle, so that the arctangent stays within a few degrees and a short
        series is exact to 1e-6 px for turns up to 20 degrees a piece.
        """
        middle = np.append(0.5 * (self.s[:-1] + self.s[1:]), self.s[-1])
        origin = self.point(middle)
        heading = self.heading_at(middle)
        cos, sin = np.cos(heading), np.sin(heading)
        dtype = x.dtype

        def of(table: FloatArray) -> FloatArray:
            return table.astype(dtype).take(piece)

        dx, dy = x - of(origin[:, 0]), y - of(origin[:, 1])
        c, d = of(cos), of(sin)
        k = of(self.curvature)
        along = dx * c + dy * d
        inward = (dy * c - dx * d) * self.side
        flat = along / (1 - k * inward)
        z2 = np.square(k * flat)
        s = of(middle) + flat * (1 - z2 * (1 / 3 - z2 * (1 / 5 - z2 / 7)))
        q = k * (along * along + inward * inward) - 2 * inward
        t = q / (1 + np.sqrt(np.maximum(1 + k * q, 0)))
        return s, t
