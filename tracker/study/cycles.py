"""Cycles found from the pressure alone, for any waveform: where each begins, turns and ends; irregular cycles.

The angle is not used, so it cannot bias the segmentation. The cycles are measured in
`measured_cycles.py` and `dynamic.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from ..types import FloatArray

# Pressure is averaged over this time before turns are searched: short compared with any cycle a webcam can follow.
_BLOCK_S = 0.02
# Least prominence of a turn, as a fraction of the pressure's range.
_TURN_FRACTION = 0.4
# A range within this many standard deviations of noise is no movement.
_NOISE_RANGE = 8.0
# A smaller range is a pump at rest, no trial.
_SMALLEST_RANGE_KPA = 0.5
# A cycle whose length, peak or trough differs from the median by this fraction is irregular.
_IRREGULAR_FRACTION = 0.1
# A first or last cycle is complete when its ends differ in pressure by at most this fraction of the range.
_WHOLE_FRACTION = 0.05
# Drift of peaks or troughs over the trial that gets a warning, as a fraction of the range.
_DRIFT_FRACTION = 0.05


@dataclass(frozen=True)
class CycleTrain:
    """The complete cycles of a pressure record, from lowest pressure to lowest pressure.

    Attributes
    ----------
    start_s, turn_s, end_s : ndarray of float
        (C,) beginning, moment of the largest pressure (middle of a plateau), end.
    low_kpa, high_kpa : ndarray of float
        (C,) pressure where the cycle ends, and at its peak (approximate, to within the noise).
    irregular : tuple of str
        (C,) why a complete cycle is irregular; empty where it is regular.
    incomplete : tuple of str
        One sentence for each part of the record that is no complete cycle.
    warnings : tuple of str
        One sentence each.
    """

    start_s: FloatArray
    turn_s: FloatArray
    end_s: FloatArray
    low_kpa: FloatArray
    high_kpa: FloatArray
    irregular: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def period_s(self) -> float:
        """Median time from peak to peak, s; the length of a single cycle; NaN without any."""
        return _median(np.diff(self.turn_s) if self.turn_s.size > 1 else self.end_s - self.start_s)

    @property
    def amplitude_kpa(self) -> float:
        """Median peak-to-peak pressure, kPa."""
        return _median(self.high_kpa) - _median(self.low_kpa)

    @property
    def phase_s(self) -> float:
        """Begin of the first complete cycle, estimated from the begins of all, s."""
        return _median(self.start_s - self.period_s * np.arange(self.start_s.size))


_NONE = np.empty(0)


def find_cycles(time_s: FloatArray, pressure_kpa: FloatArray) -> CycleTrain:
    """Find the cycles of a pressure record.

    Parameters
    ----------
    time_s : ndarray of float
        (M,) rising times, s.
    pressure_kpa : ndarray of float
        (M,) kPa, at any rate and waveform; NaN where missing.

    Returns
    -------
    CycleTrain
        Where there is no cycle, its warnings say what was found instead (constant pressure, half a
        cycle). A cycle begins in the middle of the dwell at low pressure, however long that is.
    """
    time_s, pressure_kpa, noise_kpa = _averaged(time_s, pressure_kpa)
    if time_s.size < 8:
        return _no_cycles(f"the pressure record has {time_s.size} readings, too few to hold a cycle")
    low, high = np.quantile(pressure_kpa, (0.01, 0.99))
    span = float(high - low)
    if span < max(_NOISE_RANGE * noise_kpa, _SMALLEST_RANGE_KPA):
        return _no_cycles(
            f"constant pressure: it stays between {low:.2f} and {high:.2f} kPa, with noise of {noise_kpa:.2f} kPa"
        )
    peaks = find_peaks(pressure_kpa, prominence=_TURN_FRACTION * span)[0]
    troughs = find_peaks(-pressure_kpa, prominence=_TURN_FRACTION * span)[0]
    if not peaks.size:
        way = "falls and rises" if troughs.size else "goes one way only"
        return _no_cycles(f"no complete cycle: the pressure {way}, {low:.1f} to {high:.1f} kPa: half cycles")
    return _train(time_s, pressure_kpa, peaks, troughs, span)


def _averaged(time_s: FloatArray, pressure_kpa: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Block means without the missing readings, and their remaining noise, kPa."""
    known = np.isfinite(pressure_kpa) & np.isfinite(time_s)
    time_s, pressure_kpa = time_s[known], pressure_kpa[known]
    if time_s.size < 8:
        return time_s, pressure_kpa, 0.0
    count = max(1, round(_BLOCK_S / float(np.median(np.diff(time_s)))))
    whole = time_s.size // count * count
    times = time_s[:whole].reshape(-1, count).mean(axis=1)
    means = pressure_kpa[:whole].reshape(-1, count).mean(axis=1)
    if means.size < 3:  # all of the record within a few hundredths of a second
        return times, means, 0.0
    # Second differences: a ramp has none, noise has sqrt(6) of its own.
    noise = 1.4826 * float(np.median(np.abs(np.diff(means, n=2)))) / 6**0.5
    return times, means, noise


def _train(
    time_s: FloatArray, pressure_kpa: FloatArray, peaks: np.ndarray, troughs: np.ndarray, span: float
) -> CycleTrain:
    end = time_s.size - 1
    incomplete: list[str] = []
    flanks: list[tuple[int, int, int]] = []
    for first, last in pairwise([0, *troughs.tolist(), end]):
        inside = peaks[(peaks > first) & (peaks < last)]
        peak = int(inside[np.argmax(pressure_kpa[inside])]) if inside.size else None
        left, right = first, last
        if peak is not None and first == 0:
            left = int(np.argmin(pressure_kpa[: peak + 1]))
        if peak is not None and last == end:
            right = peak + int(np.argmin(pressure_kpa[peak:]))
        # At an end of the record the pressure must be about as low as at the cycle's other trough.
        uneven = float(pressure_kpa[left] - pressure_kpa[right])
        moved = float(np.ptp(pressure_kpa[first : last + 1]))
        if (
            peak is not None
            and (first > 0 or uneven <= _WHOLE_FRACTION * span)
            and (last < end or -uneven <= _WHOLE_FRACTION * span)
        ):
            flanks.append((left, peak, right))
        elif moved > _WHOLE_FRACTION * span:  # else it is a rest
            begins = first == 0 and (last < end or uneven > 0)
            which, edge = ("first", "begins") if begins else ("last", "ends")
            at = pressure_kpa[0 if begins else -1]
            incomplete.append(f"the {which} cycle is incomplete: the record {edge} at {at:.1f} kPa")
    if not flanks:
        return _no_cycles("no complete cycle: " + "; ".join(incomplete), tuple(incomplete))
    return _timed(time_s, pressure_kpa, flanks, incomplete)


def _timed(
    time_s: FloatArray, pressure_kpa: FloatArray, flanks: list[tuple[int, int, int]], incomplete: list[str]
) -> CycleTrain:
    """Begin, turn and end of each cycle, from its flanks extrapolated to the low and the high pressure."""
    count = len(flanks)
    leaves, turns, arrives = np.empty(count), np.empty(count), np.empty(count)
    for index, (left, peak, right) in enumerate(flanks):
        up_t, up_p = time_s[left : peak + 1], pressure_kpa[left : peak + 1]
        down_t, down_p = time_s[peak : right + 1][::-1], pressure_kpa[peak : right + 1][::-1]
        low_up, high_up = _flank_ends(up_t, up_p)
        low_down, high_down = _flank_ends(down_t, down_p)
        leaves[index], turns[index], arrives[index] = low_up, (high_up + high_down) / 2, low_down
    # The dwell between two cycles is split in half; at an end of the record the median dwell is assumed.
    follows = np.array([a[2] == b[0] for a, b in pairwise(flanks)], dtype=bool)
    dwells = (leaves[1:] - arrives[:-1])[follows]
    half = float(np.median(dwells)) / 2 if dwells.size else 0.0
    starts, ends = leaves - half, arrives + half
    middles = (leaves[1:] + arrives[:-1]) / 2
    starts[1:][follows], ends[:-1][follows] = middles[follows], middles[follows]
    starts, ends = np.maximum(starts, time_s[0]), np.minimum(ends, time_s[-1])
    lows = pressure_kpa[[right for _, _, right in flanks]]
    highs = pressure_kpa[[peak for _, peak, _ in flanks]]
    return CycleTrain(
        start_s=starts,
        turn_s=turns,
        end_s=ends,
        low_kpa=lows,
        high_kpa=highs,
        irregular=_irregular(ends - starts, lows, highs),
        incomplete=tuple(incomplete),
        warnings=_drift_warnings(lows, highs),
    )


def _flank_ends(time_s: FloatArray, pressure_kpa: FloatArray) -> tuple[float, float]:
    """Times at which a rising flank, extrapolated linearly, leaves its lowest and reaches its largest pressure.

    Extrapolated through 10 and 20 % and through 80 and 90 % of the rise. For a curved flank (of a sine) the two
    errors are equal and cancel in the middle of two flanks.
    """
    low, high = float(pressure_kpa[0]), float(pressure_kpa[-1])
    rise = (pressure_kpa - low) / (high - low)
    at = [_crossing(time_s, rise, level) for level in (0.1, 0.2, 0.8, 0.9)]
    return 2 * at[0] - at[1], 2 * at[3] - at[2]


def _crossing(time_s: FloatArray, rise: FloatArray, level: float) -> float:
    """Time at which a noisy rise crosses a level: the middle between its first and last crossing."""
    above = rise >= level
    passes = np.flatnonzero(above[1:] & ~above[:-1])
    if not passes.size:
        return float(time_s[0])
    ends = passes[[0, -1]]
    fraction = (level - rise[ends]) / (rise[ends + 1] - rise[ends])
    return float(np.mean(time_s[ends] + fraction * (time_s[ends + 1] - time_s[ends])))


def _irregular(lengths_s: FloatArray, lows: FloatArray, highs: FloatArray) -> tuple[str, ...]:
    span = _median(highs) - _median(lows)
    length = _median(lengths_s)
    reasons = [""] * lengths_s.size
    for index in range(lengths_s.size):
        if abs(lengths_s[index] - length) > _IRREGULAR_FRACTION * length:
            reasons[index] = f"lasts {lengths_s[index]:.2f} s, the others {length:.2f} s"
        elif abs(highs[index] - _median(highs)) > _IRREGULAR_FRACTION * span:
            reasons[index] = f"reaches {highs[index]:.1f} kPa, the others {_median(highs):.1f} kPa"
        elif abs(lows[index] - _median(lows)) > _IRREGULAR_FRACTION * span:
            reasons[index] = f"comes back to {lows[index]:.1f} kPa, the others to {_median(lows):.1f} kPa"
    return tuple(reasons)


def _drift_warnings(lows: FloatArray, highs: FloatArray) -> tuple[str, ...]:
    if lows.size < 3:
        return ()
    span = _median(highs) - _median(lows)
    cycle = np.arange(lows.size)
    moved = {
        name: float(np.polyfit(cycle, values, 1)[0]) * (lows.size - 1)
        for name, values in (("lowest", lows), ("largest", highs))
    }
    return tuple(
        f"pressure drift: the {name} pressure of a cycle moves by {kpa:+.1f} kPa over {lows.size} cycles"
        for name, kpa in moved.items()
        if abs(kpa) > _DRIFT_FRACTION * span
    )


def _no_cycles(warning: str, incomplete: tuple[str, ...] = ()) -> CycleTrain:
    return CycleTrain(_NONE, _NONE, _NONE, _NONE, _NONE, incomplete=incomplete, warnings=(warning,))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")
