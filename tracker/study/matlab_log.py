"""MATLAB files to columns: v5 (scipy) and v7.3 (HDF5); arrays, structures, Simulink's structure with time.

The meaning of the columns is determined in `log_columns.py` and `pressure_log.py`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io

from ..errors import PressureLogError, reason
from ..hdf5_files import Hdf5File, open_hdf5
from ..types import FloatArray
from .log_columns import LogColumn
from .units import TIME_WORDS, known_unit, split_unit, words_of

# Shorter vectors are settings, not recordings.
_MIN_SAMPLES = 3
# Structures in structures, and characters of a text: beyond, a file is damaged or made to keep a reader busy.
_MAX_DEPTH = 20
_MAX_CHARACTERS = 100_000
_MAX_COLUMNS = 10_000
# Bytes of a v5 file, and how much larger than its file a variable may say that it is (they may be compressed).
_MAX_V5_BYTES = 2**31
_MIN_V5_BYTES = 2**26
_V5_EXPANSION = 200


def matlab_columns(path: Path) -> list[LogColumn]:
    """Every recording in a .mat file, named by its path in the file ("out.pressure", "simout.signals[2]").

    Known forms: vectors and matrices (samples along the longer side; a first column that rises evenly is the time
    of the others); structures of vectors; Simulink's "structure with time" (fields time and signals, each
    signal with values and perhaps a label) and structures made from a timeseries (fields Time and Data).

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    list of LogColumn
        The columns, numbered from 1.

    Raises
    ------
    PressureLogError
        Not a MATLAB file, damaged, or nothing in it but MATLAB objects, which only MATLAB can read.
    """
    variables = _read_hdf5(path) if h5py.is_hdf5(path) else _read_v5(path)
    objects = [name for name, value in variables.items() if value is _OBJECT]
    columns = [c for name, value in variables.items() for c in _columns(name, value)]
    if not columns and objects:
        raise PressureLogError(
            f"{path}: '{objects[0]}' is a MATLAB object (a timeseries or Dataset), which only MATLAB reads; there, "
            "save it as a structure: s.time = p.Time; s.pressure = p.Data; save('log.mat', 's')"
        )
    if not columns:
        raise PressureLogError(
            f"{path}: expected vectors of samples, found {', '.join(variables) or 'nothing'}"
        )
    return [replace(column, number=number) for number, column in enumerate(columns, 1)]


_OBJECT = object()


def _read_v5(path: Path) -> dict[str, Any]:
    try:
        _check_v5_size(path)
        variables = scipy.io.loadmat(path, simplify_cells=True)
    except NotImplementedError as error:
        raise PressureLogError(
            f"{path}: a MATLAB file of a version that cannot be read ({reason(error)})"
        ) from error
    except Exception as error:  # scipy raises many kinds of errors on damaged files
        raise PressureLogError(f"{path}: cannot be read as a MATLAB file ({reason(error)})") from error
    return {
        str(name): _OBJECT if _is_object(value) else value
        for name, value in variables.items()
        if not str(name).startswith("__") or _is_object(value)
    }


def _check_v5_size(path: Path) -> None:
    """Refuse variables that would take far more memory than their file, from the headers alone.

    Raises
    ------
    ValueError
        They would.
    """
    limit = min(_MAX_V5_BYTES, max(_MIN_V5_BYTES, _V5_EXPANSION * path.stat().st_size))
    wanted = sum(8 * math.prod(shape) for _, shape, _ in scipy.io.whosmat(path))
    if wanted > limit:
        raise ValueError(f"expected at most {limit / 1e6:.0f} MB of variables, got {wanted / 1e6:.0f} MB")


def _is_object(value: Any) -> bool:
    return isinstance(value, scipy.io.matlab.MatlabOpaque | scipy.io.matlab.MatlabFunction) or (
        isinstance(value, np.ndarray) and value.dtype.names == ("s0", "s1", "s2", "arr")
    )


def _read_hdf5(path: Path) -> dict[str, Any]:
    with open_hdf5(path, PressureLogError, "a MATLAB v7.3 file") as file:
        return {
            name: _hdf5_value(file, file.item(file.root, name), 0)
            for name in file.root
            if not name.startswith("#")
        }


def _hdf5_value(file: Hdf5File, item: h5py.Group | h5py.Dataset, depth: int) -> Any:
    """A v7.3 variable as loadmat(simplify_cells=True) would give a v5 one."""
    if depth > _MAX_DEPTH:
        raise ValueError(f"expected structures at most {_MAX_DEPTH} deep, got deeper ones")
    if "MATLAB_object_decode" in item.attrs:
        return _OBJECT
    if isinstance(item, h5py.Group):
        fields = {name: _hdf5_value(file, file.item(item, name), depth + 1) for name in item}
        lists = [value for value in fields.values() if isinstance(value, list)]
        if fields and len(lists) == len(fields) and len({len(value) for value in lists}) == 1:
            # A structure array holds a list for each field.
            return [dict(zip(fields, values, strict=True)) for values in zip(*lists, strict=True)]
        return fields
    if not isinstance(item, h5py.Dataset):
        raise ValueError(f"'{item.name}': expected an array or a structure, got a {type(item).__name__}")
    if item.attrs.get("MATLAB_empty", 0):
        return np.empty(0)
    values = file.array(item)
    if item.dtype == h5py.ref_dtype:
        references = np.ravel(values, order="F")
        return [_hdf5_value(file, file.counted(item.file[reference]), depth + 1) for reference in references]
    if item.attrs.get("MATLAB_class") == b"char":
        return _characters(values)
    return values.T.squeeze()  # MATLAB stores columns first


def _characters(values: np.ndarray) -> str:
    """MATLAB's characters are UTF-16 codes; long ones are data, not names."""
    if values.dtype.kind not in "iu" or values.size > _MAX_CHARACTERS:
        return ""
    return values.ravel(order="F").astype("<u2").tobytes().decode("utf-16-le", errors="replace")


def _columns(name: str, value: Any) -> Iterator[LogColumn]:
    if isinstance(value, Mapping):
        yield from _structure(name, value)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for number, item in enumerate(np.ravel(value) if isinstance(value, np.ndarray) else value, 1):
            yield from _columns(f"{name}[{number}]", item)
    else:
        yield from _array(name, value, None)


def _structure(name: str, fields: Mapping[str, Any]) -> Iterator[LogColumn]:
    named = {field.lower(): value for field, value in fields.items()}
    if "signals" in named:
        yield from _simulink(name, named)
    elif "time" in named and "data" in named:
        unit = _text_in(named.get("datainfo"), "units")
        time = _vector("Time", named["time"], _text_in(named.get("timeinfo"), "units") or "s")
        label = named.get("name")
        for column in _array(label if isinstance(label, str) and label else name, named["data"], time):
            yield LogColumn(column.name, column.unit or unit, column.values, time=column.time)
    else:
        found = [c for field, value in fields.items() for c in _columns(f"{name}.{field}", value)]
        times = [c for c in found if words_of(c.name.rpartition(".")[2]) & TIME_WORDS and c.time is None]
        for column in found:
            own = column.time
            if own is None and len(times) == 1 and column is not times[0]:
                own = times[0] if len(times[0].values) == len(column.values) else None
            yield LogColumn(column.name, column.unit, column.values, time=own)


def _simulink(name: str, fields: Mapping[str, Any]) -> Iterator[LogColumn]:
    """Simulink's "structure with time"; one saved as plain "structure" has an empty time."""
    time = _vector("time", fields.get("time"), "s")
    signals = fields["signals"]
    several = signals if isinstance(signals, list | np.ndarray) else [signals]
    for number, signal in enumerate(several, 1):
        if not isinstance(signal, Mapping) or "values" not in signal:
            continue
        own = f"{name}.signals[{number}]" if len(several) > 1 else name
        label = signal.get("label")
        yield from _array(label if isinstance(label, str) and label else own, signal["values"], time)


def _array(name: str, value: Any, time: LogColumn | None) -> Iterator[LogColumn]:
    """Columns of a vector or a matrix; of a matrix without a time, the first if it rises evenly is the time."""
    values = np.squeeze(np.asarray(value))
    if values.dtype.kind not in "fiub" or values.ndim not in (1, 2) or max(values.shape) < _MIN_SAMPLES:
        return
    stem, unit = split_unit(name)
    numbers = values.astype(float)
    if numbers.ndim == 1:
        yield LogColumn(stem, unit, numbers, time=_fitting(time, len(numbers)))
        return
    if numbers.shape[0] < numbers.shape[1] and not (
        time is not None and len(time.values) == numbers.shape[0]
    ):
        numbers = numbers.T
    first = 0
    if time is None and _rises_evenly(numbers[:, 0]):
        time, first = LogColumn(f"{stem}[1]", None, numbers[:, 0]), 1
    for number in range(first, numbers.shape[1]):
        column = np.ascontiguousarray(numbers[:, number])
        yield LogColumn(f"{stem}[{number + 1}]", unit, column, time=_fitting(time, len(column)))


def _fitting(time: LogColumn | None, n_samples: int) -> LogColumn | None:
    return time if time is not None and len(time.values) == n_samples else None


def _rises_evenly(values: FloatArray) -> bool:
    steps = np.diff(values)
    return bool(np.all(steps > 0) and np.ptp(steps) < 0.01 * np.median(steps))


def _vector(name: str, value: Any, unit: str) -> LogColumn | None:
    if value is None or isinstance(value, Mapping | str):
        return None
    values = np.atleast_1d(np.squeeze(np.asarray(value)))
    if values.dtype.kind not in "fiu" or values.ndim != 1 or len(values) < _MIN_SAMPLES:
        return None
    return LogColumn(name, known_unit(unit) or unit, values.astype(float))


def _text_in(value: Any, key: str) -> str | None:
    if not isinstance(value, Mapping):
        return None
    text = {field.lower(): item for field, item in value.items()}.get(key)
    return (known_unit(text) or text) if isinstance(text, str) and text else None
