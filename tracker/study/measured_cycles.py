"""Every complete cycle of a dynamic trial: its loop, its numbers, their sensitivity to the clocks' shift, and
whether it can be used.

Cycles come from `cycles.py`, turns from `turning_points.py` and `branches.py`, the geometry of a loop from
`hysteresis.py`; the trial's values and their intervals are computed in `dynamic.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import FloatArray
from .branches import TurningAngle, frame_noise_deg, turning_angle
from .cycles import CycleTrain
from .hysteresis import loop_area_deg_kpa, mid_pressure_width_deg
from .trial import TrialData
from .turning_points import TurningPressure, turning_pressure

# A gap that a straight line may bridge: 5 % of the cycle costs the area under 0.1 % (the loops are that smooth).
_GAP_FRACTION, _GAP_FRAMES = 0.05, 3.5
_MISSING_FRACTION = 0.25
_FEWEST_FRAMES = 12
# Part of the rest after the last cycle that belongs to its trough, as a fraction of the period.
_REST_FRACTION = 0.1


@dataclass(frozen=True)
class Coverage:
    """Frames in a cycle, those without an angle or a pressure, the longest gap and its start.

    Attributes
    ----------
    frames : int
        Number of frames in the cycle.
    missing : int
        Frames without an angle or a pressure.
    longest_gap_s : float
        Longest time without a usable frame, s.
    gap_at_s : float
        Begin of that gap, s.
    """

    frames: int
    missing: int
    longest_gap_s: float
    gap_at_s: float


@dataclass(frozen=True)
class MeasuredCycles:
    """The C complete cycles of a trial.

    Attributes
    ----------
    train : CycleTrain
        Times of the cycles.
    coverage : tuple of Coverage
        (C,) frames in each cycle.
    refusals : tuple of str
        (C,) why each cycle cannot be used; empty where it can.
    peaks, troughs : TurningPressure
        Pressure at each cycle's peak, and at its end.
    largest, residual : TurningAngle
        Angle at the peaks and at the troughs.
    loops : tuple of ndarray of float
        (C,) arrays (N, 2) kPa and deg, ends interpolated, gaps bridged.
    frame_noise_deg : float
        Noise (sd) of one frame's angle.
    areas_deg_kpa, widths_deg : ndarray of float
        (C,) cumulative hysteresis, and width at mid pressure.
    area_by_shift, width_by_shift : ndarray of float
        (C,) their derivatives with respect to a shift of the pressure to later times, per s.
    """

    train: CycleTrain
    coverage: tuple[Coverage, ...]
    refusals: tuple[str, ...]
    peaks: TurningPressure
    troughs: TurningPressure
    largest: TurningAngle
    residual: TurningAngle
    loops: tuple[FloatArray, ...]
    frame_noise_deg: float
    areas_deg_kpa: FloatArray
    widths_deg: FloatArray
    area_by_shift: FloatArray
    width_by_shift: FloatArray


def measure_cycles(trial: TrialData, train: CycleTrain) -> MeasuredCycles:
    """Measure all complete cycles of a trial that has frames with both an angle and a pressure.

    Parameters
    ----------
    trial : TrialData
        The trial.
    train : CycleTrain
        Its complete cycles, at least one.

    Returns
    -------
    MeasuredCycles
        Loops, turns and numbers of all cycles.
    """
    frames = (trial.time_s, trial.angle_deg, trial.pressure_kpa, trial.pressure_rate_kpa_s)
    log = (trial.log_time_s, trial.log_pressure_kpa)
    peaks = turning_pressure(*log, train.turn_s, train.period_s)
    troughs = turning_pressure(*log, train.end_s, train.period_s)
    largest = turning_angle(*frames, peaks, np.stack([train.start_s, train.end_s], axis=1))
    until = np.append(train.turn_s[1:], train.end_s[-1] + _REST_FRACTION * train.period_s)
    residual = turning_angle(*frames, troughs, np.stack([train.turn_s, until], axis=1))
    coverage = tuple(_coverage(trial, s, e) for s, e in zip(train.start_s, train.end_s, strict=True))
    curve = _Curve.of(trial)
    bounds = list(zip(train.start_s.tolist(), train.turn_s.tolist(), train.end_s.tolist(), strict=True))

    def areas(move_s: float) -> FloatArray:
        return np.array([loop_area_deg_kpa(curve.between(start, end, move_s)) for start, _, end in bounds])

    def widths(move_s: float) -> FloatArray:
        return np.array(
            [
                mid_pressure_width_deg(
                    curve.between(start, turn, move_s), curve.between(turn, end, move_s), trough, peak
                )
                for (start, turn, end), trough, peak in zip(bounds, troughs.kpa, peaks.kpa, strict=True)
            ]
        )

    half_s = 0.5 * trial.frame_s
    return MeasuredCycles(
        train=train,
        coverage=coverage,
        refusals=tuple(
            _refusal(trial, train, index, cover, bool(np.isfinite(largest.deg[index])))
            for index, cover in enumerate(coverage)
        ),
        peaks=peaks,
        troughs=troughs,
        largest=largest,
        residual=residual,
        loops=tuple(curve.between(start, end) for start, _, end in bounds),
        frame_noise_deg=frame_noise_deg(curve.angle_deg),
        areas_deg_kpa=areas(0.0),
        widths_deg=widths(0.0),
        area_by_shift=(areas(half_s) - areas(-half_s)) / (2 * half_s),
        width_by_shift=(widths(half_s) - widths(-half_s)) / (2 * half_s),
    )


@dataclass(frozen=True)
class _Curve:
    """The frames with an angle and a pressure, and all frames with a pressure."""

    time_s: FloatArray
    angle_deg: FloatArray
    pressure_time_s: FloatArray
    pressure_kpa: FloatArray

    @classmethod
    def of(cls, trial: TrialData) -> _Curve:
        has_pressure = np.isfinite(trial.pressure_kpa)
        known = has_pressure & np.isfinite(trial.angle_deg)
        return cls(
            trial.time_s[known],
            trial.angle_deg[known],
            trial.time_s[has_pressure],
            trial.pressure_kpa[has_pressure],
        )

    def between(self, start_s: float, end_s: float, move_s: float = 0.0) -> FloatArray:
        """(N, 2) kPa and deg from start to end, both ends interpolated; pressures are taken `move_s` later."""
        first = int(np.searchsorted(self.time_s, start_s, side="right"))
        last = max(int(np.searchsorted(self.time_s, end_s)), first)
        around = slice(max(first - 1, 0), last + 1)
        at = np.concatenate([[start_s], self.time_s[first:last], [end_s]])
        pressure = np.interp(at + move_s, self.pressure_time_s, self.pressure_kpa)
        return np.stack([pressure, np.interp(at, self.time_s[around], self.angle_deg[around])], axis=1)


def _coverage(trial: TrialData, start_s: float, end_s: float) -> Coverage:
    inside = (trial.time_s >= start_s) & (trial.time_s <= end_s)
    known = inside & np.isfinite(trial.angle_deg) & np.isfinite(trial.pressure_kpa)
    at = np.concatenate([[start_s], trial.time_s[known], [end_s]])
    steps = np.diff(at)
    longest = int(np.argmax(steps))
    count = int(inside.sum())
    return Coverage(count, count - int(known.sum()), float(steps[longest]), float(at[longest]))


def _refusal(trial: TrialData, train: CycleTrain, index: int, cover: Coverage, has_angle: bool) -> str:
    """Why a cycle cannot be used; empty where it can."""
    start, end = float(train.start_s[index]), float(train.end_s[index])
    first, last = float(trial.time_s[0]), float(trial.time_s[-1])
    if start < first - 2 * trial.frame_s or end > last + 2 * trial.frame_s:
        return f"the video covers {first:.2f} to {last:.2f} s, the cycle {start:.2f} to {end:.2f} s"
    if np.any((trial.saturated_s >= start) & (trial.saturated_s <= end)):
        return "the pressure sensor was saturated in it"
    if cover.frames - cover.missing < _FEWEST_FRAMES:
        known = cover.frames - cover.missing
        return f"{known} frames with an angle and a pressure, fewer than {_FEWEST_FRAMES}"
    if cover.longest_gap_s > max(_GAP_FRACTION * (end - start), _GAP_FRAMES * trial.frame_s):
        fraction = 100 * cover.longest_gap_s / (end - start)
        return (
            f"no angle or no pressure for {cover.longest_gap_s:.2f} s from {cover.gap_at_s:.2f} s on "
            f"({fraction:.0f} % of the cycle)"
        )
    if cover.missing > _MISSING_FRACTION * cover.frames:
        return f"{cover.missing} of its {cover.frames} frames have no angle or no pressure"
    if train.irregular[index]:
        return train.irregular[index]
    if not has_angle:
        return "too few frames near the largest pressure to estimate the largest angle"
    return ""
