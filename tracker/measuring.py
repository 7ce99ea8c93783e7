"""From detections to the rows of an angle table: the angle, its standard deviation, the flag.

Shared by videos (`tracking.py`) and live sources (`live/low_latency.py`). The angle itself is in `angle.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .angle import AngleDefinition, bending_angle
from .errors import AngleError
from .types import BoolArray, Correlation, Detections, Flag, FloatArray

# DeepLabCut's pcutoff, which users know.
MIN_LIKELIHOOD = 0.6

JUMP_FRAMES, JUMP_SD = 2, 3.0
"""An angle jumps that is so many standard deviations off the median of itself and so many frames on each side."""


class AngleRows(NamedTuple):
    """What an angle table says of T frames: (T,) degrees, degrees, values of `types.Flag`.

    Attributes
    ----------
    angle_deg, angle_sd_deg : ndarray of float
        (T,) degrees, NaN where unknown.
    flag : NDArray[np.str_]
        (T,) values of `types.Flag`.
    """

    angle_deg: FloatArray
    angle_sd_deg: FloatArray
    flag: NDArray[np.str_]


def check_points(keypoints: Sequence[str], definition: AngleDefinition) -> None:
    """See that a detector finds the points of an angle.

    Parameters
    ----------
    keypoints : sequence of str
        Names of the keypoints that the detector finds.
    definition : AngleDefinition
        Which angle, of which points.

    Raises
    ------
    AngleError
        A point of the angle is not among the keypoints.
    """
    missing = [point for point in definition.points if point not in keypoints]
    if missing:
        raise AngleError(
            f"the angle needs keypoint '{missing[0]}', the detector finds {', '.join(keypoints)}"
        )


def measure(
    found: Detections,
    keypoints: Sequence[str],
    definition: AngleDefinition,
    size_wh: tuple[int, int],
    *,
    decoded: np.ndarray,
    damaged: np.ndarray,
    min_likelihood: float = MIN_LIKELIHOOD,
    check_jumps: bool = False,
    correlations: Sequence[Correlation] = (),
) -> AngleRows:
    """The bending angle of frames, with a flag on every row that is missing or to be doubted.

    Parameters
    ----------
    found : Detections
        Keypoints of T frames; NaN where a frame could not be decoded.
    keypoints : sequence of str
        The K names.
    definition : AngleDefinition
        Which angle, of which of the keypoints.
    size_wh : tuple of (int, int)
        Width and height of the frames, px.
    decoded, damaged : ndarray of bool
        (T,) whether a frame was decoded, and whether only from a damaged one (see `types.Flag`).
    min_likelihood : float, optional
        A row with a keypoint of the angle below this is flagged `low_likelihood`.
    check_jumps : bool, optional
        Whether the temporal-consistency check runs: a row whose angle differs from those of the frames around it
        is flagged `jump`.
    correlations : sequence of Correlation, optional
        As `bending_angle`'s.

    Returns
    -------
    AngleRows
        Angle, standard deviation and flag of each frame.
    """
    angle_deg, angle_sd_deg, coincident = bending_angle(
        found.xy, keypoints, definition, found.covariance, correlations
    )
    chain = [keypoints.index(point) for point in definition.points]
    outside = is_outside(found.xy[:, chain], size_wh).any(axis=1)
    for lost in (coincident, outside):
        angle_deg[lost] = angle_sd_deg[lost] = np.nan
    with np.errstate(invalid="ignore"):
        unlikely = (found.likelihood[:, chain] < min_likelihood).any(axis=1) | np.isnan(angle_deg)
    jumped = _jumped(angle_deg, angle_sd_deg) if check_jumps else np.zeros(len(angle_deg), bool)
    flag = np.select(
        [~decoded, coincident, outside, damaged, unlikely, jumped],
        [
            *(Flag.UNDECODABLE, Flag.COINCIDENT_POINTS, Flag.OUT_OF_FRAME, Flag.DAMAGED),
            *(Flag.LOW_LIKELIHOOD, Flag.JUMP),
        ],
        default=Flag.NONE,
    )
    return AngleRows(angle_deg, angle_sd_deg, flag)


def _jumped(angle_deg: FloatArray, sd_deg: FloatArray) -> np.ndarray:
    """Rows (T,) that differ from their neighbours in time; a continuous motion, however fast, is no jump."""
    around = np.pad(angle_deg, JUMP_FRAMES, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * JUMP_FRAMES + 1)
    known = ~np.isnan(angle_deg)
    jumped = np.zeros(len(angle_deg), bool)
    away = np.abs(angle_deg[known] - np.nanmedian(windows[known], axis=1))
    jumped[known] = away > JUMP_SD * sd_deg[known]
    return jumped


def is_outside(xy: FloatArray, size_wh: tuple[int, int]) -> BoolArray:
    """Which positions lie outside the frame, which ends half a px beyond the centres of its outer pixels.

    Parameters
    ----------
    xy : ndarray of float
        (..., 2) px.
    size_wh : tuple of (int, int)
        Width and height of the frame, px.

    Returns
    -------
    ndarray of bool
        (...); False where a position is NaN.
    """
    with np.errstate(invalid="ignore"):
        outside = (xy < -0.5) | (xy > np.array(size_wh) - 0.5)
    return np.asarray(outside.any(axis=-1))
