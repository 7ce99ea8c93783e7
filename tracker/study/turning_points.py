"""The pressure at the turns of a wave, without the bias of the largest noisy reading.

The largest of many noisy readings lies above the truth, so it is read from a curve fitted to all readings around all
turns. The angle at the turns is computed in `branches.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import FloatArray

# Window of the log around a turn: fraction of the period, and its upper limit.
_WINDOW_FRACTION, _WINDOW_S = 0.06, 0.25
# In a coarse log, at least so many readings either way, but never more than a quarter of the period.
_COARSE_STEPS = 5
# Half widths of a rounded corner that are tried, as fractions of the window; 0 is sharp.
_ROUNDINGS = (0.0, 0.04, 0.06, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 1.0)
# Number of bins in which readings are averaged before the fits; the curve is sampled twice as finely.
_BINS = 160
_FEWEST_READINGS = 8


@dataclass(frozen=True)
class TurningPressure:
    """Pressure around the turns of one kind (all peaks, or all troughs) of a trial's cycles.

    Attributes
    ----------
    turn_s, kpa : ndarray of float
        (C,) time of each turn, and the pressure there.
    common_sd_kpa : float
        Standard uncertainty common to all of `kpa`, from the curve fitted to all turns.
    curve_s, curve_kpa : ndarray of float
        (G,) the curve: time after the turn, pressure minus that of the turn.
    blind_s : float
        Time around a turn in which the log is too coarse to give the pressure; 0 with a curve.
    unseen_kpa : float
        Pressure that a corner may have between two readings of a coarse log; else 0.
    """

    turn_s: FloatArray
    kpa: FloatArray
    common_sd_kpa: float
    curve_s: FloatArray
    curve_kpa: FloatArray
    blind_s: float = 0.0
    unseen_kpa: float = 0.0

    def off_kpa(self, late_s: FloatArray) -> FloatArray:
        """Pressure minus that of the turn, `late_s` after a turn; NaN beyond the ends of the curve.

        Parameters
        ----------
        late_s : ndarray of float
            Times after a turn, s; any shape.

        Returns
        -------
        ndarray of float
            kPa, of the same shape.
        """
        return np.interp(late_s, self.curve_s, self.curve_kpa, left=np.nan, right=np.nan)


def turning_pressure(
    time_s: FloatArray, pressure_kpa: FloatArray, turns_s: FloatArray, period_s: float
) -> TurningPressure:
    """Pressure at the turns of a log.

    All turns are aligned and superimposed. Curves of two flanks (lines, parabolas or cubics) that meet in a
    corner, sharp or rounded, are fitted to them. The result is the mean of these curves, weighted by Akaike
    weights; their disagreement is part of the uncertainty. A single turn differs from the curve by its mean
    distance.

    Parameters
    ----------
    time_s, pressure_kpa : ndarray of float
        (M,) the log as recorded, NaN where missing.
    turns_s : ndarray of float
        (C,) approximate times of the turns.
    period_s : float
        Period of the cycles.

    Returns
    -------
    TurningPressure
        Time and pressure of each turn, and the common curve.
    """
    known = np.isfinite(pressure_kpa)
    time_s, pressure_kpa = time_s[known], pressure_kpa[known]
    step_s = float(np.median(np.diff(time_s))) if time_s.size > 1 else 0.0
    reach = min(_WINDOW_FRACTION * period_s, _WINDOW_S)
    coarse = _COARSE_STEPS * step_s > reach
    reach = min(max(reach, _COARSE_STEPS * step_s), period_s / 4)
    turns_s = np.array([_aligned(time_s, pressure_kpa, float(turn), reach) for turn in turns_s])
    windows = [slice(*np.searchsorted(time_s, (turn - reach, turn + reach)).tolist()) for turn in turns_s]
    counts = np.array([window.stop - window.start for window in windows])
    usable = counts >= _FEWEST_READINGS
    kpa = np.interp(turns_s, time_s, pressure_kpa) if time_s.size else np.full(turns_s.size, np.nan)
    if not usable.any():
        if time_s.size < 2:
            return TurningPressure(turns_s, kpa, float("nan"), np.zeros(1), np.zeros(1))
        # The extreme may lie anywhere between two readings.
        step_kpa = _step_kpa(pressure_kpa)
        return TurningPressure(turns_s, kpa, step_kpa / 2, np.zeros(1), np.zeros(1), step_s, step_kpa / 2)
    off = [(time_s[window] - turn) / reach for window, turn in zip(windows, turns_s, strict=True)]
    means = np.array(
        [pressure_kpa[window].mean() if window.stop > window.start else np.nan for window in windows]
    )
    level = [pressure_kpa[window] - mean for window, mean in zip(windows, means, strict=True)]
    chosen = np.flatnonzero(usable)
    cells = _averaged(np.concatenate([off[c] for c in chosen]), np.concatenate([level[c] for c in chosen]))
    grid = np.linspace(-1, 1, 2 * _BINS + 1)
    curve, at_turn, sd = _mean_curve(*cells, grid)
    # A corner that is rounded between two readings may lie up to a quarter of their step lower.
    unseen = _step_kpa(pressure_kpa) / 8 if coarse else 0.0
    # Mean of the curve at the readings of a turn; not 0 where they are spaced unevenly.
    expected = [float(np.interp(off[c], grid, curve).mean()) for c in chosen]
    kpa[chosen] = means[chosen] - expected + at_turn
    return TurningPressure(turns_s, kpa, sd, grid * reach, curve - at_turn, unseen_kpa=unseen)


def _step_kpa(pressure_kpa: FloatArray) -> float:
    """Median change of the pressure from one reading to the next."""
    return float(np.median(np.abs(np.diff(pressure_kpa))))


def _aligned(time_s: FloatArray, pressure_kpa: FloatArray, turn_s: float, reach_s: float) -> float:
    """The turn's refined time: where the lines through the flanks on its two sides meet."""
    first, middle, last = np.searchsorted(time_s, (turn_s - reach_s, turn_s, turn_s + reach_s))
    if middle - first < 4 or last - middle < 4:
        return turn_s
    slope_l, at_l = _line(time_s[first:middle] - turn_s, pressure_kpa[first:middle])
    slope_r, at_r = _line(time_s[middle:last] - turn_s, pressure_kpa[middle:last])
    steep = sorted((abs(slope_l), abs(slope_r)))
    if slope_l * slope_r >= 0 or steep[0] < 0.3 * steep[1]:
        return turn_s  # a plateau or a rest on one side: no corner
    move = (at_r - at_l) / (slope_l - slope_r)
    return turn_s + min(max(move, -reach_s / 4), reach_s / 4)


def _line(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope and intercept."""
    centred = x - x.mean()
    slope = float(centred @ y / (centred @ centred))
    return slope, float(y.mean() - slope * x.mean())


def _averaged(off: FloatArray, level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Bin means of both, and the number of readings in each bin; no bin lies on both sides of 0."""
    bin_of = np.clip(((off + 1) / 2 * _BINS).astype(int), 0, _BINS - 1)
    counts = np.bincount(bin_of, minlength=_BINS).astype(float)
    filled = counts > 0
    sums = (np.bincount(bin_of, weights=values, minlength=_BINS)[filled] for values in (off, level))
    off_mean, level_mean = (total / counts[filled] for total in sums)
    return off_mean, level_mean, counts[filled]


def _mean_curve(
    off: FloatArray, level: FloatArray, counts: FloatArray, grid: FloatArray
) -> tuple[FloatArray, float, float]:
    """The weighted mean of all curves on a grid, its value at 0, and that value's standard uncertainty."""
    weight = np.sqrt(counts)
    criteria, tops, variances, curves = [], [], [], []
    for order in (1, 2, 3):
        # (R, cells, P): one design for each rounding
        designs = _designs(off, order) * weight[:, None]
        inverses = np.linalg.pinv(np.swapaxes(designs, 1, 2) @ designs, hermitian=True)
        coefficients = inverses @ (np.swapaxes(designs, 1, 2) @ (level * weight))[..., None]
        squares = np.sum((level * weight - (designs @ coefficients)[..., 0]) ** 2, axis=1)
        squares = np.maximum(squares, 1e-18)
        cells, parameters = designs.shape[1:]
        at_zero = _designs(np.zeros(1), order)  # (R, 1, P)
        criteria.append(cells * np.log(squares / cells) + 2 * parameters)
        tops.append((at_zero @ coefficients)[:, 0, 0])
        spread = (at_zero @ inverses @ np.swapaxes(at_zero, 1, 2))[:, 0, 0]
        variances.append(squares / max(cells - parameters, 1) * spread)
        curves.append((_designs(grid, order) @ coefficients)[..., 0])
    criterion, value, own = np.concatenate(criteria), np.concatenate(tops), np.concatenate(variances)
    akaike = np.exp(-(criterion - criterion.min()) / 2)
    akaike /= akaike.sum()
    at_turn = float(akaike @ value)
    variance = float(akaike @ (own + (value - at_turn) ** 2))
    return akaike @ np.concatenate(curves), at_turn, float(np.sqrt(variance))


def _designs(off: FloatArray, order: int) -> FloatArray:
    """(R, N, P) columns of two flanks that meet in a corner, for each rounding."""
    away, rounding = np.abs(off), np.array(_ROUNDINGS)[:, None]
    smooth = (off**2 + rounding**2) / (2 * np.maximum(rounding, 1e-12))
    columns = [np.ones_like(off), off, off**2, off * away, off**3, away**3][: 2 * order]
    designs = np.empty((len(_ROUNDINGS), off.size, 1 + len(columns)))
    designs[..., 0] = np.where(away < rounding, smooth, away)
    designs[..., 1:] = np.stack(columns, axis=1)
    return designs
