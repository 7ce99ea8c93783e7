"""From files to numbers: a simulated study whose truth is the paper's two tables of results (and the two others)."""

import numpy as np
import pytest

from bendtrack.tracker.study.analysis import analyse_study
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial_data import load_trials
from bendtrack.tracker.synthetic.study import simulate_study

PAPER = ("original", "mid-width smaller")


@pytest.fixture(scope="module")
def paper(tmp_path_factory):
    """The two designs of the paper's tables, all their trials: results, truth, trials."""
    made = simulate_study(tmp_path_factory.mktemp("paper"), seed=0, designs=PAPER)
    study = read_study(made.study_path)
    trials = list(load_trials(study))
    return analyse_study(trials, baseline=study.baseline), made.truth, trials


def test_hysteresis_ratio_at_one_angle_is_the_papers_table(paper):
    results, truth, _ = paper
    table = results.constant_angle
    printed = []
    for row in truth["constant_angle"]:
        same = (table.frequency_hz == row["frequency_hz"]) & (table.angle_deg == row["angle_deg"])
        (found,) = table[same & (table.design == row["design"])].to_dict("records")
        assert found["baseline_ratio"] == pytest.approx(row["ratio_baseline"], abs=0.002)
        assert found["design_ratio"] == pytest.approx(row["ratio"], abs=0.002)
        assert found["improvement"] == pytest.approx(row["improvement"], abs=0.005)
        assert found["improvement_low"] < row["improvement"] < found["improvement_high"]
        printed.append((row["frequency_hz"], row["angle_deg"], row["ratio_baseline"], row["ratio"]))
    assert printed == [(0.0625, 140.0, 0.279, 0.219), (0.25, 85.0, 0.303, 0.238)]


def test_dynamic_response_is_the_papers_table(paper):
    results, truth, _ = paper
    table = results.improvements[results.improvements.metric == "dynamic_response_deg"]
    percent = []
    for row in truth["dynamic_response"]:
        same = (table.frequency_hz == row["frequency_hz"]) & (table.pressure_pp_kpa == row["pressure_pp_kpa"])
        (found,) = table[same & (table.design == row["design"])].to_dict("records")
        assert found["baseline_value"] == pytest.approx(row["baseline_deg"], abs=0.2)
        assert found["design_value"] == pytest.approx(row["angle_deg"], abs=0.2)
        assert found["improvement"] == pytest.approx(row["improvement"], abs=0.01)
        percent.append(round(100 * row["improvement"]))
    assert percent == [105, 104, 60, 71, 112, 85]


def test_where_a_design_does_not_reach_there_is_no_comparison(paper):
    results, *_ = paper
    table = results.improvements
    at_55 = table[(table.metric == "dynamic_response_deg") & (table.pressure_pp_kpa == 55)]
    assert len(at_55) == 2
    assert at_55.improvement.isna().all()
    assert at_55.refused.str.contains("no trial at 55 kPa").all()
    slow = results.constant_angle[results.constant_angle.frequency_hz == 0.0625]
    assert slow.angle_deg.min() >= 93.28
    assert slow.angle_deg.max() <= 141.80


def test_every_trial_and_its_intervals(paper):
    results, truth, _ = paper
    dynamic = results.dynamic.set_index("trial")
    names = [name for name, trial in truth["trials"].items() if trial["kind"] == "dynamic"]
    assert list(dynamic.index) == names
    held = []
    for name in names:
        found, true = dynamic.loc[name], truth["trials"][name]
        assert found.period_s == pytest.approx(true["period_s"], rel=1e-3)
        assert found.largest_pressure_kpa == pytest.approx(true["pressure_max_kpa"], abs=0.1)
        assert found.residual_angle_deg == pytest.approx(true["residual_deg"], abs=0.4)
        assert found.hysteresis_deg_kpa == pytest.approx(true["area_deg_kpa"], rel=0.01)
        assert found.mid_width_deg == pytest.approx(true["mid_pressure_width_deg"], abs=0.3)
        assert found.hysteresis_ratio_extremes == pytest.approx(true["hysteresis_ratio_extremes"], abs=0.004)
        per_frame = true["ratio_per_second_shift"] / 30
        assert found.ratio_per_frame_shift == pytest.approx(per_frame, rel=0.03)
        for column, key in (
            ("hysteresis_ratio", "hysteresis_ratio"),
            ("dynamic_response_deg", "angle_max_deg"),
            ("hysteresis_deg_kpa", "area_deg_kpa"),
        ):
            held.append(found[f"{column}_low"] <= true[key] <= found[f"{column}_high"])
    assert np.mean(held) > 0.85  # 42 intervals; how often they hold the truth is test_coverage's


def test_the_model_curve_and_the_control_are_the_papers_tables(paper):
    results, truth, _ = paper
    static = results.static.set_index("trial")
    found = static.loc["mid-width-smaller_static"]
    assert found.rmse_deg == pytest.approx(9.99, abs=0.05)
    assert found.nrmse == pytest.approx(0.05, abs=0.0005)
    assert np.isnan(static.loc["original_static"].rmse_deg)  # it has no model curve
    stairs = results.static_steps[results.static_steps.trial == "original_static"]
    np.testing.assert_allclose(stairs.pressure_kpa, np.arange(0, 51, 5), atol=0.1)
    true = truth["trials"]["original_static"]["steady_deg"]
    np.testing.assert_allclose(stairs.angle_deg, true, atol=0.25)
    control = results.control.set_index("trial")
    for name, trial in truth["trials"].items():
        assert control.loc[name].rmse_kpa == pytest.approx(trial["control_rmse_kpa"], rel=0.02)
        assert control.loc[name].nrmse == pytest.approx(trial["control_nrmse"], rel=0.02)
    printed = [
        (f"{row.rmse_kpa:.1f} kPa", f"{row.nrmse:.1%}")
        for row in control.loc[
            ["original_static", "original_0.0625Hz_55kPa", "original_0.25Hz_55kPa"]
        ].itertuples()
    ]
    assert printed == [("0.4 kPa", "0.9%"), ("0.4 kPa", "0.7%"), ("0.5 kPa", "1.0%")]


def test_the_clocks_are_brought_together(paper):
    _, truth, trials = paper
    for trial in trials:
        off_s = trial.shift.delay_s - truth["trials"][trial.name]["delay_s"]
        if trial.shift.method == "given delay":
            assert abs(off_s) < 1e-5
        else:  # the first step of a staircase, which begins to bend the actuator slowly
            assert abs(off_s) < 2.5 * trial.shift.sd_s
            assert trial.shift.sd_s < 0.2
