"""bendtrack analyze: a first study file, a study from end to end, what fails and with which exit status."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bendtrack.tracker.project import Project

FRAMES_S = np.arange(0, 20, 1 / 30)
LOG_S = np.arange(0, 20, 1 / 400)
PERIOD_S = 4.0
PEAK_KPA = 40.0


def pressure_kpa(time_s: np.ndarray) -> np.ndarray:
    return PEAK_KPA * (1 - np.abs(1 - 2 * (time_s / PERIOD_S % 1)))


def angle_deg(time_s: np.ndarray, largest: float) -> np.ndarray:
    """A leaf of two parabolas between 0 and the largest angle; its ratio to the axes' rectangle is 1/6."""
    x = pressure_kpa(time_s) / PEAK_KPA
    bulge = 0.5 * x * (1 - x)
    rising = time_s / PERIOD_S % 1 < 0.5
    return largest * (x + np.where(rising, -bulge, bulge))


def put(path: Path, header: str, *columns: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack(columns), fmt="%.5f", delimiter=",", header=header, comments="")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    rng = np.random.default_rng(7)
    root = tmp_path / "rig"
    for design, largest in (("original", 100), ("mid-width_smaller", 150)):
        name = f"{design}_0.25Hz_40kPa"
        angle = angle_deg(FRAMES_S, largest) + 0.2 * rng.standard_normal(FRAMES_S.size)
        put(root / f"angles/{name}.csv", "time_s,angle_deg", FRAMES_S, angle)
        noise = 0.05 * rng.standard_normal(LOG_S.size)
        put(root / f"logs/{name}.csv", "Time (s),P [kPa]", LOG_S, pressure_kpa(LOG_S) + noise)
    return root


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_from_a_folder_to_a_report(bendtrack, folder: Path) -> None:
    ran = bendtrack("analyze", "--init", folder)
    assert (ran.status, ran.err) == (0, "")
    assert "study.toml: 2 trials" in ran.out
    before = (folder / "study.toml").read_bytes()
    again = bendtrack("analyze", "--init", folder)
    assert again.status == 2
    assert "expected a folder without study.toml" in again.err
    assert (folder / "study.toml").read_bytes() == before

    out = folder.parent / "out"
    ran = bendtrack("analyze", folder / "study.toml", "--out", out)
    assert ran.status == 0, ran.err
    assert f"2 of 2 trials analysed -> {out / 'report.html'}" in ran.out
    assert "original" in (out / "report.html").read_text()
    dynamic = pd.read_csv(out / "tables" / "dynamic.csv").set_index("design")
    ratio = dynamic["hysteresis_ratio"]
    # The area between the parabolas is 1/6 of the rectangle.
    np.testing.assert_allclose(ratio[["original", "mid-width smaller"]], 1 / 6, atol=0.004)


def test_a_trial_that_fails_does_not_stop_the_others(bendtrack, folder: Path) -> None:
    bendtrack("analyze", "--init", folder)
    (folder / "logs/original_0.25Hz_40kPa.csv").write_text("Time (s),P [kPa],P [kPa]\n0,1,1\n1,2,2\n")
    ran = bendtrack("analyze", folder / "study.toml")
    assert ran.status == 1
    *_, summary, last = ran.err.splitlines()
    assert summary == "error: 1 of 2 trials failed, the others are done:"
    assert last.startswith("error: original_0.25Hz_40kPa: ")
    assert "expected one column of pressure, got 2" in last
    assert "no trial of the baseline 'original' could be read" in ran.err
    assert (folder / "study-report" / "report.html").is_file()

    (folder / "angles/mid-width_smaller_0.25Hz_40kPa.csv").unlink()
    ran = bendtrack("analyze", folder / "study.toml")
    assert ran.status == 2
    assert "2 of 2 trials failed, so nothing was analysed" in ran.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "expected a study file, or --init FOLDER"),
        (("study.toml", "--init", "."), "expected a study file, or --init FOLDER"),
        (("none.toml",), "expected a study file, got no file"),
        (("--init", "none"), "expected a folder with logs and angle tables"),
    ],
)
def test_wrong_use(bendtrack, tmp_path: Path, monkeypatch, arguments: tuple[str, ...], message: str) -> None:
    monkeypatch.chdir(tmp_path)
    ran = bendtrack("analyze", *arguments)
    assert ran.status == 2
    assert ran.err.startswith("error: ")
    assert message in ran.err
    assert len(ran.err.splitlines()) == 1
    assert names(tmp_path) == set()


def test_a_mistake_in_the_study_file(bendtrack, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text("title = 'x'\ntrails = []\n")
    ran = bendtrack("analyze", tmp_path / "study.toml")
    assert ran.status == 2
    assert "unknown key 'trails' (did you mean 'trials'?)" in ran.err
    assert names(tmp_path) == {"study.toml"}


def test_in_a_project_only_logs_are_taken_for_logs(bendtrack, tmp_path: Path) -> None:
    """A network's training.csv has columns of numbers too, and so has what lies next to results."""
    root = tmp_path / "my study"
    Project.create(root, keypoints=("base_1", "base_2", "tip_1", "tip_2"))
    put(root / "results/bend.csv", "time_s,angle_deg", FRAMES_S, angle_deg(FRAMES_S, 100))
    put(root / "results/notes.csv", "time_s,pressure_kpa", LOG_S, pressure_kpa(LOG_S))
    put(root / "models/model/training.csv", "time_s,pressure_kpa", LOG_S, pressure_kpa(LOG_S))
    put(root / "labeled-data/bend/CollectedData_x.csv", "time_s,pressure_kpa", LOG_S, pressure_kpa(LOG_S))
    ran = bendtrack("analyze", "--init", root)
    assert ran.status == 2
    assert "expected pressure logs and angle tables" in ran.err
    assert "training.csv" not in ran.err
    assert "notes.csv" not in ran.err
    assert "CollectedData" not in ran.err
    # It says what to do next, and that works.
    assert f"copy the one of 'bend' to {root / 'logs' / 'bend.csv'}" in ran.err
    put(root / "logs/bend.csv", "time_s,pressure_kpa", LOG_S, pressure_kpa(LOG_S))
    ran = bendtrack("analyze", "--init", root)
    assert (ran.status, ran.err) == (0, "")
    assert f"bendtrack analyze '{root / 'study.toml'}'" in ran.out
    study = (root / "study.toml").read_text()
    assert 'log = "logs/bend.csv"' in study
    assert "training.csv" not in study
    ran = bendtrack("analyze", root / "study.toml")
    assert ran.status == 0, ran.err
    dynamic = pd.read_csv(root / "study-report" / "tables" / "dynamic.csv")
    np.testing.assert_allclose(dynamic["hysteresis_ratio"], 1 / 6, atol=0.004)


def test_a_folder_in_place_of_the_study_file_gets_the_next_command(bendtrack, tmp_path: Path) -> None:
    folder = tmp_path / "my study"
    folder.mkdir()
    ran = bendtrack("analyze", folder)
    assert ran.status == 2
    assert f"got a folder: {folder}. bendtrack analyze --init '{folder}' writes a first study.toml" in ran.err
    (folder / "study.toml").touch()
    assert f"Its study file: bendtrack analyze '{folder}/study.toml'" in bendtrack("analyze", folder).err
    assert (
        f"bendtrack analyze '{folder}/study.toml' analyses it" in bendtrack("analyze", "--init", folder).err
    )
