"""One dynamic trial: what every cycle measures, which cycles count, and the trial's values with their intervals.

Cycles come from `cycles.py`, turns from `corner.py` and `branches.py`, the geometry of a loop from `hysteresis.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from scipy import stats

from ..types import FloatArray
from .branches import TurningAngle, turning_angle
from .corner import turning_pressure
from .cycles import CycleTrain, find_cycles
from .hysteresis import hysteresis_ratio, hysteresis_ratio_extremes, loop_area_deg_kpa, mid_pressure_width_deg
from .intervals import NAN, Estimate, combined, line_through, mean_of
from .trial import TrialData

# A gap that a straight line may bridge: 5 % of the cycle costs the area under 0.1 % (the loops are that smooth).
_GAP_SHARE, _GAP_FRAMES = 0.05, 3.5
_MISSING_SHARE = 0.25
_FEWEST_FRAMES = 12
# The first cycle is set apart where the others' spread makes it less likely than this; three numbers are looked at.
_APART_P = 0.01 / 3
# A drift over the cycles is taken for one where chance makes it less likely than this.
_DRIFT_P = 0.01
# Pressure this far below 0, as a share of the largest, leaves the paper's rectangle; so does an angle.
_BELOW_SHARE = 0.05
# Points of a cycle at which cycles are compared.
_PHASES = 100


@dataclass(frozen=True)
class CycleNumbers:
    """What one complete cycle measures. NaN with a reason where it cannot.

    `number` counts complete cycles from 1 on; `reason` says why a cycle is not used (empty where it is).
    The ratio's rectangle is the trial's (the paper's definition), the extremes' is the cycle's own.
    """

    number: int
    used: bool
    reason: str
    start_s: float
    turn_s: float
    end_s: float
    period_s: float
    frames: int
    missing_frames: int
    longest_gap_s: float
    pressure_min_kpa: float
    pressure_max_kpa: float
    largest_angle_deg: float
    residual_angle_deg: float
    hysteresis_deg_kpa: float
    hysteresis_ratio: float
    hysteresis_ratio_extremes: float
    mid_width_deg: float


@dataclass(frozen=True)
class DynamicNumbers:
    """A trial's values. An `Estimate` without a value is NaN and `warnings` say why.

    Attributes
    ----------
    cycles, loops : one entry a complete cycle; a loop is (N, 2) kPa and deg
    cycles_used : their numbers
    first_cycle_apart : the first cycle differs from the others and is left out
    period_s, amplitude_kpa, phase_s : of the pressure wave
    largest_pressure_kpa, dynamic_response_deg : sides of the paper's rectangle
    ratio_per_frame_shift : by how much the ratio grows if the log's clock runs one frame further ahead
    repeatability_deg : RMS over the cycle of the spread (sd) between cycles; includes one frame's noise
    repeatability_hysteresis : spread (sd) of the cycles' areas over their mean
    largest_angle_drift_deg, residual_angle_drift_deg : slope over the cycles, deg per cycle
    """

    cycles: tuple[CycleNumbers, ...]
    loops: tuple[FloatArray, ...]
    cycles_used: tuple[int, ...]
    first_cycle_apart: bool
    period_s: float
    amplitude_kpa: float
    phase_s: float
    largest_pressure_kpa: Estimate
    dynamic_response_deg: Estimate
    hysteresis_deg_kpa: Estimate
    hysteresis_ratio: Estimate
    hysteresis_ratio_extremes: Estimate
    mid_width_deg: Estimate
    residual_angle_deg: Estimate
    largest_angle_drift_deg: Estimate
    residual_angle_drift_deg: Estimate
    ratio_per_frame_shift: float
    repeatability_deg: float
    repeatability_hysteresis: float
    warnings: tuple[str, ...]


def measure_dynamic(trial: TrialData) -> DynamicNumbers:
    """Cycles, per-cycle and trial values of a dynamic trial.

    A trial's value is the mean over the cycles used, with a Student interval over them; the uncertainty of the
    clocks' shift and of what all angles share is added. The dynamic response is the mean of the cycles' largest
    angles too, unless they drift: then it is the larger end of the line through them, and a warning says so.
    """
    known = np.isfinite(trial.pressure_kpa)
    train = find_cycles(trial.log_time_s, trial.log_pressure_kpa)
    warnings = [*train.warnings, *train.incomplete]
    if not train.start_s.size:
        return _nothing(train, warnings)
    if not known.any() or not np.isfinite(trial.angle_deg).any():
        return _nothing(train, [*warnings, "no frame has both an angle and a pressure"])
    measured = _Measured(trial, train)
    reasons = [_refusal(measured, place) for place in range(train.start_s.size)]
    for place, reason in enumerate(reasons):
        if reason:
            warnings.append(f"cycle {place + 1} is not used: {reason}")
    sound = np.array([not reason for reason in reasons])
    first_apart = bool(sound[0]) and _differs(measured.compared[sound])
    used = sound.copy()
    if first_apart:
        used[0] = False
        reasons[0] = "differs from the cycles after it"
        warnings.append(
            "the first cycle differs from the others: it is reported apart and left out of the means"
        )
    if not used.any():
        return _nothing(train, [*warnings, "no cycle can be used"], measured.loops)
    return _values(measured, used, reasons, first_apart, warnings)


class _Measured:
    """Arrays over the complete cycles of a trial, all (C,)."""

    def __init__(self, trial: TrialData, train: CycleTrain) -> None:
        self.trial, self.train = trial, train
        frames = (trial.time_s, trial.angle_deg, trial.pressure_kpa, trial.pressure_rate_kpa_s)
        log = (trial.log_time_s, trial.log_pressure_kpa)
        self.tops = turning_pressure(*log, train.turn_s, train.period_s)
        self.feet = turning_pressure(*log, train.end_s, train.period_s)
        self.largest: TurningAngle = turning_angle(
            *frames, self.tops, np.stack([train.start_s, train.end_s], axis=1)
        )
        after = np.append(train.turn_s[1:], train.end_s[-1] + 0.1 * train.period_s)
        self.residual: TurningAngle = turning_angle(
            *frames, self.feet, np.stack([train.turn_s, after], axis=1)
        )
        self.bounds = [
            (start, end) for start, end in zip(train.start_s.tolist(), train.end_s.tolist(), strict=True)
        ]
        self.loops = tuple(_loop(trial, start, end) for start, end in self.bounds)
        half = 0.5 * trial.frame_s
        self.areas = np.array([loop_area_deg_kpa(loop) for loop in self.loops])
        self.widths = np.array([self._width(place, 0.0) for place in range(len(self.bounds))])
        # How area and width change with the shift (per s), from loops whose pressure is moved half a frame.
        self.area_by_shift, self.width_by_shift = (
            (np.array(later) - np.array(earlier)) / (2 * half)
            for later, earlier in (
                tuple(
                    [loop_area_deg_kpa(_loop(trial, *b, move)) for b in self.bounds] for move in (half, -half)
                ),
                tuple([self._width(p, move) for p in range(len(self.bounds))] for move in (half, -half)),
            )
        )

    @property
    def compared(self) -> FloatArray:
        """(C, 3) what a first cycle is compared in."""
        return np.stack([self.largest.deg, self.residual.deg, self.areas], axis=1)

    def _width(self, place: int, move_s: float) -> float:
        start, end = self.bounds[place]
        turn = float(self.train.turn_s[place])
        return mid_pressure_width_deg(
            _loop(self.trial, start, turn, move_s),
            _loop(self.trial, turn, end, move_s),
            float(self.feet.kpa[place]),
            float(self.tops.kpa[place]),
        )


def _loop(trial: TrialData, start_s: float, end_s: float, move_s: float = 0.0) -> FloatArray:
    """(N, 2) pressure and angle from start to end, both ends interpolated; the pressure of `move_s` later."""
    known = np.isfinite(trial.angle_deg) & np.isfinite(trial.pressure_kpa)
    time_s = trial.time_s
    inside = time_s[known & (time_s > start_s) & (time_s < end_s)]
    at = np.concatenate([[start_s], inside, [end_s]])
    pressed = np.isfinite(trial.pressure_kpa)
    pressure = np.interp(at + move_s, time_s[pressed], trial.pressure_kpa[pressed])
    return np.stack([pressure, np.interp(at, time_s[known], trial.angle_deg[known])], axis=1)


def _refusal(measured: _Measured, place: int) -> str:
    """Why a cycle cannot be used; empty where it can."""
    trial, train = measured.trial, measured.train
    start, end = measured.bounds[place]
    time_s = trial.time_s
    if start < time_s[0] - 2 * trial.frame_s or end > time_s[-1] + 2 * trial.frame_s:
        return f"the video covers {time_s[0]:.2f} to {time_s[-1]:.2f} s, the cycle {start:.2f} to {end:.2f} s"
    if np.any((trial.saturated_s >= start) & (trial.saturated_s <= end)):
        return "the pressure sensor was saturated in it"
    frames, missing, gap_s, gap_at_s = _gaps(trial, start, end)
    if frames - missing < _FEWEST_FRAMES:
        return f"{frames - missing} frames with an angle and a pressure, fewer than {_FEWEST_FRAMES}"
    period = end - start
    if gap_s > max(_GAP_SHARE * period, _GAP_FRAMES * trial.frame_s):
        share = 100 * gap_s / period
        return (
            f"no angle or no pressure for {gap_s:.2f} s from {gap_at_s:.2f} s on ({share:.0f} % of the cycle)"
        )
    if missing > _MISSING_SHARE * frames:
        return f"{missing} of its {frames} frames have no angle or no pressure"
    if train.irregular[place]:
        return train.irregular[place]
    if not math.isfinite(measured.largest.deg[place]):
        return "too few frames near the largest pressure to tell the largest angle"
    return ""


def _gaps(trial: TrialData, start_s: float, end_s: float) -> tuple[int, int, float, float]:
    """Frames in a cycle, those without an angle or a pressure, and the longest time without one and its start."""
    inside = (trial.time_s >= start_s) & (trial.time_s <= end_s)
    known = inside & np.isfinite(trial.angle_deg) & np.isfinite(trial.pressure_kpa)
    at = np.concatenate([[start_s], trial.time_s[known], [end_s]])
    steps = np.diff(at)
    longest = int(np.argmax(steps))
    count = int(inside.sum())
    return count, count - int(known.sum()), float(steps[longest]), float(at[longest])


def _differs(compared: FloatArray) -> bool:
    """Whether the first row lies outside the prediction interval of the others in any column."""
    others = compared[1:]
    if others.shape[0] < 3:
        return False
    spread = others.std(axis=0, ddof=1) * math.sqrt(1 + 1 / others.shape[0])
    off = np.abs(compared[0] - others.mean(axis=0))
    limit = stats.t.ppf(1 - _APART_P / 2, others.shape[0] - 1) * spread
    return bool(np.any(off > limit))


def _values(
    measured: _Measured, used: np.ndarray, reasons: list[str], first_apart: bool, warnings: list[str]
) -> DynamicNumbers:
    trial, train = measured.trial, measured.train
    shift = Estimate(0.0, trial.shift_sd_s)
    angles_share = Estimate(0.0, trial.angle_common_sd_deg)
    number = np.flatnonzero(used) + 1.0
    tops, feet = measured.tops.kpa[used], measured.feet.kpa[used]
    largest, residual = measured.largest.deg[used], measured.residual.deg[used]
    areas, widths = measured.areas[used], measured.widths[used]
    if used.sum() == 1:
        warnings.append("one cycle is used: there is no spread over cycles, hence no interval")

    pressure = mean_of(tops)
    pressure = combined(pressure.value, [(1, pressure), (1, _known(measured.tops.common_sd_kpa))])
    drift, peak, angles_at = _response(number, largest)
    if drift.p_value() < _DRIFT_P:
        warnings.append(
            f"the largest angle drifts by {drift.value:+.2f} deg per cycle: the dynamic response is that of the "
            f"{'last' if drift.value > 0 else 'first'} cycle used, from the line through all"
        )
    angle_parts = [(1.0, peak), (1.0, _known(measured.largest.common_sd_deg)), (1.0, angles_share)]
    response = combined(peak.value, angle_parts)

    area = mean_of(areas)
    area_by_shift = float(np.mean(measured.area_by_shift[used]))
    hysteresis = combined(area.value, [(1, area), (area_by_shift, shift)])
    ratio = NAN
    lowest_kpa, below = float(feet.mean()), _BELOW_SHARE
    if lowest_kpa < -below * abs(pressure.value) or not pressure.value > 0:
        warnings.append(
            f"negative pressure ({lowest_kpa:.1f} to {pressure.value:.1f} kPa): the paper's rectangle to the axes "
            f"does not hold the loop, its hysteresis ratio is not given"
        )
    elif not response.value > 0:
        warnings.append(
            f"the largest angle is {response.value:.1f} deg, not above 0: no hysteresis ratio to the axes"
        )
    else:
        ratio = hysteresis_ratio(area.value, pressure.value, response.value)
    ratio_estimate = Estimate(NAN)
    frame_moves = NAN
    if math.isfinite(ratio):
        # Cycle by cycle to first order, so that what area and angle of a cycle have in common is seen.
        linear = ratio * (1 + areas / area.value - tops / pressure.value - angles_at / response.value)
        per_cycle = mean_of(linear)
        frame_moves = ratio * area_by_shift / area.value
        common_deg = math.hypot(measured.largest.common_sd_deg, trial.angle_common_sd_deg)
        ratio_estimate = combined(
            ratio,
            [
                (1, per_cycle),
                (frame_moves, shift),
                (ratio / response.value, _known(common_deg)),
                (ratio / pressure.value, _known(measured.tops.common_sd_kpa)),
            ],
        )
        if area.value < 0:
            warnings.append(
                "the loop runs the other way round (the angle leads the pressure): look at the clocks' shift"
            )
    extremes = _extremes(measured, used)
    known_residual = residual[np.isfinite(residual)]
    width = mean_of(widths[np.isfinite(widths)])
    left = mean_of(known_residual)
    residual_drift = (
        line_through(number[np.isfinite(residual)], known_residual, 0.0)[0]
        if known_residual.size > 2
        else Estimate(NAN)
    )
    cycles = tuple(
        _cycle_numbers(measured, place, bool(used[place]), reasons[place], pressure.value, response.value)
        for place in range(used.size)
    )
    return DynamicNumbers(
        cycles=cycles,
        loops=measured.loops,
        cycles_used=tuple(int(n) for n in number),
        first_cycle_apart=first_apart,
        period_s=train.period_s,
        amplitude_kpa=float(np.mean(tops) - np.mean(feet)),
        phase_s=train.phase_s,
        largest_pressure_kpa=pressure,
        dynamic_response_deg=response,
        hysteresis_deg_kpa=hysteresis,
        hysteresis_ratio=ratio_estimate,
        hysteresis_ratio_extremes=combined(
            extremes.value,
            [(1, extremes), (extremes.value * area_by_shift / area.value if area.value else 0.0, shift)],
        ),
        mid_width_deg=combined(
            width.value, [(1, width), (float(np.nanmean(measured.width_by_shift[used])), shift)]
        ),
        residual_angle_deg=combined(
            left.value, [(1, left), (1, _known(measured.residual.common_sd_deg)), (1, angles_share)]
        ),
        largest_angle_drift_deg=drift,
        residual_angle_drift_deg=residual_drift,
        ratio_per_frame_shift=frame_moves * trial.frame_s,
        repeatability_deg=_repeatability_deg(measured, used),
        repeatability_hysteresis=float(areas.std(ddof=1) / area.value) if areas.size > 1 else NAN,
        warnings=tuple(warnings),
    )


def _response(number: FloatArray, largest: FloatArray) -> tuple[Estimate, Estimate, FloatArray]:
    """Drift of the largest angle, the dynamic response, and the cycles' angles freed of a drift."""
    if largest.size < 4:
        return Estimate(NAN), mean_of(largest), largest
    drift, _ = line_through(number, largest, 0.0)
    if not drift.p_value() < _DRIFT_P:
        return drift, mean_of(largest), largest
    at = float(number[-1] if drift.value > 0 else number[0])
    peak = line_through(number, largest, at)[1]
    return drift, peak, largest + drift.value * (at - number)


def _extremes(measured: _Measured, used: np.ndarray) -> Estimate:
    """Ratio to the loop's own extremes, the mean over cycles, each in the trial's mean rectangle."""
    areas, tops, feet = measured.areas[used], measured.tops.kpa[used], measured.feet.kpa[used]
    largest, residual = measured.largest.deg[used], measured.residual.deg[used]
    whole = np.isfinite(residual)
    if not whole.any():
        return Estimate(NAN)
    pressures = (float(feet[whole].mean()), float(tops[whole].mean()))
    angles = (float(residual[whole].mean()), float(largest[whole].mean()))
    ratio = hysteresis_ratio_extremes(float(areas[whole].mean()), pressures, angles)
    linear = ratio * (
        1
        + areas[whole] / areas[whole].mean()
        - (tops - feet)[whole] / (pressures[1] - pressures[0])
        - (largest - residual)[whole] / (angles[1] - angles[0])
    )
    spread = mean_of(linear)
    return Estimate(ratio, spread.sd, spread.dof)


def _cycle_numbers(
    measured: _Measured, place: int, used: bool, reason: str, pressure_kpa: float, response_deg: float
) -> CycleNumbers:
    start, end = measured.bounds[place]
    frames, missing, gap_s, _ = _gaps(measured.trial, start, end)
    # A cycle that is refused keeps no number that its fault could have touched.
    believable = used or reason.startswith("differs")
    top, foot = float(measured.tops.kpa[place]), float(measured.feet.kpa[place])
    largest, residual, area, width = (
        float(values[place]) if believable else NAN
        for values in (measured.largest.deg, measured.residual.deg, measured.areas, measured.widths)
    )
    return CycleNumbers(
        number=place + 1,
        used=used,
        reason=reason,
        start_s=start,
        turn_s=float(measured.train.turn_s[place]),
        end_s=end,
        period_s=end - start,
        frames=frames,
        missing_frames=missing,
        longest_gap_s=gap_s,
        pressure_min_kpa=foot,
        pressure_max_kpa=top,
        largest_angle_deg=largest,
        residual_angle_deg=residual,
        hysteresis_deg_kpa=area,
        hysteresis_ratio=hysteresis_ratio(area, pressure_kpa, response_deg),
        hysteresis_ratio_extremes=hysteresis_ratio_extremes(area, (foot, top), (residual, largest)),
        mid_width_deg=width,
    )


def _repeatability_deg(measured: _Measured, used: np.ndarray) -> float:
    """RMS over the cycle's phase of the spread (sd) of the angle between the cycles used."""
    if used.sum() < 2:
        return NAN
    trial = measured.trial
    known = np.isfinite(trial.angle_deg)
    at = [np.linspace(*measured.bounds[place], _PHASES, endpoint=False) for place in np.flatnonzero(used)]
    angles = np.interp(np.array(at), trial.time_s[known], trial.angle_deg[known])
    return float(np.sqrt(np.mean(np.var(angles, axis=0, ddof=1))))


def _known(sd: float) -> Estimate:
    """A source of uncertainty whose standard deviation is known; one that could not be told adds nothing."""
    return Estimate(0.0, sd if math.isfinite(sd) else 0.0)


def _nothing(train: CycleTrain, warnings: list[str], loops: tuple[FloatArray, ...] = ()) -> DynamicNumbers:
    missing = {field.name: Estimate(NAN) for field in fields(DynamicNumbers) if field.type == "Estimate"}
    return DynamicNumbers(
        cycles=(),
        loops=loops,
        cycles_used=(),
        first_cycle_apart=False,
        period_s=train.period_s,
        amplitude_kpa=train.amplitude_kpa,
        phase_s=train.phase_s,
        ratio_per_frame_shift=NAN,
        repeatability_deg=NAN,
        repeatability_hysteresis=NAN,
        warnings=tuple(warnings),
        **missing,
    )
