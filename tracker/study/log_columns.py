"""Columns of a pressure log, and which of them is the time, the pressure, the reference wave, the sync channel.

A column is taken by the name that the user gives or found by its header. Where two are possible, none is taken.
Columns are read from files by `csv_log.py` and `matlab_log.py`.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from ..errors import PressureLogError
from ..types import FloatArray
from .log_format import LogFormat
from .units import KPA_IN, PRESSURE_UNITS, SECONDS_IN, TIME_WORDS, words_of

_PRESSURE_WORDS = {"pressure", "pressures", "press", "pres", "p", "druck", "pression", "presion", "pressione"}
_REFERENCE_WORDS = {
    *("reference", "ref", "setpoint", "set", "sp", "desired", "des", "target", "command", "commanded", "cmd"),
    *("demand", "soll", "d"),
}
_SYNC_WORDS = {"sync", "synchronisation", "synchronization", "trigger", "trig", "led", "ttl", "strobe"}


@dataclass(frozen=True, eq=False)
class LogColumn:
    """One column of a log.

    Attributes
    ----------
    name : str
        Name as in the file, without its unit.
    unit : str or None
        Unit, as returned by `units.split_unit`.
    values : ndarray of float
        (M,) NaN where a cell is empty or not a number.
    is_clock : bool
        The values are seconds since 1970 (or since midnight), read from written dates or times of day.
    time : LogColumn or None
        A clock that belongs to this column alone, where the file has one (MATLAB structures).
    number : int
        Number of the column in the file, from 1.
    """

    name: str
    unit: str | None
    values: FloatArray
    is_clock: bool = False
    time: LogColumn | None = None
    number: int = 0


class ChosenColumns(NamedTuple):
    """The chosen columns of a log; None where there is none.

    Attributes
    ----------
    pressure : LogColumn
        The measured pressure.
    time : LogColumn or None
        The times of the samples.
    reference : LogColumn or None
        The reference wave.
    sync : LogColumn or None
        The sync channel.
    """

    pressure: LogColumn
    time: LogColumn | None
    reference: LogColumn | None
    sync: LogColumn | None


def choose_columns(columns: Sequence[LogColumn], log_format: LogFormat, where: str) -> ChosenColumns:
    """Pressure, time, reference and sync: those named by the user first, then by units and names.

    `where` opens messages.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    log_format : LogFormat
        The user's settings.
    where : str
        Begins error messages.

    Returns
    -------
    ChosenColumns
        The chosen columns.

    Raises
    ------
    PressureLogError
        A named column is missing, several are possible, there is no pressure, or lengths differ.
    """
    named = {
        key: named_column(columns, wanted, key, where)
        for key in ("time_column", "pressure_column", "reference_column", "sync_column")
        if (wanted := getattr(log_format, key)) is not None
    }
    left = [c for c in columns if c not in named.values()]
    pressure, time = named.get("pressure_column"), named.get("time_column")
    if time is None and not any(c.time for c in columns):
        time = time_column(left, where)
    left = [c for c in left if c is not time]
    if pressure is None:
        alike = [c for c in left if time is None or len(c.values) == len(time.values)]
        pressure = pressure_column(alike or left, where)
    if time is not None and len(time.values) != len(pressure.values):
        raise PressureLogError(
            f"{where}: expected as many times as pressures, got {len(time.values)} in '{time.name}' "
            f"and {len(pressure.values)} in '{pressure.name}'"
        )
    alike = [c for c in left if c is not pressure and len(c.values) == len(pressure.values)]
    if time is None:
        time = pressure.time or time_column(alike, where)
    elsewhere = [c for c in left if c is not pressure and c not in alike and c.time is not None]
    reference = named.get("reference_column") or reference_column([*alike, *elsewhere], where)
    sync = named.get("sync_column") or sync_column([c for c in alike if c is not reference], where)
    if sync is not None and len(sync.values) != len(pressure.values):
        raise PressureLogError(
            f"{where}: expected a sync channel of {len(pressure.values)} samples as the pressure has, "
            f"got {len(sync.values)} in '{sync.name}'"
        )
    return ChosenColumns(pressure, time, reference, sync)


def named_column(columns: Sequence[LogColumn], wanted: str | int, key: str, where: str) -> LogColumn:
    """The column that the user names, by its name (with or without the part before a dot) or its number from 1.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    wanted : str or int
        Name, or number from 1.
    key : str
        The user's setting, for messages.
    where : str
        Begins error messages.

    Returns
    -------
    LogColumn
        The column.

    Raises
    ------
    PressureLogError
        No such column, or several of that name.
    """
    if isinstance(wanted, int):
        if not 1 <= wanted <= len(columns):
            raise PressureLogError(
                f"{where}: {key}: expected a column from 1 to {len(columns)}, got {wanted}"
            )
        return columns[wanted - 1]
    for names in (
        [c.name if c.unit is None else f"{c.name} [{c.unit}]" for c in columns],
        [c.name for c in columns],
        [c.name.lower() for c in columns],
        [c.name.rpartition(".")[2].lower() for c in columns],
    ):
        looked_for = wanted if wanted in names else wanted.lower()
        found = [column for column, name in zip(columns, names, strict=True) if name == looked_for]
        if len(found) == 1:
            return found[0]
        if found:
            raise PressureLogError(
                f"{where}: {key}: expected one column called '{wanted}', got {_listed(found)}; "
                f"give its number: {key} = {found[0].number}"
            )
    close = difflib.get_close_matches(wanted, [c.name for c in columns], n=1)
    hint = f" (did you mean '{close[0]}'?)" if close else ""
    raise PressureLogError(
        f"{where}: {key}: expected one of the columns {_listed(columns)}, got '{wanted}'{hint}"
    )


def time_column(columns: Sequence[LogColumn], where: str) -> LogColumn | None:
    """The only column that is a time by its cells, its unit or its name; None where there is none.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    where : str
        Begins error messages.

    Returns
    -------
    LogColumn or None
        The column of times.

    Raises
    ------
    PressureLogError
        Several could be.
    """
    for found in (
        [c for c in columns if c.unit in SECONDS_IN],
        [c for c in columns if c.is_clock],
        [c for c in columns if _is_time(c)],
    ):
        if found:
            return _only(found, "time", where)
    return None


def pressure_column(columns: Sequence[LogColumn], where: str) -> LogColumn:
    """The only column that is a pressure by name or unit, or the only one that is not a time.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    where : str
        Begins error messages.

    Returns
    -------
    LogColumn
        The column of pressures.

    Raises
    ------
    PressureLogError
        Several could be, or none.
    """
    left = [c for c in columns if not _is_time(c)]
    named = [c for c in left if is_pressure(c) and not words_of(c.name) & (_REFERENCE_WORDS | _SYNC_WORDS)]
    if named:
        return _only(named, "pressure", where)
    if len(left) == 1:
        return left[0]
    raise PressureLogError(
        f"{where}: expected a column of pressure, found none by name among {_listed(columns)}; give pressure_column"
    )


def reference_column(columns: Sequence[LogColumn], where: str) -> LogColumn | None:
    """The only column that is the reference pressure, by its name; None where there is none.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    where : str
        Begins error messages.

    Returns
    -------
    LogColumn or None
        The column of the reference wave.

    Raises
    ------
    PressureLogError
        Several could be.
    """
    left = [c for c in columns if not _is_time(c)]
    found = [c for c in left if words_of(c.name) & (_REFERENCE_WORDS - {"d"})]
    found = found or [c for c in left if is_pressure(c) and "d" in words_of(c.name)]
    return _only(found, "reference", where) if found else None


def sync_column(columns: Sequence[LogColumn], where: str) -> LogColumn | None:
    """The only column that is a sync channel by its name; None where there is none.

    Parameters
    ----------
    columns : sequence of LogColumn
        Columns of the log.
    where : str
        Begins error messages.

    Returns
    -------
    LogColumn or None
        The column of the sync channel.

    Raises
    ------
    PressureLogError
        Several could be.
    """
    found = [c for c in columns if not _is_time(c) and words_of(c.name) & _SYNC_WORDS]
    return _only(found, "sync", where) if found else None


def _is_time(column: LogColumn) -> bool:
    named = bool(words_of(column.name) & TIME_WORDS) and column.unit not in PRESSURE_UNITS
    return column.is_clock or column.unit in SECONDS_IN or named


def is_pressure(column: LogColumn) -> bool:
    """Whether a column's unit or name says that it is a pressure, measured or reference.

    Parameters
    ----------
    column : LogColumn
        A column of a log.

    Returns
    -------
    bool
        Whether it is a pressure.
    """
    return column.unit in KPA_IN or bool(words_of(column.name) & _PRESSURE_WORDS)


def _only(found: Sequence[LogColumn], what: str, where: str) -> LogColumn:
    if len(found) > 1:
        raise PressureLogError(
            f"{where}: expected one column of {what}, got {len(found)}: {_listed(found)}; "
            f"give {what}_column, by name or by number from 1"
        )
    return found[0]


def _listed(columns: Sequence[LogColumn]) -> str:
    """Columns by number and name."""
    return ", ".join(f"{column.number} '{column.name}'" for column in columns)
