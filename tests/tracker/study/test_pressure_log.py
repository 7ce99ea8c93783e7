"""Pressure logs as rigs write them: every form gives the same s and kPa, every fault its word."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from bendtrack.tracker.errors import PressureLogError
from bendtrack.tracker.study.log_format import LogFormat
from bendtrack.tracker.study.pressure_log import PressureLog, read_pressure_log

RATE_HZ = 400.0
TIME_S = np.arange(2400) / RATE_HZ
NOISE = 0.05 * np.random.default_rng(3).standard_normal(TIME_S.size)
# Triangles of 2 s between 0 and 40 kPa, with a sensor's noise.
WAVE_KPA = 40 * (1 - np.abs(1 - TIME_S % 2))
KPA = np.round(WAVE_KPA + NOISE, 4)


def write(path: Path, *columns: np.ndarray, header: str = "", pattern: str = "%.6f") -> Path:
    np.savetxt(path, np.column_stack(columns), fmt=pattern, delimiter=",", header=header, comments="")
    return path


def is_the_log(log: PressureLog) -> bool:
    same_time = log.time_s.shape == TIME_S.shape and np.abs(log.time_s - TIME_S).max() < 1e-5
    return bool(same_time and np.abs(log.pressure_kpa - KPA).max() < 1e-3)


# --- text tables -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "per_kpa"),
    [
        ("kPa", 1),
        ("Pa", 1000),
        ("hPa", 10),
        ("MPa", 1e-3),
        ("mbar", 10),
        ("bar", 0.01),
        ("psi", 1 / 6.894757),
        ("KPA", 1),
        ("PSI", 1 / 6.894757),
    ],
)
@pytest.mark.parametrize("header", ["Time (s),P [{}]", "time_s,pressure_{}", "t / s,Pressure ({})", "s,{}"])
def test_units_from_the_header(tmp_path: Path, unit: str, per_kpa: float, header: str) -> None:
    path = write(tmp_path / "a.csv", TIME_S, KPA * per_kpa, header=header.format(unit), pattern="%.9g")
    log = read_pressure_log(path)
    assert is_the_log(log)
    assert log.warnings == ()


@pytest.mark.parametrize(
    ("unit", "per_s"), [("ms", 1e3), ("us", 1e6), ("min", 1 / 60), ("milliseconds", 1e3)]
)
def test_units_of_time(tmp_path: Path, unit: str, per_s: float) -> None:
    path = write(tmp_path / "a.csv", TIME_S * per_s, KPA, header=f"Time [{unit}],p_kpa", pattern="%.10g")
    assert is_the_log(read_pressure_log(path))
    path = write(tmp_path / "b.csv", TIME_S * per_s, KPA, header="Time,p_kpa", pattern="%.10g")
    assert is_the_log(read_pressure_log(path, LogFormat(time_unit=unit)))


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize("decimal", [".", ","])
def test_delimiters_and_decimal_signs(tmp_path: Path, delimiter: str, decimal: str) -> None:
    if delimiter == decimal:
        pytest.skip("cannot be distinguished")
    text = write(tmp_path / "a", TIME_S, KPA, header="time_s,pressure_kpa").read_text()
    path = tmp_path / "a.csv"
    path.write_text(text.replace(",", "@").replace(".", decimal).replace("@", delimiter))
    assert is_the_log(read_pressure_log(path))


def test_preambles_unit_rows_quotes_and_encodings(tmp_path: Path) -> None:
    rows = write(tmp_path / "rows", TIME_S, KPA, KPA).read_text()
    preamble = "Logger 3000\nSerial: 17, 4\n\nStart;12.03.2024\n"
    for name, text, encoding in (
        ("preamble", f"{preamble}time_s,pressure_kpa,dummy\n{rows}", "utf-8"),
        ("units", f"Time,Pressure,dummy\n(s),(kPa),\n{rows}", "utf-8"),
        ("units2", f"Time,Pressure,dummy\ns,kPa,V\n{rows}", "utf-8"),
        ("quotes", f'"Time [s]","Pressure, gauge [kPa]","dummy"\n{rows}', "utf-8"),
        ("comment", f"# time_s,pressure_kpa,dummy\n{rows}", "utf-8"),
        ("bom", f"time_s,pressure_kpa,dummy\n{rows}", "utf-8-sig"),
        ("wide", f"time_s,pressure_kpa,dummy\n{rows}", "utf-16"),
        ("latin", f"time_s,pressure_kpa,dümmy [°C]\n{rows}", "cp1252"),
        ("trailing", "time_s,pressure_kpa,dummy,\n" + rows.replace("\n", ",\n"), "utf-8"),
        ("windows", f"time_s,pressure_kpa,dummy\n{rows}".replace("\n", "\r\n"), "utf-8"),
    ):
        path = tmp_path / f"{name}.csv"
        path.write_bytes(text.encode(encoding))
        log = read_pressure_log(path)
        assert is_the_log(log), name
        assert log.warnings == (), name


@pytest.mark.parametrize(
    "stamp",
    [
        "%Y-%m-%dT%H:%M:%S.{ms:03d}Z",
        "%Y-%m-%d %H:%M:%S.{ms:03d}",
        "%d.%m.%Y %H:%M:%S,{ms:03d}",
        "%m/%d/%Y %H:%M:%S.{ms:03d}",
        "%Y.%m.%d %H:%M:%S.{ms:03d}",
        "%H:%M:%S.{ms:03d}",
    ],
)
def test_written_dates_and_times_of_day(tmp_path: Path, stamp: str) -> None:
    times = np.arange(3000) * 0.002  # whole ms
    begin = np.datetime64("2024-05-17T10:59:58")
    lines = ["timestamp;P (kPa)"]
    for time_s in times:
        ms = round(time_s * 1000)
        moment = (begin + np.timedelta64(ms // 1000, "s")).item()
        lines.append(f"{moment.strftime(stamp).format(ms=ms % 1000)};{20 * time_s:.3f}")
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    log = read_pressure_log(path)
    np.testing.assert_allclose(log.time_s, times, atol=1e-6)
    np.testing.assert_allclose(log.pressure_kpa, 20 * times, atol=1e-3)
    assert log.started_s == (None if stamp.startswith("%H") else 1_715_943_598)


def test_time_of_day_past_midnight(tmp_path: Path) -> None:
    seconds = 86_399 + np.arange(400) * 0.01
    clock = [f"{int(s) // 3600 % 24:02d}:{int(s) // 60 % 60:02d}:{s % 60:06.3f}" for s in seconds]
    path = tmp_path / "a.csv"
    path.write_text("time,p_kpa\n" + "\n".join(f"{c},{n}" for n, c in enumerate(clock)))
    log = read_pressure_log(path)
    np.testing.assert_allclose(log.time_s, seconds - 86_399, atol=1e-6)
    assert any("midnight" in warning for warning in log.warnings)


@pytest.mark.parametrize(("unit", "per_s"), [("s", 1), ("ms", 1e3), ("us", 1e6)])
def test_seconds_since_1970(tmp_path: Path, unit: str, per_s: float) -> None:
    stamps = (1_715_943_598 + TIME_S) * per_s
    log = read_pressure_log(
        write(tmp_path / "a.csv", stamps, KPA, header="timestamp,p_kpa", pattern="%.6f"), LogFormat()
    )
    assert is_the_log(log)
    assert log.started_s == pytest.approx(1_715_943_598)


def test_a_log_without_times(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", KPA, header="pressure_kpa")
    with pytest.raises(PressureLogError, match=r"column of time.*rate_hz"):
        read_pressure_log(path)
    assert is_the_log(read_pressure_log(path, LogFormat(rate_hz=RATE_HZ)))


def test_a_voltage_needs_its_gain(tmp_path: Path) -> None:
    # 0.5 V at rest, 40 mV for each kPa.
    path = write(tmp_path / "a.csv", TIME_S, 0.5 + 0.04 * KPA, header="time_s,pressure_V", pattern="%.7f")
    with pytest.raises(PressureLogError, match="gain_kpa_per_v"):
        read_pressure_log(path)
    assert is_the_log(read_pressure_log(path, LogFormat(gain_kpa_per_v=25, offset_kpa=-12.5)))
    path = write(tmp_path / "b.csv", TIME_S, KPA, header="t_s,p_kpa")
    with pytest.raises(PressureLogError, match="gain_kpa_per_v is for"):
        read_pressure_log(path, LogFormat(gain_kpa_per_v=2))


def test_a_lag_is_taken_off_the_times(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", TIME_S, KPA, header="t_s,p_kpa")
    log = read_pressure_log(path, LogFormat(lag_s=0.032))
    np.testing.assert_allclose(log.time_s, TIME_S - 0.032, atol=1e-6)


def test_reference_and_sync_are_found_and_converted(tmp_path: Path) -> None:
    trigger = (TIME_S > 1).astype(float)
    columns = (TIME_S, KPA / 6.894757, WAVE_KPA / 6.894757, trigger)
    log = read_pressure_log(write(tmp_path / "a.csv", *columns, header="t_s,P (psi),P_ref (psi),LED"))
    assert is_the_log(log)
    assert log.reference_kpa is not None
    np.testing.assert_allclose(log.reference_kpa, WAVE_KPA, atol=1e-4)
    assert log.sync is not None
    np.testing.assert_array_equal(log.sync, trigger)


def test_a_reference_in_kpa_next_to_a_voltage(tmp_path: Path) -> None:
    columns = (TIME_S, KPA / 25, WAVE_KPA)
    path = write(tmp_path / "a.csv", *columns, header="t_s,P (V),setpoint (kPa)", pattern="%.7f")
    log = read_pressure_log(path, LogFormat(gain_kpa_per_v=25))
    assert is_the_log(log)
    assert log.reference_kpa is not None
    np.testing.assert_allclose(log.reference_kpa, WAVE_KPA, atol=1e-4)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time_s,pressure_kpa,pressure_kpa", "column of pressure, got 2: 2 'pressure', 3 'pressure'"),
        ("time_s,P1 (kPa),P2 (kPa)", "column of pressure, got 2: 2 'P1', 3 'P2'; give pressure_column"),
        ("time_s,time_ms,P (kPa)", "column of time, got 2: 1 'time', 2 'time'; give time_column"),
        ("time_s,foo,bar2", "column of pressure, found none by name among 2 'foo', 3 'bar2'"),
        ("time_s,pressure,x", "column 'pressure' names no unit; give pressure_unit"),
        ("time_s,pressure (apples),x", "expected a pressure unit .*got 'apples'"),
        ("time_s,pressure (s),x", "column of time, got 2: 1 'time', 2 'pressure'"),
        ("time (kg),pressure_kpa,x", "expected a unit of time .*got 'kg'"),
        ("time_s,pressure_kpa", "as many fields in the rows as names in the header, got 3 and 2"),
    ],
)
def test_what_is_not_clear_is_refused(tmp_path: Path, header: str, message: str) -> None:
    with pytest.raises(PressureLogError, match=message):
        read_pressure_log(write(tmp_path / "a.csv", TIME_S, KPA, KPA, header=header))


def test_columns_by_name_and_number(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", TIME_S, KPA * 2, KPA, header="time_s,pressure_kpa,pressure_kpa")
    with pytest.raises(PressureLogError, match=r"one column called 'pressure', got 2.*pressure_column = 2"):
        read_pressure_log(path, LogFormat(pressure_column="pressure"))
    assert is_the_log(read_pressure_log(path, LogFormat(pressure_column=3)))
    with pytest.raises(PressureLogError, match="from 1 to 3, got 4"):
        read_pressure_log(path, LogFormat(pressure_column=4))
    path = write(tmp_path / "b.csv", KPA, TIME_S, header="chan A,when")
    asked = LogFormat(pressure_column="Chan A", time_column="when", time_unit="s", pressure_unit="kPa")
    assert is_the_log(read_pressure_log(path, asked))
    with pytest.raises(PressureLogError, match=r"got 'chanA' .did you mean 'chan A'"):
        read_pressure_log(path, LogFormat(pressure_column="chanA"))
    path = write(tmp_path / "c.csv", TIME_S, KPA)
    assert is_the_log(
        read_pressure_log(path, LogFormat(time_column=1, pressure_column=2, pressure_unit="kPa"))
    )


def test_a_unit_that_contradicts_the_header_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", TIME_S, KPA, header="time_s,p_kpa")
    with pytest.raises(PressureLogError, match="is in kPa by its header, pressure_unit says psi"):
        read_pressure_log(path, LogFormat(pressure_unit="psi"))


def test_milliseconds_are_not_taken_for_seconds(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", TIME_S * 1000, KPA, header="time,p_kpa")
    with pytest.raises(PressureLogError, match=r"names no unit.*0\.4 samples a second.*time_unit"):
        read_pressure_log(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"hello\nworld\n", "found no line of numbers"),
        (bytes(range(256)) * 9, "text table or a MATLAB file"),
        (b"time_s,p_kpa\n0,1\n1,2\n2,3\n", "at least 10 samples"),
        (b"time_s,p_kpa\n" + b"n/a,1\n" * 50, "column 'time': expected times, got none that can be read"),
    ],
)
def test_no_log_at_all(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(PressureLogError, match=message):
        read_pressure_log(path)
    with pytest.raises(PressureLogError, match="got no file"):
        read_pressure_log(tmp_path / "none.csv")


# --- MATLAB ----------------------------------------------------------------------------------------------


def simulink() -> dict[str, Any]:
    signals = np.zeros((1, 2), dtype=[("values", object), ("dimensions", object), ("label", object)])
    signals[0, 0] = (KPA[:, None], 1.0, "pressure (kPa)")
    signals[0, 1] = (WAVE_KPA[:, None], 1.0, "reference (kPa)")
    return {"out": {"time": TIME_S[:, None], "signals": signals, "blockName": "rig/To Workspace"}}


MATLAB_5: dict[str, tuple[Callable[[], dict[str, Any]], dict[str, Any]]] = {
    "columns": (lambda: {"t": TIME_S[:, None], "pressure_kPa": KPA[:, None], "gain": 3.0}, {}),
    "rows": (lambda: {"t": TIME_S, "pressure_kPa": KPA, "note": "run 3"}, {}),
    "single precision": (lambda: {"t": TIME_S, "pressure_kPa": KPA.astype(np.float32)}, {}),
    "matrix": (lambda: {"data_kPa": np.stack([TIME_S, KPA], axis=1)}, {}),
    "to file": (lambda: {"ans": np.stack([TIME_S, KPA])}, {"pressure_unit": "kPa"}),
    "structure": (lambda: {"run": {"time": TIME_S, "p_kPa": KPA, "operator": "me"}}, {}),
    "simulink": (simulink, {}),
    "one signal": (
        lambda: {"p": {"time": TIME_S, "signals": {"values": KPA, "label": "pressure"}}},
        {"pressure_unit": "kPa"},
    ),
    "no time": (
        lambda: {"p": {"time": [], "signals": {"values": KPA, "label": "pressure_kpa"}}},
        {"rate_hz": RATE_HZ},
    ),
    "timeseries": (
        lambda: {"p": {"Name": "pressure", "Time": TIME_S, "Data": KPA, "DataInfo": {"Units": "kPa"}}},
        {},
    ),
}


@pytest.mark.parametrize("form", MATLAB_5)
def test_matlab_5(tmp_path: Path, form: str) -> None:
    make, asked = MATLAB_5[form]
    savemat(tmp_path / "a.mat", make())
    log = read_pressure_log(tmp_path / "a.mat", LogFormat(**asked))
    assert is_the_log(log)
    assert log.warnings == ()


def test_simulink_reference_comes_along(tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", simulink())
    reference_kpa = read_pressure_log(tmp_path / "a.mat").reference_kpa
    assert reference_kpa is not None
    np.testing.assert_allclose(reference_kpa, WAVE_KPA)


def test_matlab_signals_on_clocks_of_their_own(tmp_path: Path) -> None:
    slow_s = np.arange(61) / 10
    slow_kpa = 40 * (1 - np.abs(1 - slow_s % 2))
    runs = {
        "pressure": {"Time": TIME_S, "Data": KPA, "DataInfo": {"Units": "kPa"}},
        "reference": {"Time": slow_s, "Data": slow_kpa, "DataInfo": {"Units": "kPa"}},
    }
    savemat(tmp_path / "a.mat", runs)
    log = read_pressure_log(tmp_path / "a.mat")
    assert is_the_log(log)
    assert log.reference_kpa is not None
    np.testing.assert_allclose(log.reference_kpa, WAVE_KPA, atol=1e-6)


def put(file: h5py.File, parent: h5py.Group, name: str, value: Any) -> None:
    """Write a value as MATLAB's save -v7.3 does: columns first, structures as groups, lists by reference."""
    if isinstance(value, dict):
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, item in value.items():
            put(file, group, key, item)
    elif isinstance(value, str):
        data = parent.create_dataset(name, data=np.array([[ord(c)] for c in value], np.uint16))
        data.attrs["MATLAB_class"] = np.bytes_("char")
    elif isinstance(value, list):  # a structure array: each field a list of references
        refs = file.require_group("#refs#")
        group = parent.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for key in value[0]:
            references = []
            for number, item in enumerate(value):
                put(file, refs, f"{name}{key}{number}", item[key])
                references.append(refs[f"{name}{key}{number}"].ref)
            group.create_dataset(key, data=np.array([references], dtype=h5py.ref_dtype).T)
    else:
        data = parent.create_dataset(name, data=np.atleast_2d(np.asarray(value, float)))
        data.attrs["MATLAB_class"] = np.bytes_("double")


def write_hdf5(path: Path, variables: dict[str, Any]) -> Path:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            put(file, file, name, value)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize(
    "variables",
    [
        {"t": TIME_S, "pressure_kPa": KPA, "gain": 3.0},
        {"run": {"time": TIME_S, "p_kPa": KPA, "operator": "me"}},
        {
            "out": {
                "time": TIME_S,
                "signals": [
                    {"values": KPA, "label": "pressure (kPa)"},
                    {"values": WAVE_KPA, "label": "reference (kPa)"},
                ],
                "blockName": "x",
            }
        },
        {"out": {"time": TIME_S, "signals": {"values": KPA, "label": "pressure_kPa"}}},
    ],
    ids=["vectors", "structure", "simulink", "one signal"],
)
def test_matlab_73(tmp_path: Path, variables: dict[str, Any]) -> None:
    log = read_pressure_log(write_hdf5(tmp_path / "a.mat", variables))
    assert is_the_log(log)
    assert log.warnings == ()


def test_matlab_files_that_hold_no_log(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    savemat(path, {"note": "nothing", "x": 3.0})
    with pytest.raises(PressureLogError, match="expected vectors of samples, found note, x"):
        read_pressure_log(path)
    savemat(path, {"t": TIME_S, "a_kPa": KPA, "b_kPa": KPA})
    with pytest.raises(PressureLogError, match="expected one column of pressure, got 2: 2 'a', 3 'b'"):
        read_pressure_log(path)
    savemat(path, {"t": TIME_S[:-5], "p_kPa": KPA})
    with pytest.raises(PressureLogError, match="as many times as pressures, got 2395 in 't' and 2400 in 'p'"):
        read_pressure_log(path)
    path.write_bytes(b"MATLAB 5.0 MAT-file, but cut off")
    with pytest.raises(PressureLogError, match="cannot be read as a MATLAB file"):
        read_pressure_log(path)
    with h5py.File(path, "w") as file:
        file.create_dataset("p", data=np.zeros((1, 6), np.uint32)).attrs["MATLAB_object_decode"] = 3
    with pytest.raises(PressureLogError, match=r"'p' is a MATLAB object .*save it as a structure"):
        read_pressure_log(path)


# --- what is wrong with a log -----------------------------------------------------------------------------


def read(folder: Path, time_s: np.ndarray, kpa: np.ndarray) -> PressureLog:
    return read_pressure_log(write(folder / "a.csv", time_s, kpa, header="time_s,pressure_kpa"))


def assert_warnings(log: PressureLog, *words: str) -> None:
    """The log's warnings are these, one each, and no others."""
    assert len(log.warnings) == len(words), log.warnings
    for word in words:
        assert any(word in warning for warning in log.warnings), (word, log.warnings)


def test_a_sound_log_is_told_nothing(tmp_path: Path) -> None:
    assert_warnings(read(tmp_path, TIME_S, KPA))


def test_a_gap_stays_a_gap(tmp_path: Path) -> None:
    kept = (TIME_S < 2.3) | (TIME_S > 2.7)
    log = read(tmp_path, TIME_S[kept], KPA[kept])
    assert_warnings(log, "gap: no sample for 0.40")
    np.testing.assert_allclose(log.time_s, TIME_S[kept], atol=1e-6)
    np.testing.assert_allclose(log.pressure_kpa, KPA[kept])


def test_a_gap_over_a_peak_is_no_clock_jump(tmp_path: Path) -> None:
    kept = (TIME_S < 0.8) | (TIME_S > 1.2)  # the same pressure on both sides, the slope turned
    assert_warnings(read(tmp_path, TIME_S[kept], KPA[kept]), "gap: no sample for 0.40")


def test_empty_cells_stay_missing(tmp_path: Path) -> None:
    rows = [f"{t:.4f},{p}" for t, p in zip(TIME_S, KPA, strict=True)]
    rows[100], rows[200], rows[300] = "0.2500,", "0.5000,ERR", "0.7500,1,2,3"
    path = tmp_path / "a.csv"
    path.write_text("time_s,pressure_kpa\n" + "\n".join(rows))
    log = read_pressure_log(path)
    assert np.flatnonzero(np.isnan(log.pressure_kpa)).tolist() == [100, 200]
    assert 0.75 not in log.time_s
    assert_warnings(
        log,
        "column 'pressure': 1 cells are no numbers, the first 'ERR'",
        "1 of 2400 lines have too many fields",
        "gap: 2 of 2399 samples",
        "gap: no sample for 0.005 s after 0.748 s",
    )


def test_a_log_in_reverse_is_turned(tmp_path: Path) -> None:
    log = read(tmp_path, TIME_S[::-1], KPA[::-1])
    assert is_the_log(log)
    assert_warnings(log, "runs backward in time")


def test_swapped_rows_are_sorted(tmp_path: Path) -> None:
    order = np.arange(TIME_S.size)
    order[[50, 51, 900, 901]] = order[[51, 50, 901, 900]]
    log = read(tmp_path, TIME_S[order], KPA[order])
    assert is_the_log(log)
    assert_warnings(log, "4 rows stand out of the order of time")


def test_repeated_rows_are_left_out(tmp_path: Path) -> None:
    rows = np.sort(np.concatenate([np.arange(TIME_S.size), [10, 700, 701]]))
    log = read(tmp_path, TIME_S[rows], KPA[rows])
    assert is_the_log(log)
    assert_warnings(log, "3 samples repeat the row before")


def test_a_clock_set_back_ends_the_segment(tmp_path: Path) -> None:
    log = read(tmp_path, np.where(TIME_S > 4, TIME_S - 0.5, TIME_S), KPA)
    assert_warnings(log, "clock jump: the log's time goes back by 0.498 s after 4.000 s")
    assert log.time_s[-1] == pytest.approx(4.0)
    np.testing.assert_allclose(log.pressure_kpa, KPA[TIME_S <= 4])


def test_a_clock_set_forward_is_no_gap(tmp_path: Path) -> None:
    log = read(tmp_path, np.where(TIME_S > 4.5, TIME_S + 0.3, TIME_S), KPA)  # in the middle of a slope
    assert_warnings(log, "clock jump: the log's time leaps ahead by 0.303 s after 4.500 s")
    assert log.time_s[-1] == pytest.approx(4.5)


def test_two_runs_in_one_file(tmp_path: Path) -> None:
    log = read(tmp_path, np.concatenate([TIME_S[:1000], TIME_S]), np.concatenate([KPA[:1000], KPA]))
    assert is_the_log(log)
    assert_warnings(log, "clock jump: the log's time goes back by 2.498 s")


def test_a_coarse_clock_makes_the_shift_unsure(tmp_path: Path) -> None:
    log = read(tmp_path, np.floor(TIME_S / 0.016) * 0.016, KPA)
    assert_warnings(log, "clock ticks every 0.016 s")
    assert log.time_sd_s == pytest.approx(0.016 / 12**0.5)
    assert np.all(np.diff(log.time_s) > 0.015)


def test_saturation_above_and_below(tmp_path: Path) -> None:
    log = read(tmp_path, TIME_S, np.clip(KPA, 2.0, 35.0))
    assert_warnings(log, "saturation: the upper end, 35 kPa", "saturation: the lower end, 2 kPa")
    assert log.pressure_kpa.max() == 35.0


def test_a_staircase_without_noise_is_not_saturated(tmp_path: Path) -> None:
    steps_kpa = 5 * np.minimum(np.floor(TIME_S), 5 - np.abs(np.floor(TIME_S) - 5))
    assert_warnings(read(tmp_path, TIME_S, steps_kpa))


def test_constant_pressure(tmp_path: Path) -> None:
    assert_warnings(read(tmp_path, TIME_S, 20 + NOISE), "constant pressure: it stays between 19.8")
    assert_warnings(read(tmp_path, TIME_S, np.full_like(KPA, 20.0)), "constant pressure")


def test_negative_absolute_and_implausible_pressure(tmp_path: Path) -> None:
    assert_warnings(read(tmp_path, TIME_S, KPA - 10), "negative pressure: it goes down to -")
    assert_warnings(read(tmp_path, TIME_S, -KPA), "negative pressure")
    assert_warnings(read(tmp_path, TIME_S, KPA + 101.3), "absolute pressure")
    assert_warnings(read(tmp_path, TIME_S, KPA * 1000), "implausible pressure")
    assert_warnings(read(tmp_path, TIME_S, KPA - 0.4))  # a sensor's offset is none of these


def test_a_sensor_slower_than_the_log(tmp_path: Path) -> None:
    log = read(tmp_path, TIME_S, np.repeat(KPA[::8], 8))
    assert_warnings(
        log, "held values: the pressure changes at every 8th sample only, every 20 ms; it is 8.75 ms late"
    )


def test_a_rate_that_the_times_contradict(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", TIME_S, KPA, header="time_s,pressure_kpa")
    assert_warnings(
        read_pressure_log(path, LogFormat(rate_hz=100)), "rate_hz = 100 was given, the log's times say 400"
    )
