"""The study file: what it fills in, what it refuses, and the first one made from a folder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from bendtrack.tracker.errors import StudyError
from bendtrack.tracker.study.first_study import first_study_file
from bendtrack.tracker.study.study_file import read_study
from bendtrack.tracker.study.trial import Kind

TRIAL = """
[[trials]]
design = "original"
kind = "dynamic"
frequency_hz = 0.25
pressure_pp_kpa = 45
angles = "angles/a.csv"
log = "logs/a.csv"
"""


def study_with(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_what_the_study_says_holds_for_trials_that_say_nothing(tmp_path: Path) -> None:
    text = """
title = "Nine designs"
results = "../project"
keep_flagged = ["low_likelihood"]
angle_common_sd_deg = 0.4
compare_angles_deg = [85, 140]

[log_format]
pressure_unit = "psi"
pressure_column = 2
lag_s = 0.032

[sync]
method = "given delay"
delay_s = 0.25
sd_s = 0.02
"""
    second = """
[[trials]]
name = "stairs"
design = "mid-width smaller"
kind = "static"
video = "videos/b.mp4"
log = "logs/b.mat"
reference = "logs/b_reference.csv"
model = "fem.csv"
angle_common_sd_deg = 0.1
log_format = { pressure_unit = "kPa" }
sync = { method = "sync event", led_region_px = [3, 4, 5, 6] }
"""
    study = read_study(study_with(tmp_path, text + TRIAL + second))
    assert (study.title, study.baseline, study.results) == (
        "Nine designs",
        "original",
        tmp_path / "../project",
    )
    assert (study.keep_flagged, study.compare_angles_deg) == (("low_likelihood",), (85, 140))
    first, stairs = study.trials
    assert (first.name, first.kind, first.frequency_hz, first.pressure_pp_kpa) == (
        "a",
        Kind.DYNAMIC,
        0.25,
        45,
    )
    assert (first.angles, first.log, first.video) == (
        tmp_path / "angles/a.csv",
        tmp_path / "logs/a.csv",
        None,
    )
    assert (first.log_format.pressure_unit, first.log_format.pressure_column) == ("psi", 2)
    assert (first.sync.method, first.sync.delay_s, first.sync.sd_s) == ("given delay", 0.25, 0.02)
    assert first.angle_common_sd_deg == 0.4
    assert (stairs.name, stairs.kind, stairs.angles) == ("stairs", Kind.STATIC, None)
    assert stairs.log_format.model_dump(exclude_unset=True) == {
        "pressure_unit": "kPa",
        "pressure_column": 2,
        "lag_s": 0.032,
    }
    assert (stairs.sync.method, stairs.sync.led_region_px) == ("sync event", (3, 4, 5, 6))
    assert (stairs.reference, stairs.model) == (tmp_path / "logs/b_reference.csv", tmp_path / "fem.csv")
    assert stairs.angle_common_sd_deg == 0.1


def test_designs_keep_their_colours(tmp_path: Path) -> None:
    names = ["ours", "mid_width smaller", "original", "theirs"]
    trials = "".join(
        TRIAL.replace("original", name).replace("a.csv", f"{n}.csv") for n, name in enumerate(names)
    )
    designs = read_study(study_with(tmp_path, trials)).designs
    assert list(designs) == names
    assert [designs[n].label for n in names] == names
    # Red and purple as in the study's figures; the others differ from all of those and from each other.
    assert designs["original"].colour == "#d62728"
    assert designs["mid_width smaller"].colour == "#7b3fb5"
    assert len({design.colour for design in designs.values()}) == 4

    chosen = '[designs."mid_width smaller"]\nlabel = "Ours"\ncolour = "#123456"\n[designs.original]\n'
    designs = read_study(study_with(tmp_path, chosen + TRIAL)).designs
    assert (designs["mid_width smaller"].label, designs["mid_width smaller"].colour) == ("Ours", "#123456")
    assert designs["original"].colour == "#d62728"


def test_no_baseline_is_guessed(tmp_path: Path) -> None:
    other = TRIAL.replace("original", "ours")
    assert read_study(study_with(tmp_path, other)).baseline is None
    assert read_study(study_with(tmp_path, 'baseline = "ours"\n' + other)).baseline == "ours"


SYNC = "\n[sync]\nmethod = "


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("trials = 3", "trials: expected a list, got 3"),
        ("title = 3" + TRIAL, "title: expected a valid string, got 3"),
        (
            "tilte = 'x'" + TRIAL,
            "unknown key 'tilte' (did you mean 'title'?); expected one of title, baseline",
        ),
        ("title = 'x'", "expected the key 'trials', got none"),
        ("trials = []", "expected at least one [[trials]], got none"),
        ("title = ", "expected TOML, got a mistake"),
        (TRIAL + "presure = 3", "unknown key 'trials[1].presure' (did you mean 'pressure_pp_kpa'?)"),
        (TRIAL.replace('log = "logs/a.csv"', ""), "expected the key 'trials[1].log', got none"),
        (TRIAL.replace('"dynamic"', '"wave"'), "trials[1].kind: expected 'static' or 'dynamic', got 'wave'"),
        (TRIAL.replace("0.25", "-0.25"), "trials[1].frequency_hz: expected greater than 0, got -0.25"),
        (
            TRIAL.replace('"logs/a.csv"', '"/logs/a.csv"'),
            "trials[1].log: expected a path relative to this file",
        ),
        (
            TRIAL.replace('"logs/a.csv"', "'logs\\a.csv'"),
            "trials[1].log: expected a path relative to this file",
        ),
        (TRIAL.replace('"logs/a.csv"', '"C:/a.csv"'), "trials[1].log: expected a path relative to this file"),
        (
            TRIAL.replace("angles =", "model ="),
            "trials[1]: expected angles (an angle table) or video, got neither",
        ),
        (TRIAL + TRIAL, "expected trials of distinct names, got 'a' twice"),
        (
            "baseline = 'orignal'" + TRIAL,
            "one of the designs original, got 'orignal' (did you mean 'original'?)",
        ),
        ("[designs.ours]" + TRIAL, "trial 'a': design: expected one of the designs ours, got 'original'"),
        ("[designs.original]\ncolor = 'red'" + TRIAL, "'designs.original.color' (did you mean 'colour'?)"),
        (
            "[designs.original]\ncolour = 'red'" + TRIAL,
            "designs.original.colour: String should match pattern",
        ),
        (
            "keep_flagged = ['out_of_frame']" + TRIAL,
            "expected some of low_likelihood, jump, damaged, got 'out_of_frame'",
        ),
        ("log_format.rate_hz = 0" + TRIAL, "log_format.rate_hz: expected greater than 0, got 0"),
        ("log_format.pressure_unit = 'apples'" + TRIAL, "expected a unit of pressure (kPa, Pa"),
        ("log_format.presure_unit = 'kPa'" + TRIAL, "(did you mean 'pressure_unit'?)"),
        (TRIAL + "log_format = { unit = 'kPa' }", "unknown key 'trials[1].log_format.unit'"),
        (SYNC + "'by eye'" + TRIAL, "sync.method: expected 'shared clock', 'given delay' or 'sync event'"),
        (SYNC + "'given delay'" + TRIAL, "sync: method = 'given delay' needs delay_s"),
        (SYNC + "'sync event'" + TRIAL, "sync: a lamp as video_event needs led_region_px"),
        ("[sync]\ndelay_s = 3" + TRIAL, "delay_s is for method = 'given delay', got method = 'shared clock'"),
        (SYNC + "'sync event'\nled_region_px = [1, 2, 0, 4]" + TRIAL, "expected x, y, width, height in px"),
        (
            SYNC + "'sync event'\nvideo_event = 'angle'\nlog_window_s = [3, 1]" + TRIAL,
            "a begin before an end",
        ),
    ],
)
def test_a_mistake_gets_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(StudyError, match=re.escape(message)) as caught:
        read_study(study_with(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "study.toml") in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="got no file"):
        read_study(tmp_path / "study.toml")
    with pytest.raises(StudyError, match="got a folder"):
        read_study(tmp_path)


# --- a first file from a folder ---------------------------------------------------------------------------


def put_log(path: Path, header: str = "time_s,pressure_kpa") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = "".join(f"{n / 100:.2f},{n % 40}\n" for n in range(200))
    path.write_text(f"{header}\n{rows}")


def put_angles(path: Path) -> None:
    put_log(path, "time_s,angle_deg")


def test_files_become_trials_by_their_names(tmp_path: Path) -> None:
    for name in ("original_0.0625Hz_45kPa", "original_0.25Hz_45kPa", "mid_width-smaller_0p25Hz_50kPa"):
        put_angles(tmp_path / f"angles/{name}.csv")
        put_log(tmp_path / f"logs/{name}_pressure.csv")
    put_angles(tmp_path / "my actuator static/angles.csv")
    put_log(tmp_path / "my actuator static/log.csv")
    (tmp_path / "models").mkdir()
    rows = "".join(f"{5 * n},{n * n}\n" for n in range(11))
    (tmp_path / "models/my actuator static.csv").write_text("pressure_kpa,angle_deg\n" + rows)
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos/theirs 1Hz 30 kPa.mp4").write_bytes(b"not looked into")
    time_s = np.arange(100) / 100
    savemat(tmp_path / "theirs_1Hz_30kPa.mat", {"t": time_s, "p_kPa": time_s})
    put_log(tmp_path / "logs/odd.csv")
    put_angles(tmp_path / "lonely_0.25Hz_40kPa.csv")
    (tmp_path / "notes.txt").write_text("nothing of interest")

    study = read_study(study_with(tmp_path, first_study_file(tmp_path)))
    trials = {(t.design, t.frequency_hz, t.pressure_pp_kpa): t for t in study.trials}
    assert set(trials) == {
        ("original", 0.0625, 45),
        ("original", 0.25, 45),
        ("mid-width smaller", 0.25, 50),
        ("my actuator", None, None),
        ("theirs", 1, 30),
    }
    slow = trials["original", 0.0625, 45]
    assert slow.kind is Kind.DYNAMIC
    assert slow.angles == tmp_path / "angles/original_0.0625Hz_45kPa.csv"
    assert slow.log == tmp_path / "logs/original_0.0625Hz_45kPa_pressure.csv"
    still = trials["my actuator", None, None]
    assert still.kind is Kind.STATIC
    assert still.model == tmp_path / "models/my actuator static.csv"
    filmed = trials["theirs", 1, 30]
    assert (filmed.video, filmed.angles) == (tmp_path / "videos/theirs 1Hz 30 kPa.mp4", None)
    assert study.baseline == "original"

    text = (tmp_path / "study.toml").read_text()
    for name in ("logs/odd.csv", "lonely_0.25Hz_40kPa.csv"):
        assert f"#   {name}\n" in text
    assert str(tmp_path) not in text


def test_repeats_of_a_trial_stay_apart(tmp_path: Path) -> None:
    for name in ("original_0.25Hz_45kPa_rep1", "original_0.25Hz_45kPa_rep2"):
        put_angles(tmp_path / f"angles/{name}.csv")
        put_log(tmp_path / f"logs/{name}.csv")
    study = read_study(study_with(tmp_path, first_study_file(tmp_path)))
    assert [t.design for t in study.trials] == ["original", "original"]
    assert [t.angles.stem == t.log.stem for t in study.trials if t.angles] == [True, True]


def test_what_the_first_log_leaves_open_is_said(tmp_path: Path) -> None:
    put_angles(tmp_path / "angles/original_1Hz_45kPa.csv")
    put_log(tmp_path / "logs/original_1Hz_45kPa.csv", "time_s,pressure")
    text = first_study_file(tmp_path)
    assert "TO DO: original_1Hz_45kPa.csv: column 'pressure' names no unit" in text
    read_study(study_with(tmp_path, text))


def test_a_folder_without_trials(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"expected pressure logs and angle tables.*found neither"):
        first_study_file(tmp_path)
    put_log(tmp_path / "original_1Hz_45kPa.csv")
    with pytest.raises(StudyError, match=r"found original_1Hz_45kPa\.csv"):
        first_study_file(tmp_path)
    with pytest.raises(StudyError, match="expected a folder"):
        first_study_file(tmp_path / "none")
