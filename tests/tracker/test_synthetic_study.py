import json
import tomllib

import h5py
import numpy as np
import pytest
from scipy.io import loadmat

from bendtrack.tracker.angle import bending_angle
from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.results import read_results
from bendtrack.tracker.synthetic import study_plan
from bendtrack.tracker.synthetic.cycling import CyclingTrial
from bendtrack.tracker.synthetic.recording import record
from bendtrack.tracker.synthetic.response import HystereticResponse
from bendtrack.tracker.synthetic.stairs import StaircaseTrial
from bendtrack.tracker.synthetic.study import simulate_study


def shoelace(x, y):
    return 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))


@pytest.mark.parametrize(("frequency_hz", "lag_s"), [(0.0625, 0.05), (0.25, 0.017)])
def test_a_loop_sampled_in_time_has_the_numbers_that_are_called_true(frequency_hz, lag_s):
    trial = CyclingTrial(frequency_hz, 45.0, 155.83, 0.2156, residual_deg=6.2, lag_s=lag_s)
    truth = trial.truth()
    begin_s = trial.rest_s + lag_s + 4 / frequency_hz
    time_s = begin_s + np.linspace(0, 1 / frequency_hz, 20_001)[:-1]
    pressure, angle = trial.pressure_kpa(time_s), trial.angle_deg(time_s)
    assert pressure.max() == pytest.approx(45.0)
    assert angle.max() == pytest.approx(truth["angle_max_deg"]) == pytest.approx(155.83)
    assert angle.min() == pytest.approx(truth["residual_deg"])
    area = shoelace(pressure, angle)
    assert area == pytest.approx(truth["area_deg_kpa"], rel=1e-5)
    assert area / (45.0 * 155.83) == pytest.approx(0.2156, abs=1e-5)
    own = (pressure.max() - pressure.min()) * (angle.max() - angle.min())
    assert area / own == pytest.approx(truth["hysteresis_ratio_extremes"], abs=1e-5)
    up, down = time_s < begin_s + 0.5 / frequency_hz, time_s > begin_s + 0.5 / frequency_hz
    width = np.interp(-22.5, -pressure[down], angle[down]) - np.interp(22.5, pressure[up], angle[up])
    assert width == pytest.approx(truth["mid_pressure_width_deg"], abs=1e-3)


def test_a_steady_cycle_is_that_of_the_hysteretic_response():
    trial = CyclingTrial(0.25, 50.0, 118.06, 0.229, residual_deg=4.0)
    time_s = np.arange(0, trial.duration_s, 1e-3)
    response = HystereticResponse(50.0, 4.0, 118.06, 0.229)
    later = time_s > trial.rest_s + 4.0
    expected = response.angle_deg(trial.pressure_kpa(time_s))
    np.testing.assert_allclose(trial.angle_deg(time_s)[later], expected[later], atol=1e-6)


def test_angle_and_pressure_never_jump():
    trial = CyclingTrial(0.25, 50.0, 118.06, 0.229, residual_deg=4.0, peak_sd_deg=2.0, ratio_sd=0.01, seed=3)
    time_s = np.arange(0, trial.duration_s, 1e-4)
    assert np.abs(np.diff(trial.angle_deg(time_s))).max() < 0.03
    assert np.abs(np.diff(trial.pressure_kpa(time_s))).max() < 0.01
    assert trial.angle_deg(np.array([0.0]))[0] == 0
    assert trial.angle_deg(np.array([trial.duration_s]))[0] == 4.0


def test_a_shift_changes_the_ratio_as_a_plain_triangle_foretells():
    for frequency_hz in (0.0625, 0.25):
        trial = CyclingTrial(frequency_hz, 50.0, 100.0, 0.3, residual_deg=3.0)
        assert trial.shifted_ratio(0.0) == pytest.approx(0.3, abs=1e-6)
        change = (trial.shifted_ratio(0.01) - trial.shifted_ratio(-0.01)) / 2
        assert change == pytest.approx(4 * frequency_hz * 0.01 * 0.97, rel=0.02)


def test_cycles_differ_about_what_is_called_true():
    trial = CyclingTrial(0.25, 50.0, 100.0, 0.3, cycles=400, peak_sd_deg=0.5, ratio_sd=0.004)
    time_s = trial.rest_s + np.arange(400 * 2000) / 500
    angle = trial.angle_deg(time_s).reshape(400, 2000)
    pressure = trial.pressure_kpa(time_s).reshape(400, 2000)
    peaks = angle.max(axis=1)[1:]
    ratios = np.array([shoelace(p, a) for p, a in zip(pressure, angle, strict=True)])[1:] / 5000
    assert peaks.mean() == pytest.approx(100, abs=0.1)
    assert peaks.std() == pytest.approx(0.5, rel=0.15)
    assert ratios.mean() == pytest.approx(0.3, abs=1e-3)
    assert angle[0].max() == pytest.approx(trial.truth()["first_angle_max_deg"]) == pytest.approx(98.5, abs=2)


def test_the_plan_holds_the_tables_of_the_paper():
    angles = {
        (design, frequency): {kpa: angle for kpa, angle, _ in trials}
        for (design, frequency), trials in study_plan.DYNAMIC.items()
    }
    better = angles["mid-width smaller", 0.0625], angles["mid-width smaller", 0.25]
    worse = angles["original", 0.0625], angles["original", 0.25]
    assert [b[kpa] for b in better for kpa in (40, 45, 50)] == [93.28, 155.83, 191.66, 50.19, 85.91, 118.06]
    assert [w[kpa] for w in worse for kpa in (40, 45, 50)] == [45.44, 76.30, 119.48, 29.34, 40.57, 63.92]
    gains = [100 * (b[kpa] / w[kpa] - 1) for b, w in zip(better, worse, strict=True) for kpa in (40, 45, 50)]
    assert [round(gain) for gain in gains] == [105, 104, 60, 71, 112, 85]

    def ratio_at(design, frequency, angle_deg):
        trials = study_plan.DYNAMIC[design, frequency]
        return np.interp(angle_deg, [angle for _, angle, _ in trials], [ratio for *_, ratio in trials])

    found = [
        [ratio_at("original", *at), ratio_at("mid-width smaller", *at)]
        for at in ((0.0625, 140.0), (0.25, 85.0))
    ]
    np.testing.assert_allclose(found, [[0.279, 0.219], [0.303, 0.238]], atol=1e-9)
    assert [round(100 * (old - new) / old, 1) for old, new in found] == [21.5, 21.5]
    # In the paper no design has less hysteresis than mid-width smaller, at any angle that both reach.
    for (design, frequency), trials in study_plan.DYNAMIC.items():
        best = study_plan.DYNAMIC["mid-width smaller", frequency]
        for _, angle, ratio in trials:
            if design != "mid-width smaller" and angle > best[0][1]:
                assert ratio > ratio_at("mid-width smaller", frequency, angle)
    assert sum(map(len, study_plan.DYNAMIC.values())) == 54
    assert len(study_plan.DESIGNS) == 8


def test_stairs_and_model_have_the_errors_of_the_paper():
    for angle_deg, rmse_deg, percent in ((182.0, 7.29, 4.0), (108.75, 4.35, 4.0), (199.8, 9.99, 5.0)):
        trial = StaircaseTrial(angle_deg, rmse_deg)
        model = np.interp(trial.levels_kpa, *trial.model_curve())
        rmse = np.sqrt(np.mean((model - trial.steady_deg) ** 2))
        assert rmse == pytest.approx(rmse_deg)
        assert round(100 * rmse / np.ptp(trial.steady_deg), 1) == percent
        before = trial.angle_deg(10.0 * np.arange(1, 12) - 0.1)
        np.testing.assert_allclose(before, trial.steady_deg, atol=1e-3)


def test_the_control_errors_are_those_of_the_paper():
    stairs = StaircaseTrial(182.0)
    slow, fast = (CyclingTrial(f, 55.0, 100.0, 0.3, lag_s=study_plan.LAG_S[f]) for f in (0.0625, 0.25))
    printed = []
    for trial, size_kpa in ((stairs, 50), (slow, 55), (fast, 55)):
        recording = record(trial, seed=1)
        rmse = np.sqrt(np.mean((recording.log_kpa - recording.reference_kpa) ** 2))
        assert rmse == pytest.approx(trial.truth(0.1)["control_rmse_kpa"], rel=0.01)
        printed.append((round(rmse, 1), round(100 * rmse / size_kpa, 1)))
    assert printed == [(0.4, 0.9), (0.4, 0.7), (0.5, 1.0)]


def test_clocks_noise_and_points_are_as_said():
    trial = CyclingTrial(0.25, 50.0, 190.0, 0.3, residual_deg=3.0)
    recording = record(trial, seed=5, delay_s=-0.37, missing_share=0.01)
    noise = recording.angle_deg - trial.angle_deg(recording.frame_time_s + 0.37)
    assert np.nanstd(noise) == pytest.approx(0.5, rel=0.05)
    assert 0.004 < np.isnan(noise).mean() < 0.02
    assert np.std(recording.log_kpa - trial.pressure_kpa(recording.log_time_s)) == pytest.approx(
        0.1, rel=0.03
    )
    table = recording.angle_table("one")
    found_deg, _, _ = bending_angle(table.xy, table.keypoints, table.definition)
    np.testing.assert_allclose(found_deg, recording.angle_deg, atol=1e-9)


def test_a_study_on_disk(tmp_path):
    designs = ("original", "mid-top wall thicker")
    study = simulate_study(tmp_path / "study", seed=4, designs=designs, frequencies_hz=(0.25,))
    trials = tomllib.loads(study.study_path.read_text())["trials"]
    truth = json.loads(study.truth_path.read_text())
    assert truth == study.truth
    assert [trial["name"] for trial in trials] == list(truth["trials"])
    assert len(trials) == 4 + 5 + 2
    assert truth["frames"] == sum(
        len(read_results(study.folder / "angles" / f"{name}.csv")) for name in truth["trials"]
    )
    for name, numbers in truth["trials"].items():
        table = read_results(study.folder / "angles" / f"{name}.csv")
        if numbers["kind"] == "dynamic":
            assert np.nanmax(table.angle_deg) == pytest.approx(numbers["angle_max_deg"], abs=3)
    suffixes = {path.suffix for path in (study.folder / "logs").iterdir()}
    assert suffixes == {".csv", ".mat"}


def test_the_forms_of_a_log_hold_the_same(tmp_path):
    designs = ("original", "mid-side walls thicker", "mid-top wall thicker")
    study = simulate_study(tmp_path, seed=4, designs=designs, frequencies_hz=(0.25,), static=False)
    found = set()
    for path in (study.folder / "logs").iterdir():
        if path.suffix == ".mat":
            if h5py.is_hdf5(path):
                found.add("7.3")
                with h5py.File(path) as file:
                    time_s, kpa = file["time_s"][0], file["pressure_kpa"][0]
            elif "log" in (data := loadmat(path, squeeze_me=True)):
                found.add("simulink")
                time_s, kpa = data["log"]["time"].item(), data["log"]["signals"].item()["values"][0]
            else:
                found.add("5")
                time_s, kpa = data["time_s"], data["pressure_kpa"]
        else:
            psi = path.read_text().startswith("Time (ms),Pressure (psi)")
            found.add("psi" if psi else "csv")
            time_s, kpa, _ = np.loadtxt(path, delimiter=",", skiprows=1, unpack=True)
            if psi:
                time_s, kpa = time_s / 1000, kpa * 6.894757
        assert np.allclose(np.diff(time_s), 1 / 400)
        assert kpa.max() == pytest.approx(study.truth["trials"][path.stem]["pressure_max_kpa"], abs=0.6)
    assert found == {"7.3", "simulink", "5", "psi", "csv"}


def test_a_part_is_the_same_as_in_the_whole(tmp_path):
    one = simulate_study(tmp_path / "one", seed=2, designs=("original",), frequencies_hz=(0.25,))
    two = simulate_study(
        tmp_path / "two", seed=2, designs=("mid-side walls thicker", "original"), frequencies_hz=(0.25,)
    )
    for name, numbers in one.truth["trials"].items():
        assert two.truth["trials"][name] == numbers
        text = (one.folder / "angles" / f"{name}.csv").read_text()
        assert (two.folder / "angles" / f"{name}.csv").read_text() == text


def test_unknown_parts_are_refused(tmp_path):
    with pytest.raises(BendtrackError, match="expected a design of original"):
        simulate_study(tmp_path, designs=("mid-height larger",))
    with pytest.raises(BendtrackError, match=r"expected a frequency of 0\.0625, 0\.25, got 0\.025"):
        simulate_study(tmp_path, frequencies_hz=(0.025,))


def test_a_settled_actuator_has_no_first_cycle_of_its_own():
    trial = CyclingTrial(0.25, 50.0, 100.0, 0.3, residual_deg=5.0, first_differs=False)
    time_s = trial.rest_s + np.arange(2 * 2000) / 500
    first, second = trial.angle_deg(time_s).reshape(2, 2000)
    np.testing.assert_allclose(first, second, atol=1e-9)
    assert trial.angle_deg(np.array([0.0]))[0] == 5.0


def test_delays_are_wrong_where_that_is_asked_for(tmp_path):
    part = {"designs": ("mid-width smaller",), "frequencies_hz": (0.25,), "static": False, "delay_sd_s": 0.03}
    for wrong in (False, True):
        study = simulate_study(tmp_path / str(wrong), seed=4, delay_error=wrong, **part)
        trials = tomllib.loads(study.study_path.read_text())["trials"]
        off_s = [
            trial["sync"]["delay_s"] - study.truth["trials"][trial["name"]]["delay_s"] for trial in trials
        ]
        assert all(trial["sync"]["sd_s"] == 0.03 for trial in trials)
        assert (np.abs(off_s) > 1e-4).all() if wrong else (np.abs(off_s) < 1e-5).all()
        assert np.abs(off_s).max() < 0.12
