"""Pressure logs as rigs write them: CSV, MATLAB 5, MATLAB 7.3 (HDF5) and Simulink's structure with time."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
from scipy.io import savemat

from ..atomic import atomic_write_bytes, atomic_write_text
from ..types import FloatArray


def write_csv_log(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """One header row of names, then numbers; the first column (time) with more decimals."""
    pattern = ",".join(["{:.5f}"] + ["{:.4f}"] * (len(columns) - 1))
    rows = np.column_stack(list(columns.values())).tolist()
    atomic_write_text(path, "\n".join([",".join(columns), *(pattern.format(*row) for row in rows)]) + "\n")


def write_matlab_5_log(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """What `save -v6` and `-v7` write: one column vector a variable."""
    buffer = io.BytesIO()
    savemat(buffer, dict(columns), oned_as="column")
    atomic_write_bytes(path, buffer.getvalue())


def write_simulink_log(path: Path, columns: Mapping[str, FloatArray], variable: str = "log") -> None:
    """A "To Workspace" block's structure with time: fields time, signals (values, dimensions, label), blockName.

    columns : the first is the time
    """
    time_s, *values = columns.values()
    labels = list(columns)[1:]
    signals = np.zeros(
        (1, len(labels)), dtype=[("values", object), ("dimensions", object), ("label", object)]
    )
    for index, (label, value) in enumerate(zip(labels, values, strict=True)):
        signals[0, index] = (value[:, None], 1.0, label)
    buffer = io.BytesIO()
    savemat(
        buffer, {variable: {"time": time_s[:, None], "signals": signals, "blockName": "rig/To Workspace"}}
    )
    atomic_write_bytes(path, buffer.getvalue())


def write_matlab_73_log(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """What `save -v7.3` writes: HDF5 behind MATLAB's 512-byte header, column vectors as rows."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=512) as file:
        for name, values in columns.items():
            data = file.create_dataset(name, data=np.asarray(values, float)[None, :], compression="gzip")
            data.attrs["MATLAB_class"] = np.bytes_("double")
    text = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(116) + bytes(8) + b"\x00\x02IM"
    atomic_write_bytes(path, text.ljust(512, b"\x00") + buffer.getvalue()[512:])
