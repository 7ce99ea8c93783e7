"""Studies and logs that are valid but unusual, and files that are neither: results or one line each."""

from __future__ import annotations

import itertools
from pathlib import Path

import h5py
import numpy as np
import pytest

from bendtrack.studies import analyse_file
from bendtrack.tracker.errors import BendtrackError, PressureLogError, ResultsError
from bendtrack.tracker.results import read_results
from bendtrack.tracker.study.findings import main_findings
from bendtrack.tracker.study.paper_tables import paper_tables
from bendtrack.tracker.study.pressure_log import read_pressure_log
from bendtrack.tracker.study.study_file import read_study

TIME_S = np.arange(0, 40, 0.1)
LOG = "time_s,pressure_kpa\n" + "".join(f"{n / 100:.2f},{n % 50}\n" for n in range(400))
NOTED = "time_s,pressure_kpa,note\n" + "".join(f"{n / 100:.2f},{n % 50},\n" for n in range(400))


def _study(root: Path, keys: tuple[str, ...]) -> Path:
    """Two designs at two pressures, and a staircase; of the optional keys only some are given."""
    text = ""
    for (design, gain), (number, peak) in itertools.product(
        (("original", 1.5), ("b", 1.7)), ((1, 40), (2, 60))
    ):
        pressure = peak * (0.5 - 0.5 * np.cos(2 * np.pi * 0.1 * TIME_S))
        angle = gain * pressure - 3 * np.sin(2 * np.pi * 0.1 * TIME_S)
        name = f"{design}{number}"
        for kind, header, values in (("log", "pressure_kpa", pressure), ("a", "angle_deg", angle)):
            table = np.column_stack([TIME_S, values])
            np.savetxt(root / f"{kind}{name}.csv", table, "%.3f", ",", header=f"time_s,{header}", comments="")
        given = {"frequency_hz": 0.1, "pressure_pp_kpa": float(peak)}
        text += f'[[trials]]\ndesign = "{design}"\nkind = "dynamic"\nlog = "log{name}.csv"\nangles = "a{name}.csv"\n'
        text += "".join(f"{key} = {given[key]}\n" for key in keys)
    (root / "study.toml").write_text(text)
    return root / "study.toml"


def test_a_study_without_nominal_pressures(bendtrack, tmp_path: Path) -> None:
    ran = bendtrack("analyze", _study(tmp_path, ("frequency_hz",)), "--out", tmp_path / "out")
    assert (ran.status, "Traceback" in ran.err) == (0, False), ran.err
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.parametrize("keys", [(), ("pressure_pp_kpa",), ("frequency_hz", "pressure_pp_kpa")])
def test_keys_that_no_trial_has(tmp_path: Path, keys: tuple[str, ...]) -> None:
    analysed = analyse_file(_study(tmp_path, keys))
    assert not analysed.problems
    assert analysed.results is not None
    labels = {name: design.label for name, design in analysed.study.designs.items()}
    assert paper_tables(analysed.results, labels)
    findings = main_findings(analysed.results, labels)
    assert any("bends furthest" in sentence for sentence in findings) == (
        len(keys) == 2 or "pressure_pp_kpa" in keys
    )


@pytest.mark.parametrize(
    "text",
    [
        "# " + "x" * 200_000 + "\n" + LOG,
        '"' + "x" * 200_000 + '"\n' + LOG,
        NOTED.replace("\n0.03,3,\n", "\n0.03,3," + "y" * 200_000 + "\n"),
        NOTED.replace("\n0.00,0,\n", '\n0.00,0,"' + "y" * 200_000 + '"\n'),
        NOTED.replace("\n0.00,0,\n", "\n0.00,0," + "1" * 200_000 + "x\n"),
    ],
    ids=["comment", "quoted comment", "field", "quoted field", "digits"],
)
def test_lines_of_any_length(tmp_path: Path, text: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text(text)
    log = read_pressure_log(path)
    assert len(log.time_s) >= 399
    assert np.nanmax(log.pressure_kpa) == 49


@pytest.mark.parametrize("year", ["3024", "9999", "2262", "1677", "0001"])
@pytest.mark.parametrize("pattern", ["{}-02-01 10:00:{:02d},{}\n", "01.02.{} 10:00:{:02d},{}\n"])
def test_dates_of_any_year(tmp_path: Path, year: str, pattern: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("date,p_kpa\n" + "".join(pattern.format(year, s, s) for s in range(40)))
    log = read_pressure_log(path)
    assert log.time_s.tolist() == list(range(40))


def test_rows_with_too_few_fields_are_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(LOG + "5.0\n6.0\n")
    assert any("2 of 402 lines have too few fields" in w for w in read_pressure_log(path).warnings)
    # Without delimiters nothing says which field is missing: the row does not count.
    path.write_text("time_s p_kpa q\n" + "".join(f"{n / 100} {n % 50} 7\n" for n in range(99)) + "0.995 7\n")
    log = read_pressure_log(path)
    assert any("1 of 100 lines have too few fields and were left out" in w for w in log.warnings)
    assert len(log.time_s) == 99


def test_settings_with_a_character_of_value_0(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text('[[trials]]\ndesign="a"\nkind="dynamic"\nlog="a\\u0000.csv"\nangles="a.csv"\n')
    with pytest.raises(BendtrackError, match="a character of value 0"):
        read_study(path)


def test_matlab_structures_in_a_loop(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    for twice in (False, True):
        with h5py.File(path, "w", userblock_size=512) as file:
            group = file.create_group("a")
            for number in range(40):
                below = file.create_group(f"b{number}") if twice else group
                group["x"] = below
                if not twice:
                    break
                group["y"] = group = below
        with pytest.raises(PressureLogError, match=r"structures at most 20 deep|at most 20000 items"):
            read_pressure_log(path)


def test_results_that_ask_for_gigabytes(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name in ("time_s", "angle_deg", "angle_sd_deg"):
            file.create_dataset(name, (3 * 10**8,), "f8", chunks=(1000,))
    assert path.stat().st_size < 20_000
    with pytest.raises(ResultsError, match="got 2400 MB"):
        read_results(path)
