"""What goes wrong in a lab: each case ends in a clear message or a named warning, and never in a wrong number.

A trial with exact truth is written as a user's files, one thing is spoilt, and the whole way is gone: study file,
log and angle table read, analysed. A number that comes out is right (to noise) or NaN, with a warning.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from bendtrack.tracker.errors import PressureLogError, ResultsError, StudyError
from bendtrack.tracker.results import write_results
from bendtrack.tracker.study.analysis import analyse_study
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial_data import load_trials
from bendtrack.tracker.synthetic.cycling import CyclingTrial
from bendtrack.tracker.synthetic.log_files import write_csv_log
from bendtrack.tracker.synthetic.recording import record
from bendtrack.tracker.synthetic.stairs import StaircaseTrial

PERIOD_S = 4.0
TRIAL = CyclingTrial(0.25, 50.0, 118.06, 0.229, residual_deg=4.0, cycles=6, first_differs=False)
RECORDING = record(TRIAL, seed=8)
# When the first cycle begins, on the clock that log and video share here.
BEGIN_S = TRIAL.rest_s + TRIAL.lag_s


def columns(recording):
    return {"time_s": recording.log_time_s, "pressure_kpa": recording.log_kpa}


def outcome(folder, recording=RECORDING, log=None, nominal=True, extra=""):
    """The trial's row and its warnings, or the error's message."""
    write_results(recording.angle_table("one"), folder, "one")
    write_csv_log(folder / "log.csv", columns(recording) if log is None else log)
    said = "frequency_hz = 0.25\npressure_pp_kpa = 50.0" if nominal else ""
    (folder / "study.toml").write_text(
        f'[[trials]]\ndesign = "ours"\nkind = "dynamic"\nangles = "one.csv"\nlog = "log.csv"\n{said}\n{extra}'
    )
    results = analyse_study(load_trials(read_study(folder / "study.toml")), baseline=None)
    (row,) = results.dynamic.to_dict("records")
    return row, " | ".join(results.warnings.warning), results


def assert_right(row):
    """Every number of the paper, to what six cycles with noise allow."""
    assert row["hysteresis_ratio"] == pytest.approx(0.229, abs=0.006)
    assert row["dynamic_response_deg"] == pytest.approx(118.06, abs=0.6)
    assert row["hysteresis_deg_kpa"] == pytest.approx(0.229 * 50 * 118.06, rel=0.02)
    assert row["largest_pressure_kpa"] == pytest.approx(50.0, abs=0.15)


def assert_no_number(row):
    for name in ("hysteresis_ratio", "dynamic_response_deg", "hysteresis_deg_kpa", "mid_width_deg"):
        assert np.isnan(row[name]), name


def cut(recording, begin_s, end_s):
    """Log and video from one time to another; the clocks stay as they are but for the video's zero."""
    in_log = (recording.log_time_s >= begin_s) & (recording.log_time_s <= end_s)
    in_video = (recording.frame_time_s >= begin_s) & (recording.frame_time_s <= end_s)
    first_s = recording.frame_time_s[in_video][0]
    return replace(
        recording,
        log_time_s=recording.log_time_s[in_log] - first_s,
        log_kpa=recording.log_kpa[in_log],
        reference_kpa=recording.reference_kpa[in_log],
        frame_time_s=recording.frame_time_s[in_video] - first_s,
        angle_deg=recording.angle_deg[in_video],
    )


def test_nothing_wrong(tmp_path):
    row, warnings, _ = outcome(tmp_path)
    assert_right(row)
    assert row["cycles_used"] == (1, 2, 3, 4, 5, 6)
    assert warnings == ""


def test_a_first_cycle_that_differs_is_left_out_and_said(tmp_path):
    recording = record(replace(TRIAL, first_differs=True), seed=8)
    row, warnings, _ = outcome(tmp_path, recording)
    assert_right(row)
    assert row["cycles_used"] == (2, 3, 4, 5, 6)
    assert "the first cycle differs from the others" in warnings


def test_incomplete_first_and_last_cycles_are_named_and_left_out(tmp_path):
    recording = cut(RECORDING, BEGIN_S + 1.2 * PERIOD_S, BEGIN_S + 5.7 * PERIOD_S)
    row, warnings, results = outcome(tmp_path, recording)
    assert_right(row)
    assert "first cycle is incomplete" in warnings
    assert "last cycle is incomplete" in warnings
    assert len(results.cycles) == 3


@pytest.mark.parametrize(("begin", "end"), [(0.0, 0.5), (1.5, 2.0), (1.5, 2.5), (1.25, 1.9)])
def test_half_cycles_are_no_cycle(tmp_path, begin, end):
    recording = cut(RECORDING, BEGIN_S + begin * PERIOD_S, BEGIN_S + end * PERIOD_S)
    row, warnings, _ = outcome(tmp_path, recording)
    assert_no_number(row)
    assert "no complete cycle" in warnings


def test_an_angle_that_drifts_is_said(tmp_path):
    drift = 1.5 * (RECORDING.frame_time_s - BEGIN_S) / PERIOD_S
    row, warnings, _ = outcome(tmp_path, replace(RECORDING, angle_deg=RECORDING.angle_deg + drift))
    assert "the largest angle drifts by +1." in warnings
    # The largest of the trial is the last cycle's, half a cycle before the end of the sixth.
    assert row["dynamic_response_deg"] == pytest.approx(118.06 + 1.5 * 5.5, abs=0.9)
    assert row["largest_angle_drift_deg"] == pytest.approx(1.5, abs=0.25)


def test_a_sensor_that_drifts_is_said(tmp_path):
    drift = 0.7 * RECORDING.log_time_s / PERIOD_S
    _, warnings, _ = outcome(tmp_path, replace(RECORDING, log_kpa=RECORDING.log_kpa + drift))
    assert "pressure drift" in warnings


@pytest.mark.parametrize("end_kpa", [42.0, 48.0, 49.3, 49.7])
def test_a_saturated_sensor_gives_no_number(tmp_path, end_kpa):
    row, warnings, results = outcome(
        tmp_path, replace(RECORDING, log_kpa=np.minimum(RECORDING.log_kpa, end_kpa))
    )
    assert "saturation: the upper end" in warnings
    assert "cycle 1 is not used: the pressure sensor was saturated in it" in warnings
    assert_no_number(row)
    assert results.cycles.empty or results.cycles.hysteresis_ratio.isna().all()


def test_stairs_beyond_the_sensors_range_are_left_out(tmp_path):
    stairs = StaircaseTrial(182.0)
    recording = record(stairs, seed=8)
    write_results(recording.angle_table("one"), tmp_path, "one")
    write_csv_log(
        tmp_path / "log.csv", {**columns(recording), "pressure_kpa": np.minimum(recording.log_kpa, 42.0)}
    )
    (tmp_path / "study.toml").write_text(
        '[[trials]]\ndesign = "ours"\nkind = "static"\nangles = "one.csv"\nlog = "log.csv"\n'
    )
    results = analyse_study(load_trials(read_study(tmp_path / "study.toml")), baseline=None)
    assert "saturation: the upper end, 42 kPa" in " | ".join(results.warnings.warning)
    np.testing.assert_allclose(results.static_steps.pressure_kpa, np.arange(0, 41, 5), atol=0.1)
    np.testing.assert_allclose(results.static_steps.angle_deg, stairs.steady_deg[:9], atol=0.3)


def test_an_angle_that_leaves_the_picture_gives_no_largest_angle(tmp_path):
    angle = np.where(RECORDING.angle_deg > 100, np.nan, RECORDING.angle_deg)
    row, warnings, _ = outcome(tmp_path, replace(RECORDING, angle_deg=angle))
    assert_no_number(row)
    assert "no angle or no pressure for" in warnings


def test_a_log_that_ends_before_the_video(tmp_path):
    kept = RECORDING.log_time_s < BEGIN_S + 4.3 * PERIOD_S
    row, warnings, results = outcome(tmp_path, log={name: v[kept] for name, v in columns(RECORDING).items()})
    assert_right(row)
    assert "log shorter than video" in warnings
    assert len(results.cycles) == 4


def test_a_video_that_ends_before_the_log(tmp_path):
    kept = RECORDING.frame_time_s < BEGIN_S + 4.3 * PERIOD_S
    recording = replace(
        RECORDING, frame_time_s=RECORDING.frame_time_s[kept], angle_deg=RECORDING.angle_deg[kept]
    )
    row, warnings, _ = outcome(tmp_path, recording)
    assert_right(row)
    assert row["cycles_used"] in ((1, 2, 3, 4), (2, 3, 4))
    assert "cycle 5 is not used: the video covers" in warnings


def test_a_log_and_a_video_of_different_times(tmp_path):
    log = {**columns(RECORDING), "time_s": RECORDING.log_time_s + 1000}
    with pytest.raises(StudyError, match="no moment in common"):
        outcome(tmp_path, log=log)


def test_a_log_in_reverse_is_put_in_order(tmp_path):
    row, warnings, _ = outcome(tmp_path, log={name: v[::-1] for name, v in columns(RECORDING).items()})
    assert_right(row)
    assert "runs backward in time" in warnings


def test_angles_in_reverse_show_a_loop_that_runs_the_wrong_way(tmp_path):
    # Nothing in the files shows it: times rise, values are plausible. The loop does.
    row, warnings, _ = outcome(tmp_path, replace(RECORDING, angle_deg=RECORDING.angle_deg[::-1]))
    assert "the loop runs the other way round" in warnings
    assert row["hysteresis_ratio"] < 0


@pytest.mark.parametrize("at", [0.25, 0.5, 0.75, 1.0])
def test_a_gap_without_angles_costs_its_cycle_only(tmp_path, at):
    middle_s = BEGIN_S + (2 + at) * PERIOD_S
    angle = np.where(np.abs(RECORDING.frame_time_s - middle_s) < 0.5, np.nan, RECORDING.angle_deg)
    row, warnings, results = outcome(tmp_path, replace(RECORDING, angle_deg=angle))
    assert_right(row)
    assert "cycle 3 is not used: no angle or no pressure for" in warnings
    assert 3 not in row["cycles_used"]
    third = results.cycles[results.cycles.number == 3].iloc[0]
    assert np.isnan(third.hysteresis_ratio)
    assert np.isnan(third.largest_angle_deg)


def test_a_gap_without_pressure_costs_its_cycle_only(tmp_path):
    lost = np.abs(RECORDING.log_time_s - BEGIN_S - 2.4 * PERIOD_S) < 0.4
    log = {**columns(RECORDING), "pressure_kpa": np.where(lost, np.nan, RECORDING.log_kpa)}
    row, warnings, _ = outcome(tmp_path, log=log)
    assert_right(row)
    assert "gap" in warnings
    assert 3 not in row["cycles_used"]


def test_no_angle_at_all(tmp_path):
    recording = replace(RECORDING, angle_deg=np.full_like(RECORDING.angle_deg, np.nan))
    with pytest.raises(ResultsError, match="expected angles, got 0 rows with one"):
        outcome(tmp_path, recording)


def test_constant_pressure(tmp_path):
    rng = np.random.default_rng(0)
    log = {**columns(RECORDING), "pressure_kpa": 20 + 0.05 * rng.standard_normal(len(RECORDING.log_kpa))}
    row, warnings, _ = outcome(tmp_path, log=log, nominal=False)
    assert_no_number(row)
    assert "constant pressure" in warnings


def test_a_vacuum_has_no_rectangle_to_the_axes(tmp_path):
    # The same loop, 50 kPa lower: area and largest angle hold, the paper's ratio has no meaning.
    row, warnings, _ = outcome(tmp_path, replace(RECORDING, log_kpa=RECORDING.log_kpa - 50))
    assert "negative pressure" in warnings
    assert np.isnan(row["hysteresis_ratio"])
    assert row["hysteresis_deg_kpa"] == pytest.approx(0.229 * 50 * 118.06, rel=0.02)
    assert row["dynamic_response_deg"] == pytest.approx(118.06, abs=0.6)
    assert row["hysteresis_ratio_extremes"] == pytest.approx(0.229 * 118.06 / 114.06, abs=0.006)


def test_a_pressure_with_the_wrong_sign(tmp_path):
    row, warnings, _ = outcome(tmp_path, replace(RECORDING, log_kpa=-RECORDING.log_kpa))
    assert "negative pressure" in warnings
    assert np.isnan(row["hysteresis_ratio"])


def test_two_columns_called_pressure(tmp_path):
    log = {**columns(RECORDING), "pressure_2_kpa": RECORDING.log_kpa}
    with pytest.raises(PressureLogError, match="expected one column of pressure, got 2") as caught:
        outcome(tmp_path, log=log)
    assert "pressure_column" in str(caught.value)
    row, *_ = outcome(tmp_path, log=log, extra="log_format = { pressure_column = 2 }\n")
    assert_right(row)


def test_two_columns_of_the_very_same_name(tmp_path):
    write_results(RECORDING.angle_table("one"), tmp_path, "one")
    rows = np.column_stack([*columns(RECORDING).values(), RECORDING.log_kpa])
    np.savetxt(
        tmp_path / "log.csv", rows, "%.4f", ",", header="time_s,pressure_kpa,pressure_kpa", comments=""
    )
    (tmp_path / "study.toml").write_text(
        '[[trials]]\ndesign = "ours"\nkind = "dynamic"\nangles = "one.csv"\nlog = "log.csv"\n'
    )
    with pytest.raises(PressureLogError, match="expected one column of pressure, got 2"):
        list(load_trials(read_study(tmp_path / "study.toml")))


@pytest.mark.parametrize(
    ("in_kpa", "unit"), [(6.894757, "psi"), (0.1, "mbar"), (100.0, "bar"), (0.001, "Pa")]
)
def test_values_in_another_unit_than_the_header_says(tmp_path, in_kpa, unit):
    log = {**columns(RECORDING), "pressure_kpa": RECORDING.log_kpa / in_kpa}
    with pytest.raises(StudyError, match="looks as if it were in"):
        outcome(tmp_path, log=log)


def test_units_that_nobody_gave(tmp_path):
    log = {"time_s": RECORDING.log_time_s, "pressure": RECORDING.log_kpa}
    with pytest.raises(PressureLogError, match="names no unit; give pressure_unit"):
        outcome(tmp_path, log=log)


def test_right_units_other_than_kpa(tmp_path):
    log = {"t [ms]": 1000 * RECORDING.log_time_s, "p [mbar]": 10 * RECORDING.log_kpa}
    row, *_ = outcome(tmp_path, log=log)
    assert_right(row)


def test_times_in_milliseconds_called_seconds(tmp_path):
    log = {**columns(RECORDING), "time_s": 1000 * RECORDING.log_time_s}
    row, warnings, _ = outcome(tmp_path, log=log)
    assert_no_number(row)
    assert "cycle 1 is not used: the video covers" in warnings
    assert re.search(r"the frequency is 0\.000\d+ Hz, the study file says 0\.25 Hz", warnings)


def test_times_in_kiloseconds_called_seconds(tmp_path):
    log = {**columns(RECORDING), "time_s": RECORDING.log_time_s / 1000}
    row, warnings, _ = outcome(tmp_path, log=log)
    assert_no_number(row)
    assert "log shorter than video" in warnings


def test_a_wrong_frequency_in_the_study_file_is_said(tmp_path):
    row, warnings, _ = outcome(tmp_path, nominal=False, extra="frequency_hz = 0.0625\n")
    assert "the study file says 0.0625 Hz" in warnings
    assert_right(row)
