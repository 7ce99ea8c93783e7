"""A pressure log in any format: time in s and pressure in kPa; its faults are reported, never hidden.

Columns are read from files by `csv_log.py` and `matlab_log.py`; `trial_data.py` resamples the log at the frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..errors import PressureLogError
from ..hashing import file_sha256
from ..types import BoolArray, FloatArray
from .csv_log import csv_columns
from .log_clock import order_clock, usual_step_s
from .log_columns import LogColumn, choose_columns
from .log_faults import pressure_faults
from .log_format import LogFormat
from .matlab_log import matlab_columns
from .units import KPA_IN, PRESSURE_UNITS, SECONDS_IN, factor_to_kpa, known_unit

# Without a unit, times are taken as seconds only where that gives a plausible sampling rate.
_PLAUSIBLE_HZ = (4.0, 20_000.0)
# Larger numbers are dates, not times from a start: seconds since 1970 passed this in 2001.
_EPOCH = 1e9
_EPOCH_UNITS = ((1e18, "ns"), (1e15, "us"), (1e12, "ms"), (_EPOCH, "s"))
_DAY_S = 86_400.0
_MIN_SAMPLES = 10


@dataclass(frozen=True)
class PressureLog:
    """A pressure log on its own clock.

    Attributes
    ----------
    time_s : ndarray of float
        (M,) rising times, s; where dates were logged, from the first sample.
    pressure_kpa : ndarray of float
        (M,) NaN where the log has none.
    reference_kpa : ndarray of float or None
        (M,) the reference wave, if the log holds it.
    sync : ndarray of float or None
        (M,) the sync channel as logged, if there is one.
    started_s : float or None
        Date of time 0, in seconds since 1970 (UTC, or a clock without zone), where dates were logged.
    time_sd_s : float
        Standard uncertainty of the log's own clock (coarse time resolution), s.
    saturated : ndarray of bool or None
        (M,) samples saturated at a limit of the sensor's range; None where there are none.
    warnings : tuple of str
        Warnings, a line each.
    provenance : mapping of str to Any
        JSON-ready: file, hash, columns, units, rate.
    """

    time_s: FloatArray
    pressure_kpa: FloatArray
    reference_kpa: FloatArray | None = None
    sync: FloatArray | None = None
    started_s: float | None = None
    time_sd_s: float = 0.0
    saturated: BoolArray | None = None
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)


def read_pressure_log(path: str | Path, log_format: LogFormat | None = None) -> PressureLog:
    """Read a pressure log: a text table (CSV of any delimiter and decimal sign) or a MATLAB file (v5, v7.3).

    Columns and units are taken from `log_format`, else from the headers ("P [kPa]", "pressure_psi", "t (ms)").
    Times may be numbers, written dates or times of day. Rows are sorted by time as in `log_clock`;
    gaps, repeats, clock jumps, saturation, constant and negative pressure are reported in `warnings`.

    Parameters
    ----------
    path : str or Path
        The file.
    log_format : LogFormat or None, optional
        The user's settings; None detects everything.

    Returns
    -------
    PressureLog
        The log.

    Raises
    ------
    PressureLogError
        Not a log; a column, unit or clock is missing, or several are possible (they are listed).
    """
    path, log_format = Path(path), log_format or LogFormat()
    columns, warnings = _columns_of(path)
    pressure, time, reference, sync = choose_columns(columns, log_format, str(path))
    if time is None:
        seconds, started_s = _counted(len(pressure.values), log_format, str(path)), None
    else:
        seconds, started_s, notes = _seconds(time, log_format, str(path))
        warnings += notes
    kpa, unit = _kpa(pressure, log_format, str(path))
    if np.isfinite(kpa).sum() < _MIN_SAMPLES:
        raise PressureLogError(
            f"{path}: expected at least {_MIN_SAMPLES} samples of pressure, got {np.isfinite(kpa).sum()}"
        )
    clock = order_clock(seconds, kpa)
    if len(clock.rows) < _MIN_SAMPLES:
        raise PressureLogError(f"{path}: expected at least {_MIN_SAMPLES} samples in the order of time")
    time_s, kpa = clock.time_s - log_format.lag_s, kpa[clock.rows]
    faults, saturated = pressure_faults(time_s, kpa)
    rate_hz = 1 / usual_step_s(time_s)
    if time is not None and log_format.rate_hz is not None and abs(rate_hz / log_format.rate_hz - 1) > 0.01:
        warnings.append(f"rate_hz = {log_format.rate_hz:g} was given, the log's times say {rate_hz:.5g}")
    return PressureLog(
        time_s=time_s,
        pressure_kpa=kpa,
        reference_kpa=None
        if reference is None
        else _reference_kpa(reference, pressure, seconds, log_format, path)[clock.rows],
        sync=None if sync is None else sync.values[clock.rows],
        started_s=started_s,
        # A sample's true time is uniformly distributed within one tick.
        time_sd_s=clock.tick_s / 12**0.5,
        saturated=saturated if saturated.any() else None,
        warnings=(*warnings, *clock.warnings, *faults),
        provenance={
            "name": path.name,
            "sha256": file_sha256(path),
            "samples": len(time_s),
            "rate_hz": round(rate_hz, 6),
            "columns": {
                "time": None if time is None else time.name,
                "pressure": pressure.name,
                "reference": None if reference is None else reference.name,
                "sync": None if sync is None else sync.name,
            },
            "pressure_unit": unit,
            "format": log_format.model_dump(exclude_defaults=True),
        },
    )


def _columns_of(path: Path) -> tuple[list[LogColumn], list[str]]:
    if not path.is_file():
        raise PressureLogError(
            f"expected a pressure log, got {'a folder' if path.is_dir() else 'no file'}: {path}"
        )
    if path.suffix.lower() == ".mat" or h5py.is_hdf5(path):
        return matlab_columns(path), []
    return csv_columns(path)


def _counted(n_samples: int, log_format: LogFormat, where: str) -> FloatArray:
    if log_format.rate_hz is None:
        raise PressureLogError(
            f"{where}: expected a column of time, found none by name or unit; give time_column, or rate_hz"
        )
    return np.arange(n_samples) / log_format.rate_hz


def _seconds(
    time: LogColumn, log_format: LogFormat, where: str
) -> tuple[FloatArray, float | None, list[str]]:
    """Times (N,) in s, the date of time 0 where dates were logged, and warnings."""
    values = time.values
    notes: list[str] = []
    if np.isfinite(values).sum() < 2:
        raise PressureLogError(f"{where}: column '{time.name}': expected times, got none that can be read")
    if time.is_clock:
        if np.nanmax(values) <= _DAY_S:  # a time of day
            midnight = np.concatenate([[0.0], np.cumsum(np.diff(values) < -_DAY_S / 2)])
            if midnight[-1]:
                notes.append("the log's time of day passes midnight; a day was added after it")
            values = values + _DAY_S * midnight
            return values - np.nanmin(values), None, notes
        return values - np.nanmin(values), float(np.nanmin(values)), notes
    unit = _agreed(time.unit, log_format.time_unit, "time", where, time.name)
    if unit is not None and unit not in SECONDS_IN:
        raise PressureLogError(
            f"{where}: column '{time.name}': expected a unit of time ({', '.join(SECONDS_IN)}), got '{unit}'"
        )
    first = float(np.nanmin(values))
    if unit is None:
        unit = next((unit for least, unit in _EPOCH_UNITS if first >= least), None)
    if unit is None:
        step = float(np.median(np.abs(np.diff(values[np.isfinite(values)]))))
        rate_hz = 1 / step if step > 0 else np.inf
        if not _PLAUSIBLE_HZ[0] <= rate_hz <= _PLAUSIBLE_HZ[1]:
            raise PressureLogError(
                f"{where}: column '{time.name}' names no unit, and its steps of {step:g} would be {rate_hz:g} samples "
                "a second if it were seconds; give time_unit"
            )
        unit = "s"
    factor = SECONDS_IN[unit]
    if first * factor >= _EPOCH:
        return (values - first) * factor, first * factor, notes
    return values * factor, None, notes


def _kpa(column: LogColumn, log_format: LogFormat, where: str) -> tuple[FloatArray, str]:
    unit = _agreed(column.unit, log_format.pressure_unit, "pressure", where, column.name)
    if unit is None:
        raise PressureLogError(
            f"{where}: column '{column.name}' names no unit; give pressure_unit ({', '.join(PRESSURE_UNITS)})"
        )
    factor = factor_to_kpa(unit, log_format.gain_kpa_per_v, f"{where}: column '{column.name}'")
    values = np.where(np.isfinite(column.values), column.values, np.nan)
    return values * factor + log_format.offset_kpa, unit


def _agreed(written: str | None, given: str | None, what: str, where: str, name: str) -> str | None:
    """The unit in the header or the one that the user gives; a contradiction is refused."""
    if given is None:
        return written
    if written is not None and known_unit(written) is not None and written != given:
        raise PressureLogError(
            f"{where}: column '{name}' is in {written} by its header, {what}_unit says {given}; "
            f"leave {what}_unit out, or correct the header"
        )
    return given


def _reference_kpa(
    reference: LogColumn, pressure: LogColumn, seconds: FloatArray, log_format: LogFormat, path: Path
) -> FloatArray:
    """The reference wave in kPa at the pressure's samples. Without a unit of its own it has the pressure's."""
    own = replace(reference, unit=reference.unit or pressure.unit)
    # The reference may be in kPa where the sensor's voltage was logged.
    if own.unit in KPA_IN and own.unit != pressure.unit:
        log_format = LogFormat()
    kpa, _ = _kpa(own, log_format, str(path))
    if len(kpa) == len(seconds) and (
        reference.time is None
        or pressure.time is None
        or np.array_equal(reference.time.values, pressure.time.values)
    ):
        return kpa
    if reference.time is None:
        raise PressureLogError(
            f"{path}: expected a reference of {len(seconds)} samples as the pressure has, "
            f"got {len(kpa)} in '{reference.name}'"
        )
    own_s, _, _ = _seconds(reference.time, log_format, str(path))
    return np.interp(seconds, own_s, kpa, left=np.nan, right=np.nan)
