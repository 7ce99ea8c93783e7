"""When something begins in a signal: a lamp or a trigger that goes on, a pressure or an angle that leaves its rest.

Two signals are brought together by their onsets in `synchronisation.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import StudyError
from ..types import FloatArray

# Two levels must be so many standard deviations of the noise apart to be told from it.
_CLEAR = 8.0
# A slow rise is followed up to these shares of the whole change; the two fits differ by what its curve makes unsure.
_SHARES = (0.08, 0.16)
_MIN_REST = 5


@dataclass(frozen=True)
class Onset:
    """When something begins, s on the signal's own clock, and the standard uncertainty of that, s."""

    time_s: float
    sd_s: float


def rising_edges(time_s: FloatArray, value: FloatArray, where: str) -> list[Onset]:
    """Every time at which a signal of two levels goes from the lower to the higher one.

    An edge lies anywhere between the last sample below the middle of the levels and the first one above: its
    uncertainty is that of a rectangular distribution.

    Parameters
    ----------
    time_s, value : (M,) rising times, s; NaN values are left out
    where : opens the message

    Raises
    ------
    StudyError
        The signal has no two levels, or is on from the beginning and never goes on again.
    """
    time_s, value = _known(time_s, value, where)
    low, high = float(value.min()), float(value.max())
    middle = (low + high) / 2
    # The noise of each level about itself, so that a lamp that is on most of the time is no noise.
    on = value > middle
    noise = max(float(np.std(value[on])), float(np.std(value[~on]))) if on.any() and not on.all() else 0.0
    if high - low <= _CLEAR * noise / 2 or high == low:
        raise StudyError(f"{where}: expected a step between two levels, found none ({low:g} to {high:g})")
    after = np.flatnonzero(on[1:] & ~on[:-1]) + 1
    if not len(after):
        raise StudyError(f"{where}: expected a step upward, found a signal that is on from the beginning")
    gaps = time_s[after] - time_s[after - 1]
    middles = (time_s[after] + time_s[after - 1]) / 2
    return [Onset(float(t), float(gap / 12**0.5)) for t, gap in zip(middles, gaps, strict=True)]


def leaving_rest(time_s: FloatArray, value: FloatArray, where: str) -> Onset:
    """When a signal that rests at first begins to rise or fall, by a rest and a slope fitted on both sides.

    The fit is made over two lengths of the slope; the difference between them, which a curved beginning makes, is
    part of the uncertainty beside the fit's own.

    Parameters
    ----------
    time_s, value : (M,) rising times, s; NaN values are left out
    where : opens the message

    Raises
    ------
    StudyError
        The signal does not rest at first, or does not leave its rest.
    """
    time_s, value = _known(time_s, value, where)
    rest = np.median(value[:_MIN_REST])
    whole = float(np.max(np.abs(value - rest)))
    noise = 1.4826 * float(np.median(np.abs(np.diff(value[: max(_MIN_REST, len(value) // 50)])))) / 2**0.5
    if whole <= _CLEAR * noise or whole == 0:
        raise StudyError(f"{where}: expected an onset, found a signal that stays at {rest:.4g}")
    fits = [_hinge(time_s, value - rest, max(share * whole, _CLEAR * noise), where) for share in _SHARES]
    times = [fit.time_s for fit in fits]
    spread = abs(times[1] - times[0])
    return Onset(times[0], float(np.hypot(fits[0].sd_s, spread)))


def _hinge(time_s: FloatArray, value: FloatArray, level: float, where: str) -> Onset:
    """Least squares of 0 before, a line after: over a rest and a slope of the same number of samples."""
    beyond = np.abs(value) > level
    # From where the signal stays beyond the level, so that one wild sample is no onset.
    stays = beyond[:-2] & beyond[1:-1] & beyond[2:]
    end = int(np.argmax(stays)) if stays.any() else 0
    near = np.flatnonzero(np.abs(value[:end]) < level / 4)
    if end < _MIN_REST or len(near) < _MIN_REST:
        raise StudyError(f"{where}: expected a rest before the onset, found a signal that changes at once")
    begin = max(0, 2 * int(near[-1]) - end)  # as much rest as slope, that a drift long before does not count
    begin = max(0, min(begin, int(near[-1]) - _MIN_REST))
    t, v = time_s[begin : end + 1], value[begin : end + 1]
    candidates = np.linspace(t[1], t[-2], 400)
    best = min(candidates, key=lambda at: _misfit(t, v, at)[0])
    step = candidates[1] - candidates[0]
    fine = np.linspace(best - step, best + step, 41)
    best = float(min(fine, key=lambda at: _misfit(t, v, at)[0]))
    squares, slope = _misfit(t, v, best)
    noise = np.sqrt(squares / max(1, len(t) - 3))
    # Of a line through rest noise: the onset is known as its height is, over the slope (to first order).
    after = t[t > best] - best
    before = int(np.sum(t <= best))
    gradient = np.column_stack(
        [np.ones(len(t)), np.where(t > best, t - best, 0), np.where(t > best, -slope, 0)]
    )
    covariance = np.linalg.pinv(gradient.T @ gradient) * noise**2
    if not len(after) or not before or slope == 0:
        raise StudyError(f"{where}: expected an onset, found none that a line could be fitted to")
    return Onset(best, float(np.sqrt(covariance[2, 2])))


def _misfit(t: FloatArray, v: FloatArray, at: float) -> tuple[float, float]:
    """Sum of squares and slope of the best rest and line that meet at a time."""
    design = np.column_stack([np.ones(len(t)), np.maximum(t - at, 0)])
    coefficients, *_ = np.linalg.lstsq(design, v, rcond=None)
    return float(np.sum((v - design @ coefficients) ** 2)), float(coefficients[1])


def _known(time_s: FloatArray, value: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    known = np.isfinite(value)
    if known.sum() < 2 * _MIN_REST:
        raise StudyError(f"{where}: expected a signal with an event in it, got {int(known.sum())} samples")
    return time_s[known], value[known]
