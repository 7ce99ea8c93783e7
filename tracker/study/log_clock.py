"""A log's clock put in order: faults are detected and reported, and no time is invented.

The column of times is chosen in `log_columns.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..types import FloatArray

# A step of so many median steps is a gap: jitter alone does not explain it.
GAP_STEPS = 1.8
# More repeated times than this fraction of the rows come from a clock that is coarser than the samples.
_COARSE_FRACTION = 0.02
# Steps within these bounds, in median steps, are regular sampling.
_REGULAR = (0.4, 1.6)


@dataclass(frozen=True)
class OrderedClock:
    """Rows of a log in the order of time.

    Attributes
    ----------
    rows : ndarray of int
        (M,) indices of the rows to take, in this order, so that times rise.
    time_s : ndarray of float
        (M,) rising times of those rows, s.
    tick_s : float
        Resolution of the times where it is coarser than a sample, s; else 0.
    warnings : tuple of str
        Warnings, a line each.
    """

    rows: NDArray[np.intp]
    time_s: FloatArray
    tick_s: float
    warnings: tuple[str, ...]


def order_clock(time_s: FloatArray, value: FloatArray) -> OrderedClock:
    """Rising times, from times as written in the log.

    A reversed log is turned round; single swapped rows are sorted; of rows with the same time the first is
    kept. Where the clock was set back or forward, or the log was restarted, the times on the two sides do
    not belong together: the longest segment is kept. Gaps stay gaps.

    Parameters
    ----------
    time_s : ndarray of float
        (N,) s, NaN where unreadable.
    value : ndarray of float
        (N,) what was measured; it distinguishes a clock that jumped from samples that are missing.

    Returns
    -------
    OrderedClock
        The rows to take and their times.
    """
    warnings: list[str] = []
    rows = np.flatnonzero(np.isfinite(time_s))
    if len(rows) < len(time_s):
        warnings.append(f"{len(time_s) - len(rows)} rows have no time and were left out")
    times = time_s[rows]
    steps = np.diff(times)
    if len(steps) and np.all(steps <= 0) and np.any(steps < 0):
        warnings.append("the log runs backward in time; its rows were put in the order of time")
        rows, times = rows[::-1], times[::-1]
    rows = _in_order(rows, times, warnings)
    rows, tick_s = _without_repeats(rows, time_s, value, warnings)
    rows = _without_jump(rows, time_s, value, warnings)
    _warn_of_gaps(time_s[rows], warnings)
    return OrderedClock(rows, time_s[rows], tick_s, tuple(warnings))


def usual_step_s(time_s: FloatArray) -> float:
    """Median time from sample to sample, s; NaN with fewer than two.

    Parameters
    ----------
    time_s : ndarray of float
        (N,) times, s.

    Returns
    -------
    float
        Seconds.
    """
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else float("nan")


def _in_order(rows: NDArray[np.intp], times: FloatArray, warnings: list[str]) -> NDArray[np.intp]:
    steps = np.diff(times)
    back = np.flatnonzero(steps < 0)
    if not len(back):
        return rows
    usual = float(np.median(steps[steps > 0]))
    order = np.argsort(times, kind="stable")
    between = np.diff(times[order]) / usual
    # Swapped rows, once sorted, are sampled as regularly as the others; two overlapping clocks are not.
    moved = order != np.arange(len(order))
    touched = moved[1:] | moved[:-1]
    if (
        np.mean(moved) < 0.2
        and np.all(between[touched] > _REGULAR[0])
        and np.all(between[touched] < _REGULAR[1])
    ):
        warnings.append(f"{int(moved.sum())} rows stand out of the order of time and were sorted")
        return rows[order]
    return rows[_longest(back, times, "goes back", warnings)]


def _longest(breaks: NDArray[np.intp], times: FloatArray, verb: str, warnings: list[str]) -> slice:
    """The longest segment between breaks (each after its index); adds a warning about the others."""
    edges = np.concatenate([[0], breaks + 1, [len(times)]])
    longest = int(np.argmax(np.diff(edges)))
    kept = slice(int(edges[longest]), int(edges[longest + 1]))
    first = int(breaks[0])
    jump = times[first + 1] - times[first]
    more = f" ({len(breaks)} such jumps)" if len(breaks) > 1 else ""
    warnings.append(
        f"clock jump: the log's time {verb} by {abs(jump):.3f} s after {times[first]:.3f} s{more}; only the longest "
        f"segment, {times[kept.start]:.3f} to {times[kept.stop - 1]:.3f} s, is used"
    )
    return kept


def _without_repeats(
    rows: NDArray[np.intp], time_s: FloatArray, value: FloatArray, warnings: list[str]
) -> tuple[NDArray[np.intp], float]:
    times = time_s[rows]
    first = np.concatenate([[True], np.diff(times) > 0])
    n_repeated = int((~first).sum())
    if not n_repeated:
        return rows, 0.0
    again = np.flatnonzero(~first)
    a, b = value[rows[again]], value[rows[again - 1]]
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    tick_s = usual_step_s(times[first])
    if n_repeated > _COARSE_FRACTION * len(times) and not same.all():
        warnings.append(
            f"the log's clock ticks every {tick_s:.4g} s, coarser than its samples; the first sample of each "
            f"tick is kept, {n_repeated} of {len(times)} left out"
        )
        return rows[first], tick_s
    word = "repeat the row before" if same.all() else "have the time of the row before"
    warnings.append(f"{n_repeated} samples {word} and were left out")
    return rows[first], 0.0


def _without_jump(
    rows: NDArray[np.intp], time_s: FloatArray, value: FloatArray, warnings: list[str]
) -> NDArray[np.intp]:
    """Rows without a forward clock jump: a gap across which a changing value continues as if nothing were missing."""
    times, values = time_s[rows], value[rows]
    usual = usual_step_s(times)
    breaks = [at for at in _gaps(times, usual) if _goes_on(times, values, at, usual)]
    if not breaks:
        return rows
    return rows[_longest(np.array(breaks), times, "leaps ahead", warnings)]


def _gaps(times: FloatArray, usual: float) -> NDArray[np.intp]:
    """Index before each gap."""
    return np.flatnonzero(np.diff(times) > GAP_STEPS * usual)


def _goes_on(times: FloatArray, values: FloatArray, at: int, usual: float) -> bool:
    """Whether lines fitted to the samples on both sides are continuous if the gap is removed, and not otherwise."""
    n = max(8, round(min(0.1 / usual, len(times))))
    before, after = slice(max(0, at + 1 - n), at + 1), slice(at + 1, at + 1 + n)
    a, b = values[before], values[after]
    if len(a) < 8 or len(b) < 8 or np.isnan(a).any() or np.isnan(b).any():
        return False
    gap = times[at + 1] - times[at]
    try:
        slope_a, end_a = np.polyfit(times[before] - times[at], a, 1)
        slope_b, start_b = np.polyfit(times[after] - times[at + 1], b, 1)
    except np.linalg.LinAlgError:  # numbers too large to be squared
        return False
    noise = float(np.std(np.diff(values[max(0, at - 200) : at + 200])) / np.sqrt(2))
    level_sd = 3 * noise / np.sqrt(min(len(a), len(b)))
    missing = slope_a * gap
    if abs(missing) < 8 * level_sd + abs(slope_a * usual) * 4:
        return False  # too flat to decide
    meets = abs(start_b - end_a - slope_a * usual) < 4 * level_sd + abs(slope_a * usual)
    alike = abs(slope_b - slope_a) < 0.5 * abs(slope_a)
    return bool(meets and alike)


def _warn_of_gaps(times: FloatArray, warnings: list[str]) -> None:
    usual = usual_step_s(times)
    gaps = _gaps(times, usual)
    if len(gaps):
        lengths = np.diff(times)[gaps]
        longest = int(np.argmax(lengths))
        more = f" ({len(gaps)} gaps, {lengths.sum():.3f} s in all)" if len(gaps) > 1 else ""
        warnings.append(
            f"gap: no sample for {lengths[longest]:.3f} s after {times[gaps[longest]]:.3f} s, where one usually "
            f"comes every {usual:.4g} s{more}"
        )
