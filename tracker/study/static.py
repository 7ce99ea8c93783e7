"""One static trial: the steady end of every stair, the angle there with its spread, and the model curve.

Source: the study's section on static analysis (angle read at each step's steady end; RMSE and NRMSE over the
range of the measured curve, at the staircase pressures of the first pressurisation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..types import FloatArray
from .intervals import NAN, Estimate, mean_of
from .trial import TrialData

# Window of the pressure's slope.
_SLOPE_S = 0.4
# Pressure is steady where it changes more slowly than this fraction of the fastest ramp.
_STEADY_FRACTION = 0.06
# Least duration of a stair, and its least distance from the stair before as a fraction of the largest step.
_SHORTEST_S, _APART_FRACTION = 0.5, 0.2
# The angle is read over the last part of a stair, from at least so many frames.
_READ_FRACTION, _FEWEST_FRAMES = 1 / 3, 5
# An angle that still moves by this many of its standard deviations while it is read has not settled.
_SETTLED_SD = 3.0
# A range within this many standard deviations of noise, or under half a kPa, is no movement.
_NOISE_RANGE, _SMALLEST_RANGE_KPA = 8.0, 0.5


@dataclass(frozen=True)
class Stair:
    """One level of the staircase, read at its steady end.

    `direction` is "up" or "down" from the stair before (the first has the direction of the next).
    `spread_deg` is the frames' standard deviation, `angle_deg` their mean with its uncertainty.

    Attributes
    ----------
    number : int
        Number of the stair, from 1.
    direction : str
        "up" or "down".
    start_s, end_s : float
        Begin and end of the steady pressure, s.
    pressure_kpa : float
        Mean pressure while the angle is read, kPa.
    angle_deg : Estimate
        Mean angle of the frames read, degrees.
    spread_deg : float
        Standard deviation of these frames, degrees.
    frames : int
        Number of these frames.
    model_angle_deg : float
        Angle of the model curve at this pressure, NaN where it has none.
    """

    number: int
    direction: str
    start_s: float
    end_s: float
    pressure_kpa: float
    angle_deg: Estimate
    spread_deg: float
    frames: int
    model_angle_deg: float


@dataclass(frozen=True)
class StaticNumbers:
    """The stairs of a trial, and the error of the model curve at those of the first pressurisation.

    `stairs_compared` counts the rising stairs within the model's range of pressures.

    Attributes
    ----------
    stairs : tuple of Stair
        All stairs, in the order of time.
    range_deg : float
        Range of the angles of the first pressurisation, degrees.
    rmse_deg : Estimate
        Root mean square of measured minus model angle, degrees.
    nrmse : Estimate
        `rmse_deg` over `range_deg`.
    stairs_compared : int
        Number of stairs in `rmse_deg`.
    warnings : tuple of str
        One sentence each.
    """

    stairs: tuple[Stair, ...]
    range_deg: float
    rmse_deg: Estimate
    nrmse: Estimate
    stairs_compared: int
    warnings: tuple[str, ...]


def measure_static(trial: TrialData) -> StaticNumbers:
    """Stairs found from the pressure alone, their angles, and the comparison with the model curve.

    Parameters
    ----------
    trial : TrialData
        The trial.

    Returns
    -------
    StaticNumbers
        The stairs and the comparison.
    """
    warnings: list[str] = []
    spans = _steady_spans(trial.time_s, trial.pressure_kpa)
    if not spans:
        warnings.append("no stair found: the pressure is never steady for half a second between moves")
    stairs: list[Stair] = []
    levels = [float(np.nanmedian(trial.pressure_kpa[first:last])) for first, last in spans]
    for number, (first, last) in enumerate(spans, start=1):
        before, after = max(number - 2, 0), min(max(number - 1, 1), len(levels) - 1)
        stair = _read(
            trial, number, first, last, "up" if levels[after] >= levels[before] else "down", warnings
        )
        if stair is not None:
            stairs.append(stair)
    return _against_model(trial, stairs, warnings)


def _steady_spans(time_s: FloatArray, pressure_kpa: FloatArray) -> list[tuple[int, int]]:
    """Frames [first, last) of each stair."""
    known = np.flatnonzero(np.isfinite(pressure_kpa))
    if known.size < 10:
        return []
    time, pressure = time_s[known], pressure_kpa[known]
    frame_s = float(np.median(np.diff(time)))
    half = max(round(_SLOPE_S / frame_s) // 2, 2)
    means = uniform_filter1d(pressure, half, mode="nearest")
    noise = 1.4826 * float(np.median(np.abs(np.diff(pressure, n=2)))) / (6 * half) ** 0.5
    if np.ptp(means) < max(_NOISE_RANGE * noise, _SMALLEST_RANGE_KPA):
        return []
    # The mean of half a window after minus that of half a window before, divided by the time between them.
    ahead, behind = np.roll(means, -(half - half // 2)), np.roll(means, half // 2 + half % 2)
    slope = np.abs(ahead - behind) / (half * frame_s)
    slope[:half], slope[-half:] = slope[half], slope[-half - 1]
    limit = max(_STEADY_FRACTION * float(slope.max()), 4 * 2**0.5 * noise / (half * frame_s))
    if limit > 0.5 * float(slope.max()):
        return []
    steady = slope <= limit
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(int), [0]])))
    spans = [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if time[b - 1] - time[a] >= _SHORTEST_S]
    merged: list[tuple[int, int]] = []
    level = [float(np.median(pressure[a:b])) for a, b in spans]
    steps = np.abs(np.diff(level))
    least = _APART_FRACTION * float(steps.max()) if steps.size else 0.0
    for index, span in enumerate(spans):
        if merged and abs(level[index] - level[index - 1]) < least:
            merged[-1] = (merged[-1][0], span[1])
        else:
            merged.append(span)
    return [(int(known[a]), int(known[b - 1]) + 1) for a, b in merged]


def _read(
    trial: TrialData, number: int, first: int, last: int, direction: str, warnings: list[str]
) -> Stair | None:
    start, end = float(trial.time_s[first]), float(trial.time_s[last - 1])
    # The very last frames may already see the next ramp.
    until = end - 2 * trial.frame_s
    since = end - _READ_FRACTION * (end - start)
    read = (trial.time_s >= since) & (trial.time_s <= until) & np.isfinite(trial.angle_deg)
    read &= np.isfinite(trial.pressure_kpa)
    pressure = float(np.nanmean(trial.pressure_kpa[first:last]))
    if read.sum() < _FEWEST_FRAMES:
        warnings.append(
            f"stair {number} at {pressure:.1f} kPa is left out: {int(read.sum())} frames with an angle at its end, "
            f"fewer than {_FEWEST_FRAMES}"
        )
        return None
    angles, times = trial.angle_deg[read], trial.time_s[read]
    angle = mean_of(angles)
    slope = float(np.polyfit(times - times.mean(), angles, 1)[0])
    moved = slope * float(np.ptp(times))
    slope_sd = float(angles.std(ddof=1)) * math.sqrt(12 / angles.size)
    if abs(moved) > _SETTLED_SD * slope_sd:
        warnings.append(
            f"stair {number} at {pressure:.1f} kPa: the angle still moves by {moved:+.2f} deg while it is read"
        )
    return Stair(
        number=number,
        direction=direction,
        start_s=start,
        end_s=end,
        pressure_kpa=float(np.mean(trial.pressure_kpa[read])),
        angle_deg=Estimate(angle.value, math.hypot(angle.sd, trial.angle_common_sd_deg), angle.dof),
        spread_deg=float(angles.std(ddof=1)),
        frames=int(read.sum()),
        model_angle_deg=_model_at(trial, float(np.mean(trial.pressure_kpa[read]))),
    )


def _model_at(trial: TrialData, pressure_kpa: float) -> float:
    """Model angle by linear interpolation; NaN outside the curve, with a tolerance for the sensor's noise."""
    if trial.model_pressure_kpa is None or trial.model_angle_deg is None:
        return NAN
    order = np.argsort(trial.model_pressure_kpa)
    pressures, angles = trial.model_pressure_kpa[order], trial.model_angle_deg[order]
    slack = 0.02 * float(np.ptp(pressures))
    if not pressures[0] - slack <= pressure_kpa <= pressures[-1] + slack:
        return NAN
    return float(np.interp(pressure_kpa, pressures, angles))


def _against_model(trial: TrialData, stairs: list[Stair], warnings: list[str]) -> StaticNumbers:
    rising: list[Stair] = []
    for stair in stairs:
        if stair.direction == "down":
            break
        rising.append(stair)
    angles = np.array([stair.angle_deg.value for stair in rising])
    range_deg = float(np.ptp(angles)) if angles.size else NAN
    rmse, compared = Estimate(NAN), [stair for stair in rising if math.isfinite(stair.model_angle_deg)]
    if trial.model_pressure_kpa is not None and len(compared) < len(rising):
        warnings.append(
            f"{len(rising) - len(compared)} of {len(rising)} stairs lie outside the model curve's pressures and are "
            f"not compared"
        )
    if compared:
        errors = np.array([stair.angle_deg.value - stair.model_angle_deg for stair in compared])
        sds = np.array([stair.angle_deg.sd for stair in compared])
        value = math.sqrt(float(np.mean(errors**2)))
        sd = (
            math.sqrt(float(np.sum((errors * sds) ** 2))) / (errors.size * value)
            if value > 0
            else float(sds.max())
        )
        rmse = Estimate(value, sd)
    nrmse = Estimate(rmse.value / range_deg, rmse.sd / range_deg) if range_deg > 0 else Estimate(NAN)
    return StaticNumbers(tuple(stairs), range_deg, rmse, nrmse, len(compared), tuple(warnings))
