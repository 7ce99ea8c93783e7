"""Where the body is, exactly: a midline of circular arcs in the plane, and its way through the camera."""

from __future__ import annotations

import math

import numpy as np

from ...types import FloatArray
from .arc_chain import ArcChain
from .look import Body, Place, View

SEGMENTS = 24
KEYPOINTS = ("base_1", "base_2", "mid_1", "mid_2", "mid_3", "mid_4", "mid_5", "tip_1", "tip_2")
# The two points of each end, and where they are among `KEYPOINTS`.
END_KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
ENDS = [KEYPOINTS.index(name) for name in END_KEYPOINTS]
# Points of the dense midline.
DENSE = 96
# Middles of the arcs along the bend, and turns that add up to nothing, whose sizes add up to 1.
_U = (np.arange(SEGMENTS) + 0.5) / SEGMENTS
_THERE_AND_BACK = np.cos(np.pi * _U) / np.abs(np.cos(np.pi * _U)).sum()


def _turns_rad(body: Body, bend_deg: float) -> FloatArray:
    """Turn of each arc, (SEGMENTS,)."""
    weight = 1 + body.focus * np.exp(-np.square((_U - body.centre) / body.spread))
    turns: FloatArray = math.radians(bend_deg) / weight.sum() * weight
    return turns + math.radians(body.s_turn_deg) * _THERE_AND_BACK


def tightest(body: Body, bend_deg: float) -> float:
    """Largest curvature of the midline, 1/px, as if it did not stretch."""
    bending_px = body.length_px * (1 - body.base_share - body.tip_share)
    return float(np.abs(_turns_rad(body, bend_deg)).max()) * SEGMENTS / bending_px


class Chain(ArcChain):
    """The midline in the plane at one bend: a straight base, `SEGMENTS` arcs, a straight tip.

    Parameters
    ----------
    body, place : Body or Place
        Shape and place.
    bend_deg : float
        Turn from the base's direction to the tip's, positive toward `place.side`.

    Attributes
    ----------
    length_px : from where the body leaves the clamp to its end
    keypoint_s : ndarray
        (9,) where the `KEYPOINTS` are.
    end_xy : ndarray
        (2,) where it ends.
    """

    def __init__(self, body: Body, place: Place, bend_deg: float) -> None:
        base, tip = body.base_share * body.length_px, body.tip_share * body.length_px
        bending = body.length_px - base - tip + body.stretch * body.half_px * math.radians(max(bend_deg, 0.0))
        super().__init__(
            base,
            bending / SEGMENTS,
            _turns_rad(body, bend_deg),
            math.radians(bend_deg),
            place.base_xy,
            math.radians(place.direction_deg),
            place.side,
        )
        self.length_px = base + bending + tip
        self.keypoint_s = np.array([0.0, *(base + bending * np.arange(7) / 6), self.length_px])
        self.end_xy = self.origin[-1] + tip * self.along[-1]
        self._half_px, self._taper = body.half_px, body.taper

    def half_px_at(self, s: FloatArray) -> FloatArray:
        """Half thickness at s."""
        half: FloatArray = self._half_px * (1 - self._taper * np.clip(s / self.length_px, 0, 1))
        return half


def opposite(place: Place) -> Place | None:
    """Where the second arm of a gripper begins: mirrored, beside the first."""
    if place.second_arm is None:
        return None
    back, aside, turn_deg = place.second_arm
    heading = math.radians(place.direction_deg)
    cos, sin = math.cos(heading), math.sin(heading)
    # The arms bend toward each other: the second lies on the inner side of the first.
    x = place.base_xy[0] + back * cos - place.side * aside * sin
    y = place.base_xy[1] + back * sin + place.side * aside * cos
    return Place((x, y), place.direction_deg + place.side * turn_deg, -place.side, None)


class Projection:
    """From the plane to the image and back, both in closed form.

    A plane tilted about the image's axes, seen in perspective, then a lens after the division model of
    Fitzgibbon (CVPR 2001): undistorted = distorted / (1 + lens x distorted radius^2), lengths over the
    image's larger side, from its centre.
    """

    def __init__(self, view: View, size_wh: tuple[int, int]) -> None:
        self._centre = (np.asarray(size_wh, float) - 1) / 2
        self._unit = float(max(size_wh))
        self._lens = view.lens
        ax, ay = math.radians(view.tilt_x_deg), math.radians(view.tilt_y_deg)
        near = view.nearness
        self._matrix = np.array(
            [
                [math.cos(ay), math.sin(ax) * math.sin(ay), 0.0],
                [0.0, math.cos(ax), 0.0],
                [-near * math.sin(ay), near * math.sin(ax) * math.cos(ay), 1.0],
            ]
        )
        self._inverse = np.linalg.inv(self._matrix)

    def to_image(self, plane_xy: FloatArray) -> FloatArray:
        """Position in the image of points of the plane, (..., 2) px both."""
        p = (plane_xy - self._centre) / self._unit
        p = p @ self._matrix[:, :2].T + self._matrix[:, 2]
        p = p[..., :2] / p[..., 2:]
        if self._lens:
            r2 = np.square(p).sum(axis=-1, keepdims=True)
            p = p * 2 / (1 + np.sqrt(np.maximum(1 - 4 * self._lens * r2, 0)))
        result: FloatArray = p * self._unit + self._centre
        return result

    def to_plane(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points of the plane that are seen at points of the image; keeps the dtype."""
        unit, (cx, cy), m = self._unit, self._centre.tolist(), self._inverse.tolist()
        x, y = (x - cx) * (1 / unit), (y - cy) * (1 / unit)
        if self._lens:
            less = 1 / (1 + self._lens * (x * x + y * y))
            x, y = x * less, y * less
        w = unit / (m[2][0] * x + m[2][1] * y + m[2][2])
        return (m[0][0] * x + m[0][1] * y + m[0][2]) * w + cx, (m[1][0] * x + m[1][1] * y + m[1][2]) * w + cy


def turn_in_image_deg(keypoints_xy: FloatArray, midline_xy: FloatArray) -> float:
    """Turn from base_2 - base_1 to tip_2 - tip_1, clockwise on the screen positive, whole turns from the midline."""
    step = np.diff(midline_xy, axis=0)
    x, y, next_x, next_y = step[:-1, 0], step[:-1, 1], step[1:, 0], step[1:, 1]
    along_body = float(np.arctan2(x * next_y - y * next_x, x * next_x + y * next_y).sum())
    base, tip = keypoints_xy[1] - keypoints_xy[0], keypoints_xy[8] - keypoints_xy[7]
    turn = math.atan2(tip[1], tip[0]) - math.atan2(base[1], base[0])
    whole = round((along_body - turn) / (2 * math.pi))
    return math.degrees(turn + 2 * math.pi * whole)
