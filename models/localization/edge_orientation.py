"""Which way a straight end points, told by its two sides, where nobody has labelled anything.

A network errs in much the same way in every picture of a look that it has not learnt from. The sides of an end are seen
in all of them, and their mean picture, in which what is behind a moving end blurs, shows them well. An end
may taper and its corners be round, the same on both sides: halfway between them lies the line that it points along.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.stats import theilslopes

from ...tracker.types import FloatArray, ImageArray, IntArray

SMOOTH_PX = 1.2
"""Noise and the pixels' own grid are smoothed away, standard deviation."""

BEGIN, END = -0.45, 0.4
"""Which part of an end is looked at, as shares of its length from its middle: without corners and what holds it."""

NEAREST_PX = 3
"""How far from an end's middle line its sides lie at least."""

TURNS_DEG = np.linspace(-10.0, 10.0, 81)
"""How far a side may be turned from where the end was thought to point."""

BELIEVED_DEG = 8.0
"""A side that is turned further is the edge of something else."""

FAINTEST = 0.1
"""What changes across an edge at least, in squared grey levels per px."""

COLUMNS, LEAST_COLUMNS = 16, 6
"""Places along an end at which its sides are looked for by themselves, and without how many it is too short."""

REACH_PX = 4
"""How far a side may lie at one of these places from where it lies along the whole end."""

LINE_PX = 2.0
"""An edge along the whole end may be blurred or bent by so much."""

EDGE_PX, WINDOW_PX = 2.5, 6
"""How wide an edge is (standard deviation), and how much beside it is looked at."""

TAPER_DEG, TAPER_SD_DEG = 0.8, 1.0
"""How far the sides of ends are usually turned toward each other, each: where only one is seen, and where two are that
do not fit."""

SIDES_SD_DEG = 0.4
"""How far halfway between two sides is usually turned from the end, however well they are seen."""

LINE_SD = 2.5
"""Edges lie along a line by chance only in part: its standard deviation counts so many times."""

USUAL_DEG = 1.5
"""How far a network usually errs about a look's ends."""


def orientation_from_edges(pictures: Sequence[ImageArray], length_px: float) -> float:
    """How far an end is turned from the direction to the right in pictures of it, in rad, from x toward y.

    As much of what its sides say as they are sure of, beside how far networks usually err.

    Parameters
    ----------
    pictures : (side, side, 3) uint8, the end's middle in theirs and the end about along x
    length_px : of the end in them
    """
    mean = cv2.GaussianBlur(np.mean(pictures, axis=0, dtype=np.float32), (0, 0), SMOOTH_PX)
    turn_deg, sd_deg = _seen_turn(mean, length_px)
    return float(np.radians(turn_deg * USUAL_DEG**2 / (USUAL_DEG**2 + sd_deg**2)))


def _seen_turn(picture: FloatArray, length_px: float) -> tuple[float, float]:
    """The turn in degrees that is told best, by both sides or by one, and its standard deviation."""
    middle = (len(picture) - 1) / 2
    begin, end = np.clip(np.rint(middle + length_px * np.array([BEGIN, END])), 0, len(picture) - 1)
    columns = np.unique(np.linspace(begin, end, COLUMNS).astype(int))
    if len(columns) < LEAST_COLUMNS:
        return 0.0, np.inf
    along = columns - middle
    change = _change(picture, columns)
    upper, lower = (_side(picture, columns, change, sign) for sign in (-1, 1))
    told = []
    if upper is not None and lower is not None:
        turn_deg, sd_deg = _line(along, (upper + lower) / 2)
        taper_deg, _ = _line(along, (upper - lower) / 2)
        unusual_deg = max(0.0, abs(taper_deg - TAPER_DEG) - 2 * TAPER_SD_DEG)
        told.append((turn_deg, float(np.hypot(sd_deg, unusual_deg / 2))))
    for side, tapering in ((upper, TAPER_DEG), (lower, -TAPER_DEG)):
        if side is not None:
            turn_deg, sd_deg = _line(along, side)
            told.append((turn_deg - tapering, float(np.hypot(sd_deg, TAPER_SD_DEG))))
    return min(told, key=lambda turn: turn[1], default=(0.0, np.inf))


def _line(along: FloatArray, across: FloatArray) -> tuple[float, float]:
    """Turn in degrees of the line through most of some positions, and its standard deviation."""
    slope, _, low, high = theilslopes(across, along, alpha=0.68)
    sd = np.hypot(LINE_SD * np.degrees(high - low) / 2, SIDES_SD_DEG)
    return float(np.degrees(np.arctan(slope))), float(sd)


def _side(picture: FloatArray, columns: IntArray, change: FloatArray, sign: int) -> FloatArray | None:
    """Where one side of an end lies in each of some columns, px below the picture's middle.

    change : from `_change`
    sign : -1 for the side above, +1 for that below; None where the strongest edge there is not a side
    """
    middle = (len(picture) - 1) / 2
    beside = np.where(sign * (np.arange(len(picture)) - middle) >= NEAREST_PX, change, 0.0)
    best, row = np.unravel_index(int(np.argmax(beside)), beside.shape)
    turn_deg = float(TURNS_DEG[best])
    if abs(turn_deg) > BELIEVED_DEG or beside[best, row] < FAINTEST:
        return None
    lean = np.tan(np.radians(turn_deg))
    beside_row = _beside_edge(_level(picture, turn_deg), columns, int(row))
    return row - middle + lean * (columns - middle) + beside_row


def _change(picture: FloatArray, columns: IntArray) -> FloatArray:
    """How much changes across straight lines through some columns, by turn (`TURNS_DEG`) and row in their middle."""
    changes = []
    for turn_deg in TURNS_DEG:
        profile = _level(picture, turn_deg)[:, columns[0] : columns[-1] + 1].mean(axis=1)
        change = np.square(np.gradient(profile, axis=0)).sum(axis=1, keepdims=True)
        changes.append(cv2.GaussianBlur(change, (0, 0), LINE_PX)[:, 0])
    return np.stack(changes)


def _beside_edge(level: FloatArray, columns: IntArray, row: int) -> FloatArray:
    """How far below a row an edge lies in some columns, where it looks most like its mean, px."""
    margin = WINDOW_PX + REACH_PX
    edges = np.pad(np.gradient(level, axis=0), ((margin, margin), (0, 0), (0, 0)))
    edges = edges[row : row + 2 * margin + 1]
    window = slice(REACH_PX, -REACH_PX)
    weight = np.exp(-0.5 * np.square(np.arange(-WINDOW_PX, WINDOW_PX + 1) / EDGE_PX))
    usual = weight[:, None] * edges[window, columns[0] : columns[-1] + 1].mean(axis=1)
    likeness = np.stack(
        [
            np.einsum("wxc,wc->x", edges[shift : shift + len(usual)], usual)
            for shift in range(2 * REACH_PX + 1)
        ]
    )
    width = max(1, (columns[-1] - columns[0]) // COLUMNS)
    return _highest(cv2.blur(likeness, (width, 1))[:, columns]) - REACH_PX


def _level(picture: FloatArray, turn_deg: float) -> FloatArray:
    """The picture sheared about its middle so that a line turned by so much is level."""
    lean, middle = np.tan(np.radians(turn_deg)), (len(picture) - 1) / 2
    shear = np.array([[1.0, 0.0, 0.0], [lean, 1.0, -lean * middle]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = picture.shape[1], picture.shape[0]
    return cv2.warpAffine(picture, shear, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _highest(values: FloatArray) -> FloatArray:
    """Where columns (N, M) are highest, (M,), between the rows by a parabola through three of them."""
    rows = np.clip(values.argmax(axis=0), 1, len(values) - 2)
    before, here, after = (values[rows + step, np.arange(values.shape[1])] for step in (-1, 0, 1))
    bend = before - 2 * here + after
    return rows + np.clip(0.5 * (before - after) / np.where(bend < 0, bend, -np.inf), -0.5, 0.5)
