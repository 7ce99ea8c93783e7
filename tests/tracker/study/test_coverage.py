"""How often 95 % intervals hold the truth, when the clocks are wrong by as much as the study file says they may be."""

from functools import cache
from itertools import islice

import numpy as np
import pandas as pd
import pytest

from bendtrack.tracker.study.analysis import analyse_study
from bendtrack.tracker.study.resampling import pressure_at_frames
from bendtrack.tracker.study.trial import Kind, Shift, TrialData
from bendtrack.tracker.synthetic import study_plan
from bendtrack.tracker.synthetic.cycling import CyclingTrial
from bendtrack.tracker.synthetic.recording import ANGLE_NOISE_DEG, FRAME_RATE, record

SHIFT_SD_S = 0.02
PLAN = [(design, hz, *trial) for (design, hz), trials in study_plan.DYNAMIC.items() for trial in trials]


def trial_data(name, design, trial, recording, given_delay_s, sd_s=SHIFT_SD_S):
    """What `load_trial` makes of the recording's files, were they written."""
    log_time_s = recording.log_time_s + given_delay_s
    frames = recording.frame_time_s
    pressure_kpa, rate = pressure_at_frames(frames, log_time_s, recording.log_kpa)
    return TrialData(
        name=name,
        design=design,
        kind=Kind.DYNAMIC,
        frequency_hz=trial.frequency_hz,
        pressure_pp_kpa=trial.peak_kpa,
        time_s=frames,
        angle_deg=recording.angle_deg,
        angle_sd_deg=np.full(len(frames), ANGLE_NOISE_DEG),
        pressure_kpa=pressure_kpa,
        pressure_rate_kpa_s=rate,
        log_time_s=log_time_s,
        log_pressure_kpa=recording.log_kpa,
        shift=Shift(given_delay_s, sd_s, "given delay"),
    )


def simulated(count, seed):
    """Trials of the plan's angles and ratios, cycles that differ, delays wrong by draws from their uncertainty."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        design, frequency_hz, peak_kpa, angle_deg, ratio = PLAN[rng.integers(len(PLAN))]
        trial = CyclingTrial(
            frequency_hz,
            float(peak_kpa),
            angle_deg,
            ratio,
            residual_deg=study_plan.RESIDUAL[frequency_hz] * angle_deg,
            cycles=6,
            lag_s=study_plan.LAG_S[frequency_hz],
            peak_sd_deg=0.004 * angle_deg,
            ratio_sd=0.002,
            seed=seed + index,
        )
        delay_s = -rng.uniform(0, 0.8)
        recording = record(trial, seed=seed + index, delay_s=delay_s)
        given_s = delay_s + rng.normal(0, SHIFT_SD_S)
        yield trial, trial_data(f"trial {index}", design, trial, recording, given_s)


FEW, MANY = 40, 200


@cache
def analysed(first, last):
    """The truth and the dynamic table of the simulated trials [first, last)."""
    made = list(islice(simulated(last, seed=1000), first, None))
    truth = pd.DataFrame([trial.truth() for trial, _ in made])
    return truth, analyse_study((data for _, data in made), baseline=None).dynamic


@pytest.mark.parametrize("count", [pytest.param(FEW), pytest.param(MANY, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_as_often_as_they_say(count):
    # Trials are analysed one by one, so the few are the first of the many.
    parts = [analysed(0, FEW)] if count == FEW else [analysed(0, FEW), analysed(FEW, MANY)]
    truth, dynamic = (pd.concat(tables, ignore_index=True) for tables in zip(*parts, strict=True))
    assert len(dynamic) == count
    low, high = (0.90, 0.98) if count == 200 else (0.85, 1.0)
    for column, key in (
        ("hysteresis_ratio", "hysteresis_ratio"),
        ("dynamic_response_deg", "angle_max_deg"),
        ("hysteresis_deg_kpa", "area_deg_kpa"),
    ):
        true = truth[key]
        held = (dynamic[f"{column}_low"] <= true) & (true <= dynamic[f"{column}_high"])
        assert low <= held.mean() <= high, f"{column}: {held.mean():.3f}"


@pytest.mark.parametrize("frequency_hz", [0.0625, 0.25])
@pytest.mark.parametrize("frames", [-1, 1])
def test_a_shift_of_one_frame_moves_the_ratio_by_what_was_reported(frequency_hz, frames):
    trial = CyclingTrial(frequency_hz, 50.0, 118.06, 0.229, residual_deg=4.0, cycles=6)
    recording = record(trial, seed=3, delay_s=-0.4)
    shift_s = frames / FRAME_RATE
    right, wrong = (
        analyse_study([trial_data("one", "ours", trial, recording, delay)], baseline=None).dynamic.iloc[0]
        for delay in (-0.4, -0.4 - shift_s)
    )
    moved = wrong.hysteresis_ratio - right.hysteresis_ratio
    # The log's clock runs ahead: pressure(t + shift) is set against angle(t), and the loop grows.
    assert moved == pytest.approx(frames * right.ratio_per_frame_shift, rel=0.03)
    assert moved == pytest.approx(trial.shifted_ratio(shift_s) - 0.229, abs=0.0007)
    # A wrong clock does not touch the largest angle, and the interval knows what it may have done to the ratio.
    assert wrong.dynamic_response_deg == pytest.approx(right.dynamic_response_deg, abs=0.15)
    assert wrong.hysteresis_ratio_low < 0.229 < wrong.hysteresis_ratio_high
    assert (
        right.hysteresis_ratio_sd >= SHIFT_SD_S / (1 / FRAME_RATE) * abs(right.ratio_per_frame_shift) * 0.99
    )


def test_half_a_frame_is_the_least_that_a_clock_is_unsure():
    trial = CyclingTrial(0.25, 50.0, 118.06, 0.229, residual_deg=4.0, cycles=6)
    recording = record(trial, seed=3)
    exact = analyse_study([trial_data("one", "ours", trial, recording, 0.0, sd_s=0.0)], baseline=None)
    row = exact.dynamic.iloc[0]
    assert row.hysteresis_ratio_sd >= 0.5 / 3**0.5 * row.ratio_per_frame_shift * 0.99
