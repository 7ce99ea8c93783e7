"""A small study of known answers, analysed: the tables, their columns, and what is wrong use."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.study.analysis import analyse_study
from bendtrack.tracker.study.trial import Kind, Shift, TrialData
from bendtrack.tracker.synthetic.response import HystereticResponse, triangle_kpa

CYCLES, FREQUENCY_HZ = 5, 0.25
# (design, peak-to-peak kPa): largest angle, ratio.
TRUTH = {
    ("original", 40.0): (40.0, 0.30),
    ("original", 50.0): (70.0, 0.29),
    ("mid-width smaller", 40.0): (58.0, 0.24),
    ("mid-width smaller", 50.0): (110.0, 0.22),
}


def dynamic_trial(design, pressure_kpa, largest_deg, ratio, seed):
    rng = np.random.default_rng(seed)
    response = HystereticResponse(pressure_kpa, 2.0, largest_deg, ratio)
    fine_s = np.arange(0, CYCLES / FREQUENCY_HZ, 1 / 3000)
    fine_deg = response.angle_deg(triangle_kpa(fine_s, pressure_kpa, FREQUENCY_HZ))
    log_s = np.arange(0, CYCLES / FREQUENCY_HZ, 1 / 400)
    time_s = np.arange(0.01, CYCLES / FREQUENCY_HZ - 0.02, 1 / 30)
    reference = triangle_kpa(log_s, pressure_kpa, FREQUENCY_HZ)
    pressure = triangle_kpa(time_s, pressure_kpa, FREQUENCY_HZ)
    rising = time_s * FREQUENCY_HZ % 1 < 0.5
    return TrialData(
        name=f"{design} {pressure_kpa:g} kPa",
        design=design,
        kind=Kind.DYNAMIC,
        frequency_hz=FREQUENCY_HZ,
        pressure_pp_kpa=pressure_kpa,
        time_s=time_s,
        angle_deg=np.interp(time_s, fine_s, fine_deg) + 0.3 * rng.standard_normal(time_s.size),
        angle_sd_deg=np.full(time_s.size, 0.3),
        pressure_kpa=pressure,
        pressure_rate_kpa_s=np.where(rising, 1, -1) * 2 * pressure_kpa * FREQUENCY_HZ,
        log_time_s=log_s,
        log_pressure_kpa=reference + 0.1 * rng.standard_normal(log_s.size),
        log_reference_kpa=reference,
        shift=Shift(0.0, 0.01, "shared clock"),
        warnings=("the log's header names no unit",) if pressure_kpa == 40 else (),
    )


def static_trial():
    time_s = np.arange(0, 44, 1 / 30)
    pressure = 10.0 * np.minimum(time_s // 8, 5)
    return TrialData(
        name="stairs",
        design="original",
        kind=Kind.STATIC,
        frequency_hz=None,
        pressure_pp_kpa=None,
        time_s=time_s,
        angle_deg=2 * pressure + 0.1 * np.random.default_rng(0).standard_normal(time_s.size),
        angle_sd_deg=np.full(time_s.size, 0.1),
        pressure_kpa=pressure,
        pressure_rate_kpa_s=np.zeros(time_s.size),
        log_time_s=time_s,
        log_pressure_kpa=pressure,
        shift=Shift(0.0, 0.01, "shared clock"),
        model_pressure_kpa=np.array([0.0, 60.0]),
        model_angle_deg=np.array([3.0, 123.0]),
    )


@pytest.fixture(scope="module")
def trials():
    dynamic = [
        dynamic_trial(design, pressure, *true, seed)
        for seed, ((design, pressure), true) in enumerate(TRUTH.items())
    ]
    return [*dynamic, static_trial()]


@pytest.fixture(scope="module")
def results(trials):
    return analyse_study(iter(trials), baseline="original")


def test_one_row_a_trial_with_its_truth_in_its_intervals(results):
    assert len(results.dynamic) == 4
    for _, row in results.dynamic.iterrows():
        largest, ratio = TRUTH[row.design, row.pressure_pp_kpa]
        assert row.dynamic_response_deg == pytest.approx(largest, abs=0.3)
        assert row.hysteresis_ratio == pytest.approx(ratio, abs=0.003)
        assert row.hysteresis_ratio_low < ratio < row.hysteresis_ratio_high
        assert row.largest_pressure_kpa == pytest.approx(row.pressure_pp_kpa, abs=0.1)
        assert row.period_s == pytest.approx(4, abs=0.01)
        assert row.shift_method == "shared clock"
        assert row.shift_sd_s == 0.01


def test_one_row_a_cycle_and_its_loop(results):
    assert len(results.cycles) == 4 * CYCLES
    assert results.cycles.used.all()
    assert set(results.cycles.reason) == {""}
    for name, loops in results.loops.items():
        assert len(loops) == CYCLES
        own = results.cycles[results.cycles.trial == name]
        for loop, (_, cycle) in zip(loops, own.iterrows(), strict=True):
            assert loop.shape == (cycle.frames + 2, 2)
            assert loop[:, 1].max() == pytest.approx(cycle.largest_angle_deg, abs=6)


def test_constant_angle_against_the_baseline(results):
    row = results.constant_angle.set_index("angle_deg").loc[60.0]
    old, new = 0.30 - 0.01 * 20 / 30, 0.24 - 0.02 * 2 / 52  # straight lines between TRUTH's trials
    assert row.baseline_ratio == pytest.approx(old, abs=0.003)
    assert row.design_ratio == pytest.approx(new, abs=0.003)
    assert row.improvement == pytest.approx((old - new) / old, abs=0.012)
    assert row.improvement_low < (old - new) / old < row.improvement_high
    assert row.refused == ""
    assert list(results.constant_angle.angle_deg)[:2] == [
        60,
        65,
    ]  # and 70, if noise lets the original reach it


def test_angles_that_were_asked_for(trials):
    asked = analyse_study(trials, baseline="original", angles_deg=[65.0, 100.0])
    table = asked.constant_angle.set_index("angle_deg")
    assert list(table.index) == [65.0, 100.0]
    assert table.refused[65.0] == ""
    assert "original: its trials reach 40." in table.refused[100.0]
    assert np.isnan(table.improvement[100.0])
    assert set(asked.ranking.angle_deg.dropna()) == {65.0, 100.0}


def test_improvement_of_the_dynamic_response(results):
    table = results.improvements
    found = table[table.metric == "dynamic_response_deg"].set_index("pressure_pp_kpa")
    assert found.improvement[40.0] == pytest.approx(18 / 40, abs=0.015)
    assert found.improvement[50.0] == pytest.approx(4 / 7, abs=0.01)
    assert list(found.baseline) == ["original", "original"]


def test_ranking_and_pairs(results):
    best = results.ranking[results.ranking["rank"] == 1]
    assert set(best.design) == {"mid-width smaller"}
    assert set(best.metric) == {"dynamic_response_deg", "hysteresis_ratio"}
    pair = results.pairwise[results.pairwise.pressure_pp_kpa == 50].iloc[0]
    assert (pair.design_a, pair.design_b) == ("original", "mid-width smaller")
    assert pair.difference == pytest.approx(-40, abs=0.5)
    assert pair.differs
    assert pair.p_holm < 1e-6


def test_static_and_control(results):
    assert len(results.static_steps) == 6
    row = results.static.iloc[0]
    # The model is 3 deg above the angle at every pressure.
    assert row.rmse_deg == pytest.approx(3, abs=0.05)
    assert row.nrmse == pytest.approx(0.03, abs=0.001)
    assert len(results.control) == 4
    np.testing.assert_allclose(results.control.rmse_kpa, 0.1, rtol=0.05)


def test_warnings_of_reading_and_of_analysis_stand_together(trials):
    half = trials[1].time_s < 10
    angle = np.where(half, trials[1].angle_deg, np.nan)
    found = analyse_study(
        [trials[0], dataclasses.replace(trials[1], angle_deg=angle), trials[2]], baseline=None
    ).warnings
    assert list(found.columns) == ["trial", "warning"]
    assert ("original 40 kPa", "the log's header names no unit") in list(
        found.itertuples(index=False, name=None)
    )
    assert found[found.trial == "original 50 kPa"].warning.str.contains("cycle 4 is not used").any()


def test_a_wave_unlike_the_study_files_is_said(trials):
    wrong = dataclasses.replace(trials[0], frequency_hz=0.0625, pressure_pp_kpa=55.0)
    warnings = " | ".join(analyse_study([wrong], baseline=None).warnings.warning)
    assert "the frequency is 0.25 Hz, the study file says 0.0625 Hz" in warnings
    assert "kPa, the study file says 55 kPa" in warnings


def test_a_trial_without_nominal_values_is_grouped_by_what_was_measured(trials):
    unnamed = [dataclasses.replace(t, frequency_hz=None, pressure_pp_kpa=None) for t in trials[:4]]
    found = analyse_study(unnamed, baseline="original")
    assert set(found.constant_angle.frequency_hz) == {0.25}
    assert len(found.constant_angle) > 0
    assert found.dynamic.hysteresis_ratio.notna().all()


def test_tables_have_their_columns_when_they_are_empty(trials, results):
    only_static = analyse_study([trials[-1]], baseline=None)
    for name in ("cycles", "dynamic", "control", "constant_angle", "improvements", "ranking", "pairwise"):
        table = getattr(only_static, name)
        assert table.empty
        assert list(table.columns) == list(getattr(results, name).columns), name


def test_the_same_trials_give_the_same_numbers(trials, results):
    again = analyse_study(trials, baseline="original")
    for name in ("cycles", "dynamic", "static", "control", "constant_angle", "ranking", "pairwise"):
        pd.testing.assert_frame_equal(getattr(again, name), getattr(results, name))


def test_a_higher_confidence_widens_every_interval(trials, results):
    wider = analyse_study(trials, baseline="original", confidence=0.99)
    for name in ("dynamic_response_deg", "hysteresis_ratio", "mid_width_deg"):
        usual = results.dynamic[f"{name}_high"] - results.dynamic[f"{name}_low"]
        assert (wider.dynamic[f"{name}_high"] - wider.dynamic[f"{name}_low"] > usual).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"baseline": "orignal"}, "expected a baseline among the designs (original, mid-width smaller)"),
        ({"confidence": 95}, "expected a confidence between 0 and 1, got 95"),
    ],
)
def test_wrong_use_is_said_in_a_line(trials, changed, message):
    with pytest.raises(BendtrackError) as caught:
        analyse_study(trials, **{"baseline": None, **changed})
    assert message in str(caught.value)


def test_no_trial_and_two_of_one_name_are_refused(trials):
    with pytest.raises(BendtrackError, match="expected at least one trial"):
        analyse_study([], baseline=None)
    with pytest.raises(BendtrackError, match="got two called 'stairs'"):
        analyse_study([trials[-1], trials[-1]], baseline=None)
