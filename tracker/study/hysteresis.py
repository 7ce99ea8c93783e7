"""Numbers of one angle-pressure loop: its area, ratios and width. Pure geometry of arrays.

A loop is (N, 2): pressure in kPa, angle in degrees, in the order of time, from lowest pressure to lowest pressure.
The loops and the uncertainty of the numbers are in `measured_cycles.py` and `dynamic.py`.
"""

from __future__ import annotations

import numpy as np

from ..types import FloatArray

# The width at mid pressure is read from a parabola through this fraction of the range on either side.
_MID_FRACTION = 0.15


def loop_area_deg_kpa(loop: FloatArray) -> float:
    """Cumulative hysteresis: the area within a loop, deg kPa; positive where the angle lags the pressure.

    Shoelace formula on the closed polygon. Noise of the angle that is independent from frame to frame does not
    bias it. Source: the study's section on dynamic analysis ("area within the leaf").

    Parameters
    ----------
    loop : ndarray of float
        (N, 2) kPa and deg, closed implicitly.

    Returns
    -------
    float
        Area, deg kPa.
    """
    pressure, angle = loop[:, 0], loop[:, 1]
    return float(np.sum(pressure * np.roll(angle, -1) - np.roll(pressure, -1) * angle)) / 2


def hysteresis_ratio(area_deg_kpa: float, largest_pressure_kpa: float, largest_angle_deg: float) -> float:
    """The paper's ratio: area over the rectangle from the axes to the largest pressure and angle; 0 to 1.

    NaN where there is no such rectangle (a largest pressure or angle that is not above 0).

    Parameters
    ----------
    area_deg_kpa : float
        Area of the loop.
    largest_pressure_kpa : float
        The trial's largest pressure.
    largest_angle_deg : float
        The trial's largest angle.

    Returns
    -------
    float
        Fraction of the rectangle.
    """
    if not (largest_pressure_kpa > 0 and largest_angle_deg > 0):
        return float("nan")
    return area_deg_kpa / (largest_pressure_kpa * largest_angle_deg)


def hysteresis_ratio_extremes(
    area_deg_kpa: float, pressures_kpa: tuple[float, float], angles_deg: tuple[float, float]
) -> float:
    """Area over the rectangle between the loop's own smallest and largest pressure and angle; 0 to 1.

    Not the paper's ratio: the two agree only for a loop that begins at 0 kPa and 0 degrees.

    Parameters
    ----------
    area_deg_kpa : float
        Area of the loop.
    pressures_kpa : tuple of (float, float)
        Smallest and largest pressure.
    angles_deg : tuple of (float, float)
        Smallest and largest angle.

    Returns
    -------
    float
        Fraction of the rectangle; NaN for an empty rectangle.
    """
    rectangle = (pressures_kpa[1] - pressures_kpa[0]) * (angles_deg[1] - angles_deg[0])
    return area_deg_kpa / rectangle if rectangle > 0 else float("nan")


def mid_pressure_width_deg(up: FloatArray, down: FloatArray, low_kpa: float, high_kpa: float) -> float:
    """Angle while unloading minus angle while loading, half way between two pressures, deg.

    Parameters
    ----------
    up, down : ndarray of float
        (N, 2) kPa and deg, the loading and the unloading branch.
    low_kpa, high_kpa : float
        Lowest and largest pressure of the cycle.

    Returns
    -------
    float
        NaN where a branch has fewer than four pressures near the middle.
    """
    middle, reach = (low_kpa + high_kpa) / 2, _MID_FRACTION * (high_kpa - low_kpa)
    at = [_parabola_at(branch, middle, reach) for branch in (up, down)]
    return at[1] - at[0]


def _parabola_at(branch: FloatArray, pressure_kpa: float, reach_kpa: float) -> float:
    off = (branch[:, 0] - pressure_kpa) / reach_kpa
    near = np.abs(off) <= 1
    if np.unique(off[near]).size < 4 or not (off[near].min() < 0 < off[near].max()):
        return float("nan")
    x = off[near]
    powers = np.stack([np.ones_like(x), x, x * x])
    return float(np.linalg.solve(powers @ powers.T, powers @ branch[near, 1])[0])
