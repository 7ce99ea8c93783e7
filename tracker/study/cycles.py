"""Cycles found from the pressure alone, whatever its wave: where each begins, turns and ends, and what is off.

The angle plays no part, so that no cycle is where it is because of the angle. What is measured in a cycle is
`measured_cycles.py` and `dynamic.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.signal import find_peaks

from ..types import FloatArray

# Pressure is averaged over this long before turns are sought: short beside any cycle that a webcam can follow.
_BLOCK_S = 0.02
# A turn counts when the pressure comes back by this share of its whole range.
_TURN_SHARE = 0.4
# A range within this many standard deviations of noise is no movement.
_NOISE_RANGE = 8.0
# Less than this is no trial but a pump at rest.
_SMALLEST_RANGE_KPA = 0.5
# A cycle whose length, top or foot is off the others' median by this share does not belong with them.
_IRREGULAR_SHARE = 0.1
# A first or last cycle is whole when it begins and ends this near the usual lowest pressure.
_WHOLE_SHARE = 0.05
# Movement of tops or feet over the whole trial that is worth a warning, as a share of the range.
_DRIFT_SHARE = 0.05


@dataclass(frozen=True)
class CycleTrain:
    """The complete cycles of a pressure record, from lowest pressure to lowest pressure.

    Attributes
    ----------
    start_s, turn_s, end_s : ndarray of float
        (C,) beginning, moment of the largest pressure (middle of a plateau), end.
    low_kpa, high_kpa : ndarray of float
        (C,) pressure where the cycle ends, and at its top (rough: good to the noise).
    irregular : tuple of str
        (C,) why a complete cycle does not belong with the others; empty where it does.
    incomplete : tuple of str
        One sentence for each part of the record that is no whole cycle.
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
        """Usual time from top to top, s, of a single cycle its length; NaN without one."""
        return _median(np.diff(self.turn_s) if self.turn_s.size > 1 else self.end_s - self.start_s)

    @property
    def amplitude_kpa(self) -> float:
        """Usual way from the lowest to the largest pressure, peak to peak, kPa."""
        return _median(self.high_kpa) - _median(self.low_kpa)

    @property
    def phase_s(self) -> float:
        """When the first complete cycle begins, from the beginnings of all, s."""
        return _median(self.start_s - self.period_s * np.arange(self.start_s.size))


_NONE = np.empty(0)


def find_cycles(time_s: FloatArray, pressure_kpa: FloatArray) -> CycleTrain:
    """Find the cycles of a pressure record.

    Parameters
    ----------
    time_s : ndarray of float
        (M,) rising.
    pressure_kpa : ndarray of float
        (M,) any rate and wave; NaN where missing.

    Returns
    -------
    CycleTrain
        Without a single cycle its warnings say what was found instead (pressure that does not move, half a
        cycle, no way back). A cycle begins in the middle of the dwell at low pressure, however long that is.
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
    tops = find_peaks(pressure_kpa, prominence=_TURN_SHARE * span)[0]
    feet = find_peaks(-pressure_kpa, prominence=_TURN_SHARE * span)[0]
    if not tops.size:
        way = "falls and rises" if feet.size else "goes one way only"
        return _no_cycles(f"no complete cycle: the pressure {way}, {low:.1f} to {high:.1f} kPa: half cycles")
    return _train(time_s, pressure_kpa, tops, feet, span)


def _averaged(time_s: FloatArray, pressure_kpa: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Block means without the missing readings, and the noise that is left in them, kPa."""
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
    time_s: FloatArray, pressure_kpa: FloatArray, tops: np.ndarray, feet: np.ndarray, span: float
) -> CycleTrain:
    end = time_s.size - 1
    incomplete: list[str] = []
    flanks: list[tuple[int, int, int]] = []
    for first, last in pairwise([0, *feet.tolist(), end]):
        inside = tops[(tops > first) & (tops < last)]
        top = int(inside[np.argmax(pressure_kpa[inside])]) if inside.size else None
        left, right = first, last
        if top is not None and first == 0:
            left = int(np.argmin(pressure_kpa[: top + 1]))
        if top is not None and last == end:
            right = top + int(np.argmin(pressure_kpa[top:]))
        # Inside the record a foot is a foot; at its ends the pressure must be about as low as at the other foot.
        uneven = float(pressure_kpa[left] - pressure_kpa[right])
        moved = float(np.ptp(pressure_kpa[first : last + 1]))
        if (
            top is not None
            and (first > 0 or uneven <= _WHOLE_SHARE * span)
            and (last < end or -uneven <= _WHOLE_SHARE * span)
        ):
            flanks.append((left, top, right))
        elif moved > _WHOLE_SHARE * span:  # else it is a rest
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
    """Where each cycle begins, turns and ends, from where its flanks would meet the low and the high pressure."""
    count = len(flanks)
    leaves, turns, arrives = np.empty(count), np.empty(count), np.empty(count)
    for place, (left, top, right) in enumerate(flanks):
        up_t, up_p = time_s[left : top + 1], pressure_kpa[left : top + 1]
        down_t, down_p = time_s[top : right + 1][::-1], pressure_kpa[top : right + 1][::-1]
        low_up, high_up = _reaches(up_t, up_p)
        low_down, high_down = _reaches(down_t, down_p)
        leaves[place], turns[place], arrives[place] = low_up, (high_up + high_down) / 2, low_down
    # Where one cycle follows another, the dwell between them is shared; at an end of the record it is taken as usual.
    follows = np.array([a[2] == b[0] for a, b in pairwise(flanks)], dtype=bool)
    dwells = (leaves[1:] - arrives[:-1])[follows]
    half = float(np.median(dwells)) / 2 if dwells.size else 0.0
    starts, ends = leaves - half, arrives + half
    middles = (leaves[1:] + arrives[:-1]) / 2
    starts[1:][follows], ends[:-1][follows] = middles[follows], middles[follows]
    starts, ends = np.maximum(starts, time_s[0]), np.minimum(ends, time_s[-1])
    lows = pressure_kpa[[right for _, _, right in flanks]]
    highs = pressure_kpa[[top for _, top, _ in flanks]]
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


def _reaches(time_s: FloatArray, pressure_kpa: FloatArray) -> tuple[float, float]:
    """When a rising flank would leave its lowest and reach its largest pressure, carried on in a straight line.

    Carried on from 20 % to 10 % and from 80 % to 90 % of the way. A curved flank (a sine's) leaves too early and
    arrives too late by the same, which the middle of two flanks does not see.
    """
    low, high = float(pressure_kpa[0]), float(pressure_kpa[-1])
    way = (pressure_kpa - low) / (high - low)
    at = [_crossing(time_s, way, level) for level in (0.1, 0.2, 0.8, 0.9)]
    return 2 * at[0] - at[1], 2 * at[3] - at[2]


def _crossing(time_s: FloatArray, way: FloatArray, level: float) -> float:
    """When a noisy rise passes a level: the middle between its first and its last passage."""
    above = way >= level
    passes = np.flatnonzero(above[1:] & ~above[:-1])
    if not passes.size:
        return float(time_s[0])
    ends = passes[[0, -1]]
    share = (level - way[ends]) / (way[ends + 1] - way[ends])
    return float(np.mean(time_s[ends] + share * (time_s[ends + 1] - time_s[ends])))


def _irregular(lengths_s: FloatArray, lows: FloatArray, highs: FloatArray) -> tuple[str, ...]:
    span = _median(highs) - _median(lows)
    length = _median(lengths_s)
    reasons = [""] * lengths_s.size
    for place in range(lengths_s.size):
        if abs(lengths_s[place] - length) > _IRREGULAR_SHARE * length:
            reasons[place] = f"lasts {lengths_s[place]:.2f} s, the others {length:.2f} s"
        elif abs(highs[place] - _median(highs)) > _IRREGULAR_SHARE * span:
            reasons[place] = f"reaches {highs[place]:.1f} kPa, the others {_median(highs):.1f} kPa"
        elif abs(lows[place] - _median(lows)) > _IRREGULAR_SHARE * span:
            reasons[place] = f"comes back to {lows[place]:.1f} kPa, the others to {_median(lows):.1f} kPa"
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
        if abs(kpa) > _DRIFT_SHARE * span
    )


def _no_cycles(warning: str, incomplete: tuple[str, ...] = ()) -> CycleTrain:
    return CycleTrain(_NONE, _NONE, _NONE, _NONE, _NONE, incomplete=incomplete, warnings=(warning,))


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if values.size else float("nan")
