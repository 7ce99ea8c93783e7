"""A pandas table in HDF5 as DeepLabCut writes it, read with h5py: nothing in the file can run.

PyTables keeps lists in attributes as pickles. pandas and PyTables unpickle them, and a pickle can run any program.
Here such an attribute is parsed by `plain_pickle`, which knows lists, tuples, texts and integers and refuses all else.
What the table means is in `dlc_source.py`.
"""

from __future__ import annotations

import pickletools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ...tracker.errors import LabelError
from ...tracker.hdf5_files import Hdf5File, open_hdf5
from ...tracker.types import FloatArray

# DeepLabCut's own key; a file of another program has one table only.
_KEY = "df_with_missing"
_MAX_LEVELS = 8


@dataclass(frozen=True)
class PandasTable:
    """A table of numbers with labelled rows and columns.

    Attributes
    ----------
    names : tuple of str
        Names of the column levels.
    columns : list of tuple of str
        Label of each of the C columns, one text for each level.
    index : list of tuple of str
        Label of each of the R rows.
    values : ndarray of float
        (R, C) NaN where a cell is empty.
    """

    names: tuple[str, ...]
    columns: list[tuple[str, ...]]
    index: list[tuple[str, ...]]
    values: FloatArray


def read_pandas_table(path: Path) -> PandasTable:
    """Read the table of a file that pandas has written in its "fixed" or its "table" format.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    PandasTable
        The table.

    Raises
    ------
    LabelError
        No such file, damaged, or with a pickle of anything but lists of names.
    """
    with open_hdf5(path, LabelError, "DeepLabCut's labels in HDF5") as file:
        group = _group(file)
        kind = _text(group, "pandas_type")
        if kind == "frame":
            return _fixed(file, group)
        if kind == "frame_table":
            return _appendable(file, group)
        raise ValueError(f"expected a table of pandas, got '{kind}'")


def _group(file: Hdf5File) -> h5py.Group:
    tables = [_KEY] if _KEY in file.root else [name for name in file.root if name != "_i_table"]
    if len(tables) != 1:
        raise ValueError(f"expected one table, got {len(tables)}")
    group = file.item(file.root, tables[0])
    if not isinstance(group, h5py.Group) or "pandas_type" not in group.attrs:
        raise ValueError("expected a table of pandas, got other contents")
    return group


# --- "fixed": an array for each axis, labels by level -----------------------------------------------------


def _fixed(file: Hdf5File, group: h5py.Group) -> PandasTable:
    columns, names = _axis(file, group, "axis0")
    index, _ = _axis(file, group, "axis1")
    values = np.full((len(index), len(columns)), np.nan)
    place = {label: number for number, label in enumerate(columns)}
    if len(place) < len(columns):
        raise ValueError("expected distinct columns")
    for number in range(_whole(group, "nblocks", 1000)):
        items, _ = _axis(file, group, f"block{number}_items")
        block = file.item(group, f"block{number}_values")
        if "shape" in block.attrs:  # how PyTables stores an array without rows or columns
            continue
        block_values = _numbers(file, block)
        if not block.attrs.get("transposed", 0):
            block_values = block_values.T
        if block_values.shape != (len(index), len(items)):
            raise ValueError(f"expected values {(len(index), len(items))}, got {block_values.shape}")
        values[:, [place[label] for label in items]] = block_values
    return PandasTable(names, columns, index, values)


def _axis(file: Hdf5File, group: h5py.Group, name: str) -> tuple[list[tuple[str, ...]], tuple[str, ...]]:
    """Labels of an axis, and the names of its levels; of a MultiIndex, levels and codes are stored apart."""
    if _text(group, f"{name}_variety") != "multi":
        dataset = file.item(group, name)
        return [(label,) for label in _labels(file, dataset, group)], (_text(dataset, "name"),)
    levels, names = [], []
    for number in range(_whole(group, f"{name}_nlevels", _MAX_LEVELS)):
        dataset = file.item(group, f"{name}_level{number}")
        texts = _labels(file, dataset, group)
        codes = file.array(group, f"{name}_label{number}")
        if codes.dtype.kind not in "iu" or codes.ndim != 1 or np.any((codes < -1) | (codes >= len(texts))):
            raise ValueError(f"expected codes of {len(texts)} labels in '{name}_label{number}'")
        levels.append([texts[code] if code >= 0 else "" for code in codes.tolist()])
        names.append(_text(dataset, "name"))
    return list(zip(*levels, strict=True)), tuple(names)


def _labels(file: Hdf5File, dataset: h5py.Dataset, group: h5py.Group) -> list[str]:
    if "shape" in dataset.attrs:
        return []
    kind = _text(dataset, "kind")
    values = file.array(dataset)
    if values.ndim != 1:
        raise ValueError(f"'{dataset.name}': expected a list of labels, got {values.ndim} dimensions")
    if kind in ("string", "unicode") and values.dtype.kind == "S":
        encoding = _encoding(group)
        return [value.decode(encoding) for value in values.tolist()]
    if kind == "integer" and values.dtype.kind in "iu":
        return [str(value) for value in values.tolist()]
    raise ValueError(f"'{dataset.name}': expected labels as texts, got {values.dtype} ('{kind}')")


# --- "table": a record for each row, labels of columns as a pickled list -----------------------------------


def _appendable(file: Hdf5File, group: h5py.Group) -> PandasTable:
    table = file.item(group, "table")
    records = file.array(table)
    fields = records.dtype.names
    if records.ndim != 1 or not fields or fields[0] != "index":
        raise ValueError("expected records with an index")
    axes = plain_pickle(_bytes(group, "non_index_axes"))
    columns = _label_list(axes[0][1]) if _is_pair(axes) else []
    if not columns:
        raise ValueError("expected one list of columns")
    encoding = _encoding(group)
    if records["index"].dtype.kind != "S" or _text(table, "index_kind") != "string":
        raise ValueError("expected names of images as index")
    index: list[tuple[str, ...]] = [(value.decode(encoding),) for value in records["index"].tolist()]
    place = {label: number for number, label in enumerate(columns)}
    values = np.full((len(index), len(columns)), np.nan)
    for field in fields[1:]:
        items = _label_list(plain_pickle(_bytes(table, f"{field}_kind")))
        block = np.asarray(records[field])
        block = block.reshape(len(index), -1)
        if block.dtype.kind not in "fiu" or block.shape[1] != len(items):
            raise ValueError(
                f"'{field}': expected {len(items)} numbers a row, got {block.dtype} {block.shape}"
            )
        values[:, [place[label] for label in items]] = block
    return PandasTable(_level_names(group, len(columns[0])), columns, index, values)


def _is_pair(axes: Any) -> bool:
    return isinstance(axes, list) and len(axes) == 1 and isinstance(axes[0], tuple) and len(axes[0]) == 2


def _label_list(labels: Any) -> list[tuple[str, ...]]:
    if not isinstance(labels, list):
        raise ValueError(f"expected a list of labels, got {type(labels).__name__}")
    found: list[tuple[Any, ...]] = [label if isinstance(label, tuple) else (label,) for label in labels]
    if not all(isinstance(part, str) for label in found for part in label):
        raise ValueError("expected labels as texts")
    return found


def _level_names(group: h5py.Group, n_levels: int) -> tuple[str, ...]:
    """Names of the column levels. `info` holds them in a dictionary of dictionaries; the names lie in it as a list."""
    if n_levels == 3:
        info = _bytes(group, "info")
        if all(name in info for name in (b"scorer", b"bodyparts", b"coords")):
            return ("scorer", "bodyparts", "coords")
    return ("",) * n_levels


# --- attributes ------------------------------------------------------------------------------------------


def _bytes(item: h5py.Group | h5py.Dataset, name: str) -> bytes:
    value = item.attrs[name]
    if not isinstance(value, bytes):
        raise ValueError(f"'{name}': expected a text, got {type(value).__name__}")
    return bytes(value)


def _text(item: h5py.Group | h5py.Dataset, name: str) -> str:
    """Text of an attribute; empty where it is missing or pickled (as None is)."""
    value = item.attrs.get(name)
    if isinstance(value, str):
        return str(value)
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else ""


def _encoding(group: h5py.Group) -> str:
    encoding = _text(group, "encoding") or "utf-8"
    if encoding.lower() not in ("utf-8", "utf8", "ascii", "latin-1", "latin1", "cp1252"):
        raise ValueError(f"expected texts in UTF-8, got '{encoding[:40]}'")
    return encoding


def _whole(item: h5py.Group, name: str, largest: int) -> int:
    value = item.attrs[name]
    if not isinstance(value, int | np.integer) or not 0 < value <= largest:
        raise ValueError(f"'{name}': expected a number from 1 to {largest}, got {value!r:.40}")
    return int(value)


def _numbers(file: Hdf5File, dataset: h5py.Dataset) -> FloatArray:
    values = file.array(dataset)
    if values.dtype.kind not in "fiu" or values.ndim != 2:
        raise ValueError(f"'{dataset.name}': expected rows of numbers, got {values.dtype} {values.shape}")
    return values.astype(np.float64)


def plain_pickle(data: bytes) -> Any:
    """Parse a pickle of lists, tuples, texts, integers and None, as PyTables writes it (protocol 0).

    Nothing is unpickled: its instructions are read by `pickletools`, which runs none, and each must be one of a few.

    Parameters
    ----------
    data : bytes
        The pickle.

    Returns
    -------
    Any
        Nested lists and tuples.

    Raises
    ------
    ValueError
        It holds any other instruction, or is malformed.

    Examples
    --------
    >>> plain_pickle(b"(lp0\\n(I1\\nVx\\ntp1\\na.")
    [(1, 'x')]
    """
    stack: list[Any] = []
    known: dict[Any, Any] = {}
    for instruction, argument, _ in pickletools.genops(data):
        name = instruction.name
        if name == "MARK":
            stack.append(_MARK)
        elif name in ("LIST", "TUPLE"):
            start = len(stack) - 1 - stack[::-1].index(_MARK)
            stack[start:] = [stack[start + 1 :] if name == "LIST" else tuple(stack[start + 1 :])]
        elif name in ("INT", "LONG", "UNICODE", "STRING", "NONE"):
            stack.append(argument)
        elif name == "APPEND":
            value = stack.pop()
            if not isinstance(stack[-1], list) or value is stack[-1]:
                raise ValueError("malformed pickle")
            stack[-1].append(value)
        elif name == "PUT":
            known[argument] = stack[-1]
        elif name == "GET":
            stack.append(known[argument])
        elif name == "STOP" and len(stack) == 1:
            return stack[0]
        else:
            raise ValueError(f"expected a pickle of names, got one with the instruction {name}: not opened")
    raise ValueError("malformed pickle")


_MARK = object()
