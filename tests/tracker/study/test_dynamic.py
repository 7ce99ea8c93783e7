"""Dynamic trials of loops whose area, width and largest angle are known in closed form."""

import dataclasses

import numpy as np
import pytest

from bendtrack.tracker.study.dynamic import measure_dynamic
from bendtrack.tracker.study.trial import Kind, Shift, TrialData
from bendtrack.tracker.synthetic.response import HystereticResponse

PERIOD_S, PEAK_KPA, CYCLES = 4.0, 50.0, 8
FPS, LOG_HZ = 30, 400
FINE_S = np.arange(0, CYCLES * PERIOD_S + 1e-9, 1 / 3000)


def triangle_kpa(time_s):
    return PEAK_KPA * (1 - np.abs(2 * (time_s / PERIOD_S % 1) - 1))


def sine_kpa(time_s):
    return PEAK_KPA * (1 - np.cos(2 * np.pi * time_s / PERIOD_S)) / 2


def trapezoid_kpa(time_s):
    return PEAK_KPA * np.clip(2.5 * (1 - np.abs(2 * (time_s / PERIOD_S % 1) - 1)) - 0.6, 0, 1)


def backlash_deg(pressure_kpa, width_kpa, deg_per_kpa=2.0, offset_deg=3.0):
    """A play of `width_kpa`: its loop is a parallelogram of (peak - width) x width kPa^2 times the slope."""
    angle, last = np.empty_like(pressure_kpa), 0.0
    for place, pressure in enumerate(pressure_kpa.tolist()):
        last = min(max(last, pressure - width_kpa), pressure)
        angle[place] = last
    return offset_deg + deg_per_kpa * angle


def trial_of(
    wave, angle_of_time, noise_deg=0.3, noise_kpa=0.05, seed=0, delay_s=0.0, first_s=0.011, **changed
):
    """Frames and log of a trial; the log's clock is `delay_s` off and nobody knows."""
    rng = np.random.default_rng(seed)
    log_s = np.arange(0, CYCLES * PERIOD_S, 1 / LOG_HZ)
    log_kpa = wave(log_s) + noise_kpa * rng.standard_normal(log_s.size)
    time_s = np.arange(first_s, CYCLES * PERIOD_S - 0.02, 1 / FPS)
    angle_deg = angle_of_time(time_s) + noise_deg * rng.standard_normal(time_s.size)
    frames = (time_s + 0.001, time_s - 0.001)
    trial = TrialData(
        name="trial",
        design="original",
        kind=Kind.DYNAMIC,
        frequency_hz=1 / PERIOD_S,
        pressure_pp_kpa=PEAK_KPA,
        time_s=time_s,
        angle_deg=angle_deg,
        angle_sd_deg=np.full(time_s.size, noise_deg),
        pressure_kpa=wave(time_s - delay_s),
        pressure_rate_kpa_s=(wave(frames[0] - delay_s) - wave(frames[1] - delay_s)) / 0.002,
        log_time_s=log_s + delay_s,
        log_pressure_kpa=log_kpa,
        shift=Shift(delay_s, 0.01, "given delay"),
    )
    return dataclasses.replace(trial, **changed)


def of_fine(angle_deg):
    return lambda time_s: np.interp(time_s, FINE_S, angle_deg)


def curved(wave=triangle_kpa, ratio=0.238, largest=118.0, smallest=4.0):
    return of_fine(HystereticResponse(PEAK_KPA, smallest, largest, ratio).angle_deg(wave(FINE_S)))


def assert_within(estimate, truth, at_most):
    """Near the truth, and not by an interval that would hold anything."""
    assert estimate.value == pytest.approx(truth, abs=at_most)
    low, high = estimate.interval(0.99)
    assert low <= truth <= high


@pytest.mark.parametrize("wave", [triangle_kpa, sine_kpa, trapezoid_kpa])
def test_a_response_of_known_ratio(wave):
    numbers = measure_dynamic(trial_of(wave, curved(wave)))
    assert numbers.cycles_used == tuple(range(1, CYCLES + 1))
    assert_within(numbers.dynamic_response_deg, 118, 0.15)
    assert_within(numbers.residual_angle_deg, 4, 0.2)
    assert_within(numbers.largest_pressure_kpa, PEAK_KPA, 0.03)
    assert_within(numbers.hysteresis_ratio, 0.238, 0.0015)
    assert_within(numbers.hysteresis_ratio_extremes, 0.238 * 118 / 114, 0.0015)
    assert_within(numbers.hysteresis_deg_kpa, 0.238 * 118 * PEAK_KPA, 8)
    assert numbers.warnings == ()


@pytest.mark.parametrize("wave", [triangle_kpa, sine_kpa, trapezoid_kpa])
@pytest.mark.parametrize("width_kpa", [5.0, 12.0])
def test_a_backlash_is_a_parallelogram(wave, width_kpa):
    trial = trial_of(wave, of_fine(backlash_deg(wave(FINE_S), width_kpa)), noise_deg=0.1)
    numbers = measure_dynamic(trial)
    largest = 3 + 2 * (PEAK_KPA - width_kpa)
    area = 2 * width_kpa * (PEAK_KPA - width_kpa)
    assert numbers.dynamic_response_deg.value == pytest.approx(largest, abs=0.2)
    assert numbers.residual_angle_deg.value == pytest.approx(3, abs=0.2)
    assert numbers.mid_width_deg.value == pytest.approx(2 * width_kpa, abs=0.15)
    # A straight line from frame to frame cuts a corner of 2 deg/kPa by 2 x step^2 / 12 on average; there are four.
    corners = 4 * 2 * np.abs(np.diff(trial.pressure_kpa)).max() ** 2 / 12
    at_most = max(0.005 * area, corners)
    assert numbers.hysteresis_deg_kpa.value == pytest.approx(area, abs=at_most)
    assert numbers.hysteresis_ratio.value == pytest.approx(
        area / PEAK_KPA / largest, abs=at_most / PEAK_KPA / largest
    )


def test_a_lagging_sine_is_an_ellipse():
    lag_rad = 0.25
    numbers = measure_dynamic(
        trial_of(sine_kpa, lambda t: 60 * (1 - np.cos(2 * np.pi * t / PERIOD_S - lag_rad)))
    )
    area = np.pi * PEAK_KPA / 2 * 60 * np.sin(lag_rad)
    assert numbers.dynamic_response_deg.value == pytest.approx(120, abs=0.2)
    assert numbers.hysteresis_deg_kpa.value == pytest.approx(area, rel=0.005)
    assert numbers.hysteresis_ratio.value == pytest.approx(area / PEAK_KPA / 120, rel=0.005)
    assert numbers.mid_width_deg.value == pytest.approx(120 * np.sin(lag_rad), abs=0.2)


def test_a_lagging_material_reaches_its_largest_angle_after_the_pressure():
    steady, share = curved()(FINE_S), 1 - np.exp(-1 / 3000 / 0.15)
    lagging, last = np.empty_like(steady), steady[0]
    for place, angle in enumerate(steady.tolist()):
        last += share * (angle - last)
        lagging[place] = last
    numbers = measure_dynamic(trial_of(triangle_kpa, of_fine(lagging)))
    # At the pressure's turn itself it has reached 97 of these 107 degrees.
    assert numbers.dynamic_response_deg.value == pytest.approx(lagging.max(), abs=0.7)


@pytest.mark.parametrize("wave", [triangle_kpa, sine_kpa])
def test_the_largest_angle_has_no_bias_from_noise(wave):
    errors, raw = [], []
    for seed in range(12):
        trial = trial_of(wave, curved(wave), noise_deg=0.5, seed=seed, first_s=seed / 12 / FPS)
        errors.append(measure_dynamic(trial).dynamic_response_deg.value - 118)
        raw.append(trial.angle_deg.max() - 118)
    # 8 cycles of 120 frames: the errors' own spread is 0.1 deg, their mean's 0.03.
    assert abs(np.mean(errors)) < 0.09
    assert np.std(errors) < 0.16
    if wave is sine_kpa:  # which dwells at its top, so that the largest of many noisy frames is far too large
        assert np.mean(raw) > 0.8


@pytest.mark.parametrize("delay_s", [-1 / FPS, -0.01, 0.01, 1 / FPS])
def test_a_wrong_shift_moves_the_ratio_as_was_said_and_no_angle(delay_s):
    right = measure_dynamic(trial_of(triangle_kpa, curved()))
    wrong = measure_dynamic(trial_of(triangle_kpa, curved(), delay_s=delay_s))
    # A delay that is too long gives a frame the pressure of an earlier time.
    said = -right.ratio_per_frame_shift * delay_s * FPS
    assert wrong.hysteresis_ratio.value - right.hysteresis_ratio.value == pytest.approx(said, abs=0.0015)
    # The loop of a triangle gains 4 frequency x shift x (largest - smallest) / largest, minus what a frame of shift
    # takes off its two tips.
    assert right.ratio_per_frame_shift == pytest.approx(4 / PERIOD_S / FPS * 114 / 118, rel=0.04)
    assert wrong.dynamic_response_deg.value == pytest.approx(118, abs=0.2)


def test_the_shift_is_in_every_interval_of_the_loop():
    shift_s = 0.05
    numbers = measure_dynamic(trial_of(triangle_kpa, curved(), shift=Shift(0, shift_s, "sync event")))
    by_shift = 4 / PERIOD_S * 114 / 118 * shift_s
    assert numbers.hysteresis_ratio.sd == pytest.approx(by_shift, rel=0.04)
    assert numbers.hysteresis_deg_kpa.sd == pytest.approx(by_shift * PEAK_KPA * 118, rel=0.04)
    assert (
        numbers.mid_width_deg.sd > 2 * shift_s * 25
    )  # 2 x 50 deg/s at least, the branches' slope in the middle
    assert numbers.dynamic_response_deg.sd < 0.2


def test_half_a_frame_is_the_least_uncertainty_of_a_shift():
    sure = measure_dynamic(trial_of(triangle_kpa, curved(), shift=Shift(0, 0.0, "shared clock")))
    assert sure.hysteresis_ratio.sd > 0.99 * sure.ratio_per_frame_shift * 0.5 / 3**0.5


def test_what_all_angles_share_is_in_the_interval():
    alone = measure_dynamic(trial_of(triangle_kpa, curved()))
    shared = measure_dynamic(trial_of(triangle_kpa, curved(), angle_common_sd_deg=2.0))
    for name in ("dynamic_response_deg", "residual_angle_deg"):
        expected = np.hypot(getattr(alone, name).sd, 2.0)
        assert getattr(shared, name).sd == pytest.approx(expected, rel=1e-6)
    assert shared.hysteresis_ratio.sd > alone.hysteresis_ratio.sd


def test_a_first_cycle_that_differs_is_set_apart():
    first = FINE_S < PERIOD_S
    angle = curved()(FINE_S)
    numbers = measure_dynamic(trial_of(triangle_kpa, of_fine(np.where(first, 0.9 * angle, angle))))
    assert numbers.first_cycle_apart
    assert numbers.cycles_used == tuple(range(2, CYCLES + 1))
    assert numbers.dynamic_response_deg.value == pytest.approx(118, abs=0.2)
    apart = numbers.cycles[0]
    assert (apart.used, apart.reason) == (False, "differs from the cycles after it")
    assert apart.largest_angle_deg == pytest.approx(0.9 * 118, abs=1.0)
    assert len(numbers.loops) == CYCLES
    assert "first cycle differs" in " ".join(numbers.warnings)


def test_a_drift_is_measured_and_the_largest_end_taken():
    drift = 0.5 * FINE_S / PERIOD_S
    numbers = measure_dynamic(trial_of(triangle_kpa, of_fine(curved()(FINE_S) + drift)))
    assert_within(numbers.largest_angle_drift_deg, 0.5, 0.15)
    assert_within(numbers.residual_angle_drift_deg, 0.5, 0.15)
    assert numbers.dynamic_response_deg.value == pytest.approx(118 + 0.5 * (CYCLES - 0.5), abs=0.4)
    assert any("the largest angle drifts by +0.5" in warning for warning in numbers.warnings)


def test_repeatability_is_the_spread_between_cycles():
    quiet = measure_dynamic(trial_of(triangle_kpa, curved(), noise_deg=0.0))
    noisy = measure_dynamic(trial_of(triangle_kpa, curved(), noise_deg=1.0))
    assert quiet.repeatability_deg < 0.02
    # Between two frames noise is interpolated away in part: sqrt(2 / 3) of it is left in the mean.
    assert noisy.repeatability_deg == pytest.approx((2 / 3) ** 0.5, abs=0.06)
    assert quiet.repeatability_hysteresis < 1e-3


def test_missing_frames_cost_nothing_where_they_are_few():
    trial = trial_of(triangle_kpa, curved())
    lost = np.random.default_rng(5).random(trial.time_s.size) < 0.1
    numbers = measure_dynamic(dataclasses.replace(trial, angle_deg=np.where(lost, np.nan, trial.angle_deg)))
    assert numbers.cycles_used == tuple(range(1, CYCLES + 1))
    assert numbers.hysteresis_ratio.value == pytest.approx(0.238, abs=0.0015)
    assert numbers.dynamic_response_deg.value == pytest.approx(118, abs=0.2)
    assert sum(cycle.missing_frames for cycle in numbers.cycles) == pytest.approx(lost.sum(), abs=2)


@pytest.mark.parametrize("at", [0.1, 0.45, 0.8, 0.93])
def test_a_long_gap_costs_its_cycle_and_says_why(at):
    trial = trial_of(triangle_kpa, curved())
    begin_s = (2 + at) * PERIOD_S
    gap = (trial.time_s > begin_s) & (trial.time_s < begin_s + 0.4)
    numbers = measure_dynamic(dataclasses.replace(trial, angle_deg=np.where(gap, np.nan, trial.angle_deg)))
    assert 3 not in numbers.cycles_used
    refused = numbers.cycles[2]
    assert "no angle or no pressure for 0." in refused.reason
    assert np.isnan([refused.hysteresis_ratio, refused.largest_angle_deg, refused.hysteresis_deg_kpa]).all()
    assert numbers.hysteresis_ratio.value == pytest.approx(0.238, abs=0.0015)


def test_no_cycle_left_no_number():
    trial = trial_of(triangle_kpa, curved())
    gaps = trial.time_s % PERIOD_S < 1
    numbers = measure_dynamic(dataclasses.replace(trial, angle_deg=np.where(gaps, np.nan, trial.angle_deg)))
    assert np.isnan(numbers.hysteresis_ratio.value)
    assert np.isnan(numbers.dynamic_response_deg.value)
    assert all("no angle" in cycle.reason for cycle in numbers.cycles)
    assert "no cycle can be used" in numbers.warnings


def test_one_cycle_has_values_and_no_interval():
    trial = trial_of(triangle_kpa, curved())
    one = trial.time_s < PERIOD_S + 0.2
    names = ("time_s", "angle_deg", "angle_sd_deg", "pressure_kpa", "pressure_rate_kpa_s")
    cut = dataclasses.replace(trial, **{name: getattr(trial, name)[one] for name in names})
    numbers = measure_dynamic(cut)
    assert numbers.cycles_used == (1,)
    assert numbers.hysteresis_ratio.value == pytest.approx(0.238, abs=0.004)
    assert np.isnan(numbers.hysteresis_ratio.interval(0.95)).all()
    assert any("one cycle is used" in warning for warning in numbers.warnings)
    assert any("the video covers" in warning for warning in numbers.warnings)


def test_an_angle_ahead_of_the_pressure_is_said():
    numbers = measure_dynamic(trial_of(sine_kpa, lambda t: 60 * (1 - np.cos(2 * np.pi * t / PERIOD_S + 0.2))))
    assert numbers.hysteresis_ratio.value < 0
    assert any("the loop runs the other way round" in warning for warning in numbers.warnings)


def test_a_vacuum_has_a_loop_but_no_rectangle_to_the_axes():
    trial = trial_of(triangle_kpa, curved())
    below = dataclasses.replace(
        trial, pressure_kpa=trial.pressure_kpa - 50, log_pressure_kpa=trial.log_pressure_kpa - 50
    )
    numbers = measure_dynamic(below)
    assert np.isnan(numbers.hysteresis_ratio.value)
    assert np.isnan([cycle.hysteresis_ratio for cycle in numbers.cycles]).all()
    assert numbers.hysteresis_deg_kpa.value == pytest.approx(0.238 * 118 * PEAK_KPA, rel=0.005)
    assert numbers.hysteresis_ratio_extremes.value == pytest.approx(0.238 * 118 / 114, abs=0.0015)
    assert any("negative pressure" in warning for warning in numbers.warnings)


def test_an_angle_that_never_rises_above_zero_has_no_ratio():
    numbers = measure_dynamic(trial_of(triangle_kpa, lambda t: curved()(t) - 200))
    assert np.isnan(numbers.hysteresis_ratio.value)
    assert numbers.dynamic_response_deg.value == pytest.approx(-82, abs=0.2)
    assert any("not above 0" in warning for warning in numbers.warnings)


def test_an_actuator_that_does_not_move_has_no_ratio():
    numbers = measure_dynamic(trial_of(triangle_kpa, lambda t: 0 * t))
    assert np.isnan(numbers.hysteresis_ratio.value)
    assert abs(numbers.dynamic_response_deg.value) < 0.5


def test_a_coarse_log_does_not_bias_the_largest_angle():
    trial = trial_of(triangle_kpa, curved(), noise_kpa=0.0)
    coarse_s = trial.log_time_s[28::80]  # 5 readings a second, fewer than frames, and none at a turn
    coarse_kpa = triangle_kpa(coarse_s)
    pressure_kpa = np.interp(trial.time_s, coarse_s, coarse_kpa)
    trial = dataclasses.replace(
        trial, log_time_s=coarse_s, log_pressure_kpa=coarse_kpa, pressure_kpa=pressure_kpa
    )
    numbers = measure_dynamic(trial)
    assert coarse_kpa.max() < PEAK_KPA - 1
    assert_within(numbers.dynamic_response_deg, 118, 1.5)


def test_an_actuator_that_bends_the_other_way_has_its_turning_angles():
    numbers = measure_dynamic(trial_of(triangle_kpa, lambda t: -curved()(t)))
    assert numbers.dynamic_response_deg.value == pytest.approx(-118, abs=0.2)
    assert numbers.residual_angle_deg.value == pytest.approx(-4, abs=0.2)


def test_frames_without_a_single_angle():
    trial = trial_of(triangle_kpa, curved())
    numbers = measure_dynamic(dataclasses.replace(trial, angle_deg=np.full(trial.time_s.size, np.nan)))
    assert np.isnan(numbers.hysteresis_ratio.value)
    assert "no frame has both an angle and a pressure" in numbers.warnings
