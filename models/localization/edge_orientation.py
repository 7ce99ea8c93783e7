"""The direction of a straight end, estimated from its two edges, in videos without labels.

On an actuator that it has not learnt, a network makes much the same error in every frame. The edges of an end are
visible in all frames, and clear in their mean crop, in which the background of a moving end is blurred. An end may
taper and have round corners, the same on both sides: the bisector of both edges is the direction of the end.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.stats import theilslopes

from ...tracker.types import FloatArray, ImageArray, IntArray

SMOOTH_PX = 1.2
"""Standard deviation of the smoothing that removes noise and the pixel grid, px."""

BEGIN, END = -0.45, 0.4
"""The part of an end that is used, as shares of its length from its centre: without corners and clamp."""

NEAREST_PX = 3
"""Least distance of an edge from the end's centre line, px."""

TURNS_DEG = np.linspace(-10.0, 10.0, 81)
"""Turns of an edge from the expected direction that are tried, degrees."""

MAX_TURN_DEG = 8.0
"""An edge that is turned further belongs to something else."""

MIN_CONTRAST = 0.1
"""Least contrast across an edge, squared grey levels per px^2."""

COLUMNS, MIN_COLUMNS = 16, 6
"""Positions along an end at which its edges are located one by one; with fewer the end is too short."""

REACH_PX = 4
"""Largest distance of an edge at one of these positions from its line along the whole end, px."""

LINE_PX = 2.0
"""Blur or bend of an edge along the whole end that is tolerated, px."""

EDGE_PX, WINDOW_PX = 2.5, 6
"""Width of an edge (standard deviation), and how far to each side of it is compared, px."""

TAPER_DEG, TAPER_SD_DEG = 0.8, 1.0
"""Usual taper of each edge and its standard deviation, degrees, for ends with one visible edge or two that disagree."""

SIDES_SD_DEG = 0.4
"""Standard deviation of the bisector about the end's direction, degrees, however clear both edges are."""

LINE_SD = 2.5
"""Factor on the standard deviation of a line fitted to an edge: neighbouring positions are not independent."""

NETWORK_SD_DEG = 1.5
"""Standard deviation of a network's error in an end's direction on an actuator that it has not learnt, degrees."""


def orientation_from_edges(crops: Sequence[ImageArray], length_px: float) -> float:
    """Estimate an end's direction from its edges.

    The estimate is shrunk toward 0 by the ratio of its variance to the network's.

    Parameters
    ----------
    crops : sequence of ndarray of uint8, shape (side, side, 3)
        High-resolution crops, the end's centre in theirs and the end about along x.
    length_px : float
        Length of the end in them, px.

    Returns
    -------
    float
        Turn from the x direction, rad, toward y.
    """
    mean = cv2.GaussianBlur(np.mean(crops, axis=0, dtype=np.float32), (0, 0), SMOOTH_PX)
    turn_deg, sd_deg = _best_turn(mean, length_px)
    return float(np.radians(turn_deg * NETWORK_SD_DEG**2 / (NETWORK_SD_DEG**2 + sd_deg**2)))


def _best_turn(image: FloatArray, length_px: float) -> tuple[float, float]:
    """The most certain estimate of the turn, from both edges or from one, and its standard deviation, degrees."""
    middle = (len(image) - 1) / 2
    begin, end = np.clip(np.rint(middle + length_px * np.array([BEGIN, END])), 0, len(image) - 1)
    columns = np.unique(np.linspace(begin, end, COLUMNS).astype(int))
    if len(columns) < MIN_COLUMNS:
        return 0.0, np.inf
    along = columns - middle
    contrast = _line_contrast(image, columns)
    upper, lower = (_edge(image, columns, contrast, sign) for sign in (-1, 1))
    estimates = []
    if upper is not None and lower is not None:
        turn_deg, sd_deg = _line(along, (upper + lower) / 2)
        taper_deg, _ = _line(along, (upper - lower) / 2)
        unusual_deg = max(0.0, abs(taper_deg - TAPER_DEG) - 2 * TAPER_SD_DEG)
        estimates.append((turn_deg, float(np.hypot(sd_deg, unusual_deg / 2))))
    for side, tapering in ((upper, TAPER_DEG), (lower, -TAPER_DEG)):
        if side is not None:
            turn_deg, sd_deg = _line(along, side)
            estimates.append((turn_deg - tapering, float(np.hypot(sd_deg, TAPER_SD_DEG))))
    return min(estimates, key=lambda turn: turn[1], default=(0.0, np.inf))


def _line(along: FloatArray, across: FloatArray) -> tuple[float, float]:
    """Turn of a line fitted robustly to positions (Theil-Sen), and its standard deviation, degrees."""
    slope, _, low, high = theilslopes(across, along, alpha=0.68)
    sd = np.hypot(LINE_SD * np.degrees(high - low) / 2, SIDES_SD_DEG)
    return float(np.degrees(np.arctan(slope))), float(sd)


def _edge(image: FloatArray, columns: IntArray, contrast: FloatArray, sign: int) -> FloatArray | None:
    """Position of one edge of an end in some columns, px below the image's centre; None without a clear edge.

    Parameters
    ----------
    image, columns
        The mean crop, and the columns.
    contrast : ndarray of float
        From `_line_contrast`.
    sign : int
        -1 for the edge above, +1 for the edge below.
    """
    middle = (len(image) - 1) / 2
    one_side = np.where(sign * (np.arange(len(image)) - middle) >= NEAREST_PX, contrast, 0.0)
    best, row = np.unravel_index(int(np.argmax(one_side)), one_side.shape)
    turn_deg = float(TURNS_DEG[best])
    if abs(turn_deg) > MAX_TURN_DEG or one_side[best, row] < MIN_CONTRAST:
        return None
    lean = np.tan(np.radians(turn_deg))
    offset = _edge_offset(_level(image, turn_deg), columns, int(row))
    return row - middle + lean * (columns - middle) + offset


def _line_contrast(image: FloatArray, columns: IntArray) -> FloatArray:
    """Contrast across straight lines through some columns, by turn (`TURNS_DEG`) and row at the centre."""
    contrasts = []
    for turn_deg in TURNS_DEG:
        profile = _level(image, turn_deg)[:, columns[0] : columns[-1] + 1].mean(axis=1)
        contrast = np.square(np.gradient(profile, axis=0)).sum(axis=1, keepdims=True)
        contrasts.append(cv2.GaussianBlur(contrast, (0, 0), LINE_PX)[:, 0])
    return np.stack(contrasts)


def _edge_offset(level: FloatArray, columns: IntArray, row: int) -> FloatArray:
    """Distance of an edge below a row in some columns, px, where it correlates best with its mean."""
    margin = WINDOW_PX + REACH_PX
    edges = np.pad(np.gradient(level, axis=0), ((margin, margin), (0, 0), (0, 0)))
    edges = edges[row : row + 2 * margin + 1]
    window = slice(REACH_PX, -REACH_PX)
    weight = np.exp(-0.5 * np.square(np.arange(-WINDOW_PX, WINDOW_PX + 1) / EDGE_PX))
    usual = weight[:, None] * edges[window, columns[0] : columns[-1] + 1].mean(axis=1)
    correlation = np.stack(
        [
            np.einsum("wxc,wc->x", edges[shift : shift + len(usual)], usual)
            for shift in range(2 * REACH_PX + 1)
        ]
    )
    width = max(1, (columns[-1] - columns[0]) // COLUMNS)
    return _argmax_rows(cv2.blur(correlation, (width, 1))[:, columns]) - REACH_PX


def _level(image: FloatArray, turn_deg: float) -> FloatArray:
    """The image sheared about its centre so that a line with this turn is level."""
    lean, middle = np.tan(np.radians(turn_deg)), (len(image) - 1) / 2
    shear = np.array([[1.0, 0.0, 0.0], [lean, 1.0, -lean * middle]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = image.shape[1], image.shape[0]
    return cv2.warpAffine(image, shear, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _argmax_rows(values: FloatArray) -> FloatArray:
    """Row of each column's maximum (N, M) -> (M,), interpolated by a parabola through three rows."""
    rows = np.clip(values.argmax(axis=0), 1, len(values) - 2)
    before, here, after = (values[rows + step, np.arange(values.shape[1])] for step in (-1, 0, 1))
    bend = before - 2 * here + after
    return rows + np.clip(0.5 * (before - after) / np.where(bend < 0, bend, -np.inf), -0.5, 0.5)
