"""One dynamic trial: the numbers of every cycle, which cycles are used, and the trial's values with their intervals.

Loops and numbers of the cycles come from `measured_cycles.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..types import FloatArray
from .cycles import CycleTrain, find_cycles
from .hysteresis import hysteresis_ratio, hysteresis_ratio_extremes
from .intervals import NAN, Estimate, combined, line_through, mean_of, student_quantile
from .measured_cycles import MeasuredCycles, measure_cycles
from .trial import TrialData

# The first cycle is excluded below this p-value under the others' spread (Bonferroni over three numbers).
_APART_P = 0.01 / 3
# A drift over the cycles is significant below this p-value.
_DRIFT_P = 0.01
# Pressure further below 0 than this fraction of the largest leaves the paper's rectangle.
_BELOW_FRACTION = 0.05
# A largest angle below so many of its standard deviations is no movement.
_MOVED_SD = 3.0
# Pressures at which cycles are compared, on either branch.
_LEVELS = 50
_APART = "differs from the cycles after it"


@dataclass(frozen=True)
class CycleNumbers:
    """The numbers of one complete cycle; NaN, with a reason, where it is not usable.

    `number` counts complete cycles from 1 on; `reason` says why a cycle is not used (empty where it is).
    The ratio's rectangle is the trial's (the paper's definition), the extremes' is the cycle's own.

    Attributes
    ----------
    number : int
        Number of the complete cycle, from 1.
    used : bool
        Whether the cycle enters the trial's values.
    reason : str
        Why it does not, else empty.
    start_s, turn_s, end_s : float
        Begin, largest pressure and end, s.
    period_s : float
        Duration, s.
    frames : int
        Number of frames.
    missing_frames : int
        Frames without an angle or a pressure.
    longest_gap_s : float
        Longest time without such a frame, s.
    pressure_min_kpa, pressure_max_kpa : float
        Pressure at the end and at the turn, kPa.
    largest_angle_deg : float
        Angle at the turn, degrees.
    residual_angle_deg : float
        Angle at the end, degrees.
    hysteresis_deg_kpa : float
        Area of the loop, deg kPa.
    hysteresis_ratio : float
        Area over the trial's rectangle to the axes.
    hysteresis_ratio_extremes : float
        Area over the rectangle of the cycle's own extremes.
    mid_width_deg : float
        Width of the loop at mid pressure, degrees.
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
    cycles : tuple of CycleNumbers
        One entry for each complete cycle.
    loops : tuple of ndarray of float
        (N, 2) kPa and deg of each cycle used, and of a first cycle that is excluded.
    cycles_used : tuple of int
        Numbers of the cycles used.
    first_cycle_apart : bool
        The first cycle differs from the others and is excluded.
    period_s, amplitude_kpa, phase_s : float
        Period, peak-to-peak amplitude and begin of the pressure wave.
    largest_pressure_kpa, dynamic_response_deg : Estimate
        Sides of the paper's rectangle.
    hysteresis_deg_kpa : Estimate
        Cumulative hysteresis: area of the loop.
    hysteresis_ratio : Estimate
        The paper's ratio: area over the rectangle to the axes.
    hysteresis_ratio_extremes : Estimate
        Area over the rectangle of the loop's own extremes.
    mid_width_deg : Estimate
        Width of the loop at mid pressure.
    residual_angle_deg : Estimate
        Angle at the end of a cycle.
    largest_angle_drift_deg, residual_angle_drift_deg : Estimate
        Slope over the cycles, deg per cycle.
    ratio_per_frame_shift : float
        Change of the ratio if every angle is assigned the pressure of one frame later (a delay one
        frame smaller).
    repeatability_deg : float
        RMS over both branches of the spread (sd) between cycles of the angle at one pressure; the
        noise of a frame is included.
    repeatability_hysteresis : float
        Spread (sd) of the cycles' areas over their mean.
    warnings : tuple of str
        One sentence each.
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
    clocks' shift and the angles' common uncertainty are added. The dynamic response is the mean of the cycles' largest
    angles too, unless they drift: then it is the larger end of the line through them, and a warning says so.

    Parameters
    ----------
    trial : TrialData
        The trial.

    Returns
    -------
    DynamicNumbers
        The numbers; NaN with warnings where they cannot be given.
    """
    train = find_cycles(trial.log_time_s, trial.log_pressure_kpa)
    warnings = [*train.warnings, *train.incomplete]
    if not train.start_s.size:
        return _no_values(train, warnings)
    if not np.any(np.isfinite(trial.pressure_kpa) & np.isfinite(trial.angle_deg)):
        return _no_values(train, [*warnings, "no frame has both an angle and a pressure"])
    measured = measure_cycles(trial, train)
    reasons = list(measured.refusals)
    warnings += [f"cycle {index} is not used: {reason}" for index, reason in enumerate(reasons, 1) if reason]
    used = np.array([not reason for reason in reasons])
    first_apart = bool(used[0]) and _first_differs(measured, used)
    if first_apart:
        used[0] = False
        reasons[0] = _APART
        warnings.append(
            "the first cycle differs from the others: it is reported apart and left out of the means"
        )
    if not used.any():
        cycles = tuple(_cycle_numbers(measured, index, reason, NAN) for index, reason in enumerate(reasons))
        return _no_values(train, [*warnings, "no cycle can be used"], cycles)
    if used.sum() == 1:
        warnings.append("one cycle is used: there is no spread over cycles, hence no interval")
    return _values(trial, measured, _Used.of(measured, used), reasons, warnings)


@dataclass(frozen=True)
class _Used:
    """The cycles used: arrays over them, and which of all cycles they are."""

    chosen: np.ndarray  # (C,) mask over all cycles
    number: FloatArray  # from 1 on
    peaks_kpa: FloatArray
    troughs_kpa: FloatArray
    largest_deg: FloatArray
    residual_deg: FloatArray
    areas: FloatArray
    area_by_shift: float

    @classmethod
    def of(cls, measured: MeasuredCycles, used: np.ndarray) -> _Used:
        return cls(
            chosen=used,
            number=np.flatnonzero(used) + 1.0,
            peaks_kpa=measured.peaks.kpa[used],
            troughs_kpa=measured.troughs.kpa[used],
            largest_deg=measured.largest.deg[used],
            residual_deg=measured.residual.deg[used],
            areas=measured.areas_deg_kpa[used],
            area_by_shift=float(measured.area_by_shift[used].mean()),
        )


def _first_differs(measured: MeasuredCycles, sound: np.ndarray) -> bool:
    """Whether the first cycle lies outside the prediction interval of the others in any of three numbers."""
    compared = np.stack([measured.largest.deg, measured.residual.deg, measured.areas_deg_kpa], axis=1)[sound]
    others = compared[1:]
    if others.shape[0] < 3:
        return False
    spread = others.std(axis=0, ddof=1) * math.sqrt(1 + 1 / others.shape[0])
    off = np.abs(compared[0] - others.mean(axis=0))
    limit = student_quantile(1 - _APART_P / 2, others.shape[0] - 1) * spread
    return bool(np.any(off > limit))


def _values(
    trial: TrialData, measured: MeasuredCycles, used: _Used, reasons: list[str], warnings: list[str]
) -> DynamicNumbers:
    shift = Estimate(0.0, trial.shift_sd_s)
    shared_deg = Estimate(0.0, trial.angle_common_sd_deg)
    peaks = mean_of(used.peaks_kpa)
    pressure = combined(peaks.value, [(1, peaks), (1, _component(measured.peaks.common_sd_kpa))])
    drift, peak, largest_deg = _peak(used)
    common_deg = _component(
        math.hypot(_component(measured.largest.common_sd_deg).sd, trial.angle_common_sd_deg)
    )
    response = combined(peak.value, [(1, peak), (1, common_deg)])
    area = mean_of(used.areas)
    ratio = _ratio(measured, used, pressure, response, largest_deg, common_deg, shift, warnings)
    rectangle = area.value / ratio.value if ratio.value else NAN
    warnings += _angle_warnings(measured, drift, area)
    whole = np.isfinite(used.residual_deg)
    residual = mean_of(used.residual_deg[whole])
    residual_drift = Estimate(NAN)
    if whole.sum() > 2:
        residual_drift = line_through(used.number[whole], used.residual_deg[whole], 0.0)[0]
    apart = reasons[0] == _APART
    return DynamicNumbers(
        cycles=tuple(_cycle_numbers(measured, p, reason, rectangle) for p, reason in enumerate(reasons)),
        loops=tuple(loop for p, loop in enumerate(measured.loops) if used.chosen[p] or (apart and p == 0)),
        cycles_used=tuple(int(number) for number in used.number),
        first_cycle_apart=apart,
        period_s=measured.train.period_s,
        amplitude_kpa=float(np.mean(used.peaks_kpa - used.troughs_kpa)),
        phase_s=measured.train.phase_s,
        largest_pressure_kpa=pressure,
        dynamic_response_deg=response,
        hysteresis_deg_kpa=combined(area.value, [(1, area), (used.area_by_shift, shift)]),
        hysteresis_ratio=ratio,
        hysteresis_ratio_extremes=_extremes(used, whole, shift),
        mid_width_deg=_width(measured, used, shift),
        residual_angle_deg=combined(
            residual.value, [(1, residual), (1, _component(measured.residual.common_sd_deg)), (1, shared_deg)]
        ),
        largest_angle_drift_deg=drift,
        residual_angle_drift_deg=residual_drift,
        ratio_per_frame_shift=used.area_by_shift * trial.frame_s / rectangle,
        repeatability_deg=_repeatability_deg(measured, used),
        repeatability_hysteresis=_relative_spread(used.areas),
        warnings=tuple(warnings),
    )


def _peak(used: _Used) -> tuple[Estimate, Estimate, FloatArray]:
    """Drift of the largest angle, the dynamic response, and the cycles' largest angles without the drift."""
    if used.number.size < 4:
        return Estimate(NAN), mean_of(used.largest_deg), used.largest_deg
    drift, _ = line_through(used.number, used.largest_deg, 0.0)
    if not drift.p_value() < _DRIFT_P:
        return drift, mean_of(used.largest_deg), used.largest_deg
    at = float(used.number[-1] if drift.value > 0 else used.number[0])
    peak = line_through(used.number, used.largest_deg, at)[1]
    return drift, peak, used.largest_deg + drift.value * (at - used.number)


def _ratio(
    measured: MeasuredCycles,
    used: _Used,
    pressure: Estimate,
    response: Estimate,
    largest_deg: FloatArray,
    common_deg: Estimate,
    shift: Estimate,
    warnings: list[str],
) -> Estimate:
    """The paper's hysteresis ratio; NaN, and a warning, where its rectangle does not hold the loop."""
    lowest_kpa = float(used.troughs_kpa.mean())
    if not pressure.value > 0 or lowest_kpa < -_BELOW_FRACTION * pressure.value:
        warnings.append(
            f"negative pressure ({lowest_kpa:.1f} to {pressure.value:.1f} kPa): the paper's rectangle to the axes "
            f"does not hold the loop, its hysteresis ratio is not given"
        )
        return Estimate(NAN)
    if not response.value > 0:
        warnings.append(
            f"the largest angle is {response.value:.1f} deg, not above 0: no hysteresis ratio to the axes"
        )
        return Estimate(NAN)
    if response.value < _MOVED_SD * (response.sd if math.isfinite(response.sd) else measured.frame_noise_deg):
        warnings.append(
            f"the largest angle is {response.value:.2g} deg, within its noise: no hysteresis ratio to the axes"
        )
        return Estimate(NAN)
    ratio = hysteresis_ratio(float(used.areas.mean()), pressure.value, response.value)
    rectangle = pressure.value * response.value
    # Linearised for each cycle, so that the correlation of a cycle's area and angle is kept.
    per_cycle = mean_of(
        used.areas / rectangle - ratio * (used.peaks_kpa / pressure.value + largest_deg / response.value)
    )
    return combined(
        ratio,
        [
            (1, per_cycle),
            (used.area_by_shift / rectangle, shift),
            (ratio / response.value, common_deg),
            (ratio / pressure.value, _component(measured.peaks.common_sd_kpa)),
        ],
    )


def _angle_warnings(measured: MeasuredCycles, drift: Estimate, area: Estimate) -> list[str]:
    found = []
    if drift.p_value() < _DRIFT_P:
        found.append(
            f"the largest angle drifts by {drift.value:+.2f} deg per cycle: the dynamic response is that of the "
            f"{'last' if drift.value > 0 else 'first'} cycle used, from the line through all"
        )
    if measured.largest.misfit_deg > 0:
        found.append(
            f"the angle near its largest is not smooth: the branches lie {measured.largest.misfit_deg:.2f} deg off "
            f"the frames beyond their noise, which widens the interval"
        )
    if measured.largest.deg.size and (measured.largest.deg < 0).all():
        found.append(
            "the angles are negative where the pressure is highest: the sign is another actuator's, or the film is"
            " mirrored (angle.sign in bendtrack.toml, or an actuator of its own)"
        )
    elif area.value < 0:
        found.append(
            "the loop runs the other way round (the angle leads the pressure): look at the clocks' shift"
        )
    return found


def _extremes(used: _Used, whole: np.ndarray, shift: Estimate) -> Estimate:
    """Ratio to the loop's own extremes: mean area over the rectangle of the cycles' mean extremes."""
    if not whole.any():
        return Estimate(NAN)
    areas, peaks, troughs = used.areas[whole], used.peaks_kpa[whole], used.troughs_kpa[whole]
    largest, residual = used.largest_deg[whole], used.residual_deg[whole]
    pressures = (float(troughs.mean()), float(peaks.mean()))
    angles = (float(residual.mean()), float(largest.mean()))
    ratio = hysteresis_ratio_extremes(float(areas.mean()), pressures, angles)
    if not math.isfinite(ratio):
        return Estimate(NAN)
    range_kpa, range_deg = pressures[1] - pressures[0], angles[1] - angles[0]
    per_cycle = mean_of(
        areas / (range_kpa * range_deg)
        - ratio * ((peaks - troughs) / range_kpa + (largest - residual) / range_deg)
    )
    return combined(ratio, [(1, per_cycle), (used.area_by_shift / (range_kpa * range_deg), shift)])


def _width(measured: MeasuredCycles, used: _Used, shift: Estimate) -> Estimate:
    wide = used.chosen & np.isfinite(measured.widths_deg + measured.width_by_shift)
    if not wide.any():
        return Estimate(NAN)
    width = mean_of(measured.widths_deg[wide])
    return combined(width.value, [(1, width), (float(measured.width_by_shift[wide].mean()), shift)])


def _cycle_numbers(measured: MeasuredCycles, index: int, reason: str, rectangle: float) -> CycleNumbers:
    # A refused cycle keeps no number that its fault may have affected.
    usable = reason in ("", _APART)
    largest, residual, area, width = (
        float(values[index]) if usable else NAN
        for values in (
            measured.largest.deg,
            measured.residual.deg,
            measured.areas_deg_kpa,
            measured.widths_deg,
        )
    )
    peak, trough = float(measured.peaks.kpa[index]), float(measured.troughs.kpa[index])
    start, end = float(measured.train.start_s[index]), float(measured.train.end_s[index])
    cover = measured.coverage[index]
    return CycleNumbers(
        number=index + 1,
        used=not reason,
        reason=reason,
        start_s=start,
        turn_s=float(measured.train.turn_s[index]),
        end_s=end,
        period_s=end - start,
        frames=cover.frames,
        missing_frames=cover.missing,
        longest_gap_s=cover.longest_gap_s,
        pressure_min_kpa=trough,
        pressure_max_kpa=peak,
        largest_angle_deg=largest,
        residual_angle_deg=residual,
        hysteresis_deg_kpa=area,
        hysteresis_ratio=area / rectangle,
        hysteresis_ratio_extremes=hysteresis_ratio_extremes(area, (trough, peak), (residual, largest)),
        mid_width_deg=width,
    )


def _repeatability_deg(measured: MeasuredCycles, used: _Used) -> float:
    """RMS over both branches of the spread (sd) between the cycles used of the angle at one pressure."""
    if used.number.size < 2:
        return NAN
    levels = np.linspace(used.troughs_kpa.mean(), used.peaks_kpa.mean(), _LEVELS + 2)[1:-1]
    angles = []
    for index in np.flatnonzero(used.chosen):
        loop = measured.loops[index]
        peak = int(np.argmax(loop[:, 0]))
        # np.interp needs rising pressures; noise may reverse them for a frame.
        angles.append(
            [
                np.interp(levels, np.maximum.accumulate(branch[:, 0]), branch[:, 1])
                for branch in (loop[: peak + 1], loop[peak:][::-1])
            ]
        )
    return float(np.sqrt(np.mean(np.var(angles, axis=0, ddof=1))))


def _relative_spread(values: FloatArray) -> float:
    """Standard deviation over the mean; NaN of one value or around 0."""
    mean = float(values.mean())
    return float(values.std(ddof=1)) / abs(mean) if values.size > 1 and mean else NAN


def _component(sd: float) -> Estimate:
    """An uncertainty component with a known standard deviation; an unknown one (NaN) adds nothing."""
    return Estimate(0.0, sd if math.isfinite(sd) else 0.0)


def _no_values(
    train: CycleTrain,
    warnings: list[str],
    cycles: tuple[CycleNumbers, ...] = (),
) -> DynamicNumbers:
    """A trial without values: its wave as far as known, and warnings with the reason."""
    unknown = Estimate(NAN)
    return DynamicNumbers(
        cycles=cycles,
        loops=(),
        cycles_used=(),
        first_cycle_apart=False,
        period_s=train.period_s,
        amplitude_kpa=train.amplitude_kpa,
        phase_s=train.phase_s,
        largest_pressure_kpa=unknown,
        dynamic_response_deg=unknown,
        hysteresis_deg_kpa=unknown,
        hysteresis_ratio=unknown,
        hysteresis_ratio_extremes=unknown,
        mid_width_deg=unknown,
        residual_angle_deg=unknown,
        largest_angle_drift_deg=unknown,
        residual_angle_drift_deg=unknown,
        ratio_per_frame_shift=NAN,
        repeatability_deg=NAN,
        repeatability_hysteresis=NAN,
        warnings=tuple(warnings),
    )
