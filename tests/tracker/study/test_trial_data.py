"""A trial's files on one clock: pressure at the frames without delay or bias, gaps kept, what does not fit refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import BendtrackError, ResultsError, StudyError
from bendtrack.tracker.results import AngleTable, write_results
from bendtrack.tracker.study.angle_input import find_table, read_angles
from bendtrack.tracker.study.resampling import pressure_at_frames
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial import TrialData
from bendtrack.tracker.study.trial_data import load_trial, load_trials

FRAMES_S = np.arange(360) / 30
LOG_S = np.arange(5000) / 400


def triangle(time_s: np.ndarray, peak_kpa: float = 50.0, period_s: float = 4.0) -> np.ndarray:
    return peak_kpa * (1 - np.abs(1 - 2 * (time_s / period_s % 1)))


# --- pressure at the frames -------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [10, 30, 50, 100, 400, 1000, 10_000])
def test_exact_on_a_slope_at_any_rate(rate_hz: float) -> None:
    log_s = 0.00137 + np.arange(0, 12.2, 1 / rate_hz)
    pressure, rate = pressure_at_frames(FRAMES_S, log_s, 3 + 6.25 * log_s)
    inside = np.isfinite(pressure)
    assert inside[1:].all()
    np.testing.assert_allclose(pressure[inside], 3 + 6.25 * FRAMES_S[inside], atol=1e-9)
    np.testing.assert_allclose(rate[inside], 6.25, atol=1e-6)


def test_exact_on_a_slope_with_uneven_samples() -> None:
    rng = np.random.default_rng(2)
    log_s = (np.arange(1220) + rng.uniform(-0.4, 0.4, 1220)) / 100  # as a busy computer logs
    pressure, _ = pressure_at_frames(FRAMES_S[2:], log_s, 25 * log_s)
    np.testing.assert_allclose(pressure, 25 * FRAMES_S[2:], atol=1e-9)


def test_a_turning_point_is_blunted_in_its_own_frame_only() -> None:
    pressure, _ = pressure_at_frames(FRAMES_S, LOG_S, triangle(LOG_S))
    error = pressure - triangle(FRAMES_S)
    at_turn = np.isclose(FRAMES_S % 2, 0) | np.isclose(FRAMES_S % 2, 2)
    assert np.abs(error[~at_turn]).max() < 1e-9
    # The mean of |t| over one frame interval is a quarter of the interval: 25 kPa/s / 30 / 4.
    assert np.abs(error[at_turn][1:]).max() == pytest.approx(25 / 30 / 4, rel=0.1)


def test_ripple_that_would_fold_is_taken_out_and_noise_made_small() -> None:
    for hz in (30, 60, 90):
        ripple, _ = pressure_at_frames(FRAMES_S, LOG_S, np.sin(2 * np.pi * hz * LOG_S + 1))
        assert np.abs(ripple[1:-1]).max() < 0.1, hz
    noise, _ = pressure_at_frames(FRAMES_S, LOG_S, np.random.default_rng(0).standard_normal(LOG_S.size))
    assert noise[1:-1].std() == pytest.approx(1 / 13.3**0.5, rel=0.15)


def test_no_delay() -> None:
    slow = np.sin(2 * np.pi * 0.5 * LOG_S)
    pressure, rate = pressure_at_frames(FRAMES_S, LOG_S, slow)
    true = np.sin(2 * np.pi * 0.5 * FRAMES_S)
    slope = 2 * np.pi * 0.5 * np.cos(2 * np.pi * 0.5 * FRAMES_S)
    delay_s = -np.dot((pressure - true)[1:], slope[1:]) / np.dot(slope[1:], slope[1:])
    assert abs(delay_s) < 1e-5
    np.testing.assert_allclose(rate[1:-1], slope[1:-1], atol=0.01)


def test_outside_and_in_gaps_there_is_no_pressure() -> None:
    kept = (LOG_S > 1) & (LOG_S < 11) & ~((LOG_S > 4) & (LOG_S < 4.5))
    pressure, rate = pressure_at_frames(FRAMES_S, LOG_S[kept], triangle(LOG_S[kept]))
    lost = np.isnan(pressure)
    sure = (FRAMES_S < 0.99) | (FRAMES_S > 11.01) | ((FRAMES_S > 4.02) & (FRAMES_S < 4.48))
    assert lost[sure].all()
    assert not lost[(FRAMES_S > 1.02) & (FRAMES_S < 3.98)].any()
    assert not lost[(FRAMES_S > 4.52) & (FRAMES_S < 10.98)].any()
    assert np.array_equal(lost, np.isnan(rate))
    # NaN samples are a gap too, and a single one is not.
    holes = triangle(LOG_S)
    holes[(LOG_S > 4) & (LOG_S < 4.5)] = np.nan
    holes[700] = np.nan
    again, _ = pressure_at_frames(FRAMES_S, LOG_S, holes)
    assert np.isnan(again[(FRAMES_S > 4.02) & (FRAMES_S < 4.48)]).all()
    assert np.isfinite(again[FRAMES_S < 3.98]).all()


# --- files ------------------------------------------------------------------------------------------------


def put_log(path: Path, time_s: np.ndarray, kpa: np.ndarray, header: str = "time_s,pressure_kpa") -> None:
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, np.column_stack([time_s, kpa]), fmt="%.5f", delimiter=",", header=header, comments="")


def put_angles(path: Path, angle_deg: np.ndarray, time_s: np.ndarray = FRAMES_S) -> None:
    put_log(path, time_s, angle_deg, "time_s,angle_deg")


def trial_of(
    folder: Path, entry: str = "angles = 'angles.csv'", above: str = "", pressure_pp: float = 50
) -> TrialData:
    (folder / "study.toml").write_text(
        f'{above}\n[[trials]]\nname = "a"\ndesign = "original"\nkind = "dynamic"\nfrequency_hz = 0.25\n'
        f'pressure_pp_kpa = {pressure_pp}\nlog = "log.csv"\n{entry}\n'
    )
    study = read_study(folder / "study.toml")
    return load_trial(study, study.trials[0])


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A trial whose log begins 0.5 s before the video: video time = log time - 0.5."""
    noise = 0.1 * np.random.default_rng(1).standard_normal(LOG_S.size)
    put_log(tmp_path / "log.csv", LOG_S, triangle(LOG_S) + noise)
    put_angles(tmp_path / "angles.csv", 2 * triangle(FRAMES_S + 0.5))
    return tmp_path


DELAY = 'sync = { method = "given delay", delay_s = -0.5, sd_s = 0.02 }\n'
OWN = f"angles = 'angles.csv'\n{DELAY}"


def test_one_trial_on_one_clock(files: Path) -> None:
    trial = trial_of(files, OWN)
    assert (trial.name, trial.design, trial.kind, trial.frequency_hz) == ("a", "original", "dynamic", 0.25)
    np.testing.assert_allclose(trial.pressure_kpa, triangle(FRAMES_S + 0.5), atol=0.35)
    np.testing.assert_allclose(trial.angle_deg, 2 * trial.pressure_kpa, atol=0.7)
    np.testing.assert_allclose(trial.log_time_s, LOG_S - 0.5, atol=1e-5)
    assert (trial.shift.delay_s, trial.shift.sd_s) == (-0.5, 0.02)
    assert trial.warnings == ()
    assert np.isnan(trial.angle_sd_deg).all()
    assert trial.provenance["log"]["rate_hz"] == pytest.approx(400)
    assert trial.provenance["shift"] == {"delay_s": -0.5, "sd_s": 0.02, "method": "given delay"}


def test_a_wrong_delay_is_not_mended(files: Path) -> None:
    # What comes in is shown as it is: nothing makes the loop small.
    trial = trial_of(files, OWN.replace("-0.5", "-0.3"))
    rising = (trial.pressure_rate_kpa_s > 20) & (trial.pressure_kpa > 10)
    apart_kpa = trial.pressure_kpa - trial.angle_deg / 2
    assert np.median(apart_kpa[rising]) == pytest.approx(-0.2 * 25, abs=0.1)


def test_log_shorter_than_video(files: Path) -> None:
    put_log(files / "log.csv", LOG_S[:3000], triangle(LOG_S[:3000]))
    trial = trial_of(files, OWN.replace("-0.5", "1.0"))
    assert np.isnan(trial.pressure_kpa[FRAMES_S < 0.99]).all()
    assert np.isnan(trial.pressure_kpa[FRAMES_S > 8.6]).all()
    assert np.isfinite(trial.pressure_kpa[(FRAMES_S > 1.1) & (FRAMES_S < 8.4)]).all()
    before, after = (w for w in trial.warnings if w.startswith("log shorter than video"))
    assert "30 of 360 frames lie before the log begins" in before
    assert "105 of 360 frames lie after the log ends (the log goes from 1.00 to 8.50 s" in after


def test_log_and_video_of_different_times(files: Path) -> None:
    with pytest.raises(StudyError, match=r"no moment in common.*log goes from 99\.50 to 112\.00 s"):
        trial_of(files, OWN.replace("-0.5", "99.5"))


def test_a_gap_in_the_log_is_said(files: Path) -> None:
    kept = (LOG_S < 5) | (LOG_S > 6)
    put_log(files / "log.csv", LOG_S[kept], triangle(LOG_S[kept]))
    trial = trial_of(files, OWN)
    assert np.isnan(trial.pressure_kpa[(FRAMES_S > 4.52) & (FRAMES_S < 5.48)]).all()
    assert any("log: gap: no sample for 1.0" in warning for warning in trial.warnings)
    assert any("frames lie in gaps of the log" in warning for warning in trial.warnings)


def test_a_pressure_in_another_unit_is_refused(files: Path) -> None:
    put_log(files / "log.csv", LOG_S, triangle(LOG_S) / 6.894757)
    with pytest.raises(
        StudyError, match=r"peak-to-peak pressure is 7\.\d+ kPa, 50 kPa were expected.*as if it were in psi"
    ):
        trial_of(files, OWN)
    put_log(files / "log.csv", LOG_S, triangle(LOG_S), "time_s,pressure_mbar")
    with pytest.raises(StudyError, match="was read in mbar and looks as if it were in kPa"):
        trial_of(files, OWN)
    put_log(files / "log.csv", LOG_S, triangle(LOG_S))
    assert any("30 kPa were expected" in warning for warning in trial_of(files, OWN, pressure_pp=30).warnings)


def test_reference_and_model(files: Path) -> None:
    wave_s = np.arange(0, 14, 0.5)
    put_log(files / "wave.csv", wave_s, triangle(wave_s), "time_s,reference_kpa")
    (files / "model.csv").write_text("pressure (psi),angle (deg)\n0,0\n3.6259434,40\n7.2518868,100\n")
    trial = trial_of(files, f"{OWN}reference = 'wave.csv'\nmodel = 'model.csv'")
    assert trial.log_reference_kpa is not None
    np.testing.assert_allclose(trial.log_reference_kpa, triangle(LOG_S), atol=1e-6)
    assert trial.model_pressure_kpa is not None
    np.testing.assert_allclose(trial.model_pressure_kpa, [0, 25, 50], atol=1e-4)
    np.testing.assert_array_equal(trial.model_angle_deg, [0, 40, 100])
    for text, message in (
        ("pressure_kpa,angle_rad\n0,0\n1,1\n2,2\n", "expected degrees"),
        ("pressure,angle_deg\n0,0\n1,1\n2,2\n", "expected a unit such as pressure_kpa"),
        ("pressure_kpa,force\n0,0\n1,1\n2,2\n", "expected one column of angles"),
        ("nothing", "no line of numbers"),
    ):
        (files / "model.csv").write_text(text)
        with pytest.raises(StudyError, match=message):
            trial_of(files, f"{OWN}model = 'model.csv'")


def table(flags: dict[int, str], video_sha256: str = "0" * 64) -> AngleTable:
    """Bendtrack's own table: 2 degrees a second, with flags on some rows."""
    t = FRAMES_S.size
    angle = 2 * FRAMES_S
    flag = np.full(t, "", dtype="<U20")
    for row, name in flags.items():
        flag[row] = name
        if name in ("undecodable", "out_of_frame"):
            angle[row] = np.nan
    keypoints = ("base_1", "base_2", "tip_1", "tip_2")
    return AngleTable(
        time_s=FRAMES_S,
        angle_deg=angle,
        angle_sd_deg=np.full(t, 0.3),
        flag=flag,
        xy=np.zeros((t, 4, 2)),
        likelihood=np.ones((t, 4)),
        covariance=np.full((t, 4, 2, 2), np.nan),
        keypoints=keypoints,
        definition=AngleDefinition("two-vector", keypoints, 1),
        provenance={"video": {"name": "a.mp4", "sha256": video_sha256}, "warnings": ["it is cut short"]},
    )


@pytest.mark.parametrize("suffix", ["csv", "h5", "json"])
def test_flagged_rows_become_gaps_or_are_kept(tmp_path: Path, suffix: str) -> None:
    flags = {3: "low_likelihood", 4: "low_likelihood", 9: "undecodable", 20: "damaged", 30: "out_of_frame"}
    write_results(table(flags), tmp_path, "a")
    angles = read_angles(tmp_path / f"a.{suffix}")
    assert np.flatnonzero(np.isnan(angles.angle_deg)).tolist() == [3, 4, 9, 20, 30]
    np.testing.assert_allclose(angles.angle_deg[5:9], 2 * FRAMES_S[5:9], atol=1e-4)
    assert "angles: 2 of 360 rows are flagged low_likelihood: gaps" in angles.warnings
    assert "video: it is cut short" in angles.warnings
    kept = read_angles(tmp_path / f"a.{suffix}", keep_flagged=["low_likelihood"])
    assert np.flatnonzero(np.isnan(kept.angle_deg)).tolist() == [9, 20, 30]
    assert "angles: 2 of 360 rows are flagged low_likelihood and were kept" in kept.warnings


def test_plain_tables(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time_s;angle_deg;flag\n0,0;1,5;\n0,1;;\n0,2;2,5;low_likelihood\n0,3;3,5;\n0,3;4,5;\n")
    angles = read_angles(path)
    np.testing.assert_allclose(angles.time_s, [0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(angles.angle_deg, [1.5, np.nan, np.nan, 3.5])
    assert "angles: 1 rows whose time does not rise were left out" in angles.warnings
    for text, message in (
        ("time,angle\n0,1\n", "expected columns time_s and angle_deg .*got time, angle"),
        ("time_s,angle_deg\n0,x\n1,2\n", "column angle_deg: expected numbers"),
        ("time_s,angle_deg\n0,\n1,\n", "expected angles, got 0 rows"),
        ("", "cannot be read as a CSV"),
    ):
        path.write_text(text)
        with pytest.raises(ResultsError, match=message):
            read_angles(path)


def test_a_video_finds_its_table(files: Path) -> None:
    above = "results = 'project'"
    entry = f"video = 'videos/a.mp4'\n{DELAY}"
    results = files / "project" / "results"
    results.mkdir(parents=True)
    (files / "project" / "bendtrack.toml").touch()
    with pytest.raises(StudyError, match=r"trial 'a': .*expected an angle table of a\.mp4"):
        trial_of(files, entry, above)
    write_results(table({}), results, "a")
    write_results(table({}), results, "a b")
    assert trial_of(files, entry, above).provenance["angles"]["name"] == "a.h5"
    with pytest.raises(StudyError, match="expected angles, or results"):
        trial_of(files, entry)

    # Two videos of one name: the content decides.
    (files / "videos").mkdir()
    (files / "videos" / "a.mp4").write_bytes(b"second")
    second = "16367aacb67a4a017c8da8ab95682ccb390863780f7114dda0a0e0c55644c7c4"  # sha256sum of that
    write_results(table({}, second), results, "a-16367aac")
    assert find_table(files / "project", files / "videos/a.mp4") == results / "a-16367aac.h5"
    with pytest.raises(StudyError, match="found several"):
        find_table(results, files / "elsewhere" / "a.mp4")


@pytest.mark.parametrize("missing", ["log.csv", "angles.csv"])
def test_a_missing_file_is_named(files: Path, missing: str) -> None:
    (files / missing).unlink()
    with pytest.raises(BendtrackError, match=missing):
        trial_of(files)


def test_trials_come_in_the_order_of_the_file(files: Path) -> None:
    entry = 'design = "original"\nkind = "dynamic"\nlog = "log.csv"\nangles = "angles.csv"\n'
    (files / "study.toml").write_text("".join(f'[[trials]]\nname = "{n}"\n{entry}' for n in "cab"))
    assert [trial.name for trial in load_trials(read_study(files / "study.toml"))] == ["c", "a", "b"]
