"""DeepLabCut's .h5 is read with h5py: in every form that it has, and nothing in it can run."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from bendtrack.labeling.interop.dlc_source import read_h5_table
from bendtrack.labeling.interop.pandas_hdf5 import plain_pickle, read_pandas_table
from bendtrack.tracker.errors import LabelError

COLUMNS = [("anna", part, coord) for part in ("base 1", "tip") for coord in ("x", "y")]
VALUES = np.array([[1.5, 2.25, 3.0, 4.0], [5.0, 6.0, np.nan, np.nan]])
IMAGES = ["img00000.png", "img00007.png"]


def _multi(group: h5py.Group, name: str, labels: list[tuple[str, ...]], names: tuple[bytes, ...]) -> None:
    group.attrs[f"{name}_variety"] = np.bytes_("multi")
    group.attrs[f"{name}_nlevels"] = np.int64(len(names))
    for number, (parts, title) in enumerate(zip(zip(*labels, strict=True), names, strict=True)):
        levels = sorted(set(parts))
        level = group.create_dataset(f"{name}_level{number}", data=np.array(levels, dtype="S"))
        level.attrs["kind"], level.attrs["name"] = np.bytes_("string"), np.bytes_(title)
        group[f"{name}_label{number}"] = np.array([levels.index(part) for part in parts], np.int8)


def fixed(path: Path) -> None:
    """As pandas 1 to 3 write it in the format "fixed": DeepLabCut 2.2 and later."""
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["encoding"] = np.bytes_("frame"), np.bytes_("UTF-8")
        group.attrs["nblocks"] = np.int64(1)
        titles = (b"scorer", b"bodyparts", b"coords")
        _multi(group, "axis0", COLUMNS, titles)
        _multi(group, "block0_items", COLUMNS, titles)
        _multi(group, "axis1", [("labeled-data", "arm", image) for image in IMAGES], (b"N.", b"N.", b"N."))
        values = group.create_dataset("block0_values", data=VALUES)
        values.attrs["transposed"] = np.uint8(1)


def table(path: Path) -> None:
    """As pandas writes it in the format "table": DeepLabCut 2.0 and 2.1, with the columns as pickles."""
    labels = pickle.dumps(COLUMNS, 0)
    with h5py.File(path, "w") as file:
        group = file.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["encoding"] = np.bytes_("frame_table"), np.bytes_("UTF-8")
        group.attrs["non_index_axes"] = np.bytes_(pickle.dumps([(1, COLUMNS)], 0))
        group.attrs["info"] = np.bytes_(pickle.dumps({1: {"names": ["scorer", "bodyparts", "coords"]}}, 0))
        rows = np.zeros(2, np.dtype([("index", "S29"), ("values_block_0", "f8", (4,))]))
        rows["index"] = [f"labeled-data\\arm\\{image}".encode() for image in IMAGES]
        rows["values_block_0"] = VALUES
        records = group.create_dataset("table", data=rows)
        records.attrs["index_kind"] = np.bytes_("string")
        records.attrs["values_block_0_kind"] = np.bytes_(labels)


FORMS: dict[str, Callable[[Path], None]] = {"fixed": fixed, "table": table}


@pytest.mark.parametrize("form", FORMS)
def test_labels_are_read_without_pytables(tmp_path: Path, form: str) -> None:
    path = tmp_path / "CollectedData_anna.h5"
    FORMS[form](path)
    labels = read_h5_table(path)
    assert labels.bodyparts == ("base 1", "tip")
    assert [(row.video, row.image) for row in labels.rows] == [("arm", image) for image in IMAGES]
    assert labels.rows[0].point("tip") == (3.0, 4.0)
    assert labels.rows[1].cells == {("base 1", "x"): "5.0", ("base 1", "y"): "6.0"}


class Hostile:
    """Its pickle makes a file."""

    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, str]]:
        return open, (str(self.made), "w")


# Attributes that PyTables or pandas unpickle when they open a table.
ATTRIBUTES = (
    "non_index_axes",
    "info",
    "encoding",
    "nan_rep",
    "data_columns",
    "levels",
    "index_cols",
    "TITLE",
)


@pytest.mark.parametrize("protocol", [0, 2])
@pytest.mark.parametrize("form", FORMS)
def test_a_hostile_file_runs_nothing(bendtrack, tmp_path: Path, form: str, protocol: int) -> None:
    made = tmp_path / "made"
    hostile = pickle.dumps([Hostile(made)], protocol)
    pickle.loads(hostile)[0].close()
    assert made.is_file()  # it is hostile
    made.unlink()
    path = tmp_path / "CollectedData_anna.h5"
    for name in ATTRIBUTES:
        FORMS[form](path)
        with h5py.File(path, "a") as file:
            file["df_with_missing"].attrs[name] = np.void(hostile)
            for item in file["df_with_missing"].values():
                item.attrs["kind" if name == "encoding" else name] = np.void(hostile)
        bendtrack("import", tmp_path / f"new {name}", path)
        assert not made.exists(), name
    FORMS[form](path)
    with h5py.File(path, "a") as file:
        for name in ("non_index_axes", "pandas_type", "axis0_variety"):
            file["df_with_missing"].attrs[name] = np.bytes_(pickle.dumps([Hostile(made)], 0))
    ran = bendtrack("import", tmp_path / "new", path)
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    assert f"{path}: cannot be read as DeepLabCut's labels in HDF5" in ran.err
    assert not made.exists()


def test_a_pickle_of_anything_but_names_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "CollectedData_anna.h5"
    table(path)
    with h5py.File(path, "a") as file:
        hostile = pickle.dumps([(1, Hostile(tmp_path / "made"))], 0)
        file["df_with_missing"].attrs["non_index_axes"] = np.bytes_(hostile)
    with pytest.raises(LabelError, match="expected a pickle of names, got one with the instruction GLOBAL"):
        read_pandas_table(path)


def test_arrays_of_pickled_objects_are_refused(tmp_path: Path) -> None:
    # PyTables stores a column of mixed types as a pickle in a list of bytes.
    path = tmp_path / "CollectedData_anna.h5"
    fixed(path)
    with h5py.File(path, "a") as file:
        group = file["df_with_missing"]
        del group["block0_values"]
        objects = group.create_dataset("block0_values", (1,), h5py.vlen_dtype(np.uint8))
        objects[0] = np.frombuffer(pickle.dumps([Hostile(tmp_path / "made")]), np.uint8)
        objects.attrs["PSEUDOATOM"] = np.bytes_("object")
    with pytest.raises(LabelError, match="expected plain values"):
        read_pandas_table(path)
    assert not (tmp_path / "made").exists()


def test_plain_pickles_are_parsed_as_pickle_would() -> None:
    for value in ([], [(1, [("ä", "先端", "x\n")])], [("a",), ("a",)], ["b", None, 7, -(10**20)]):
        assert plain_pickle(pickle.dumps(value, 0)) == value
    for value in ({"a": 1}, 1.5, b"x", io.BytesIO(), len):
        with pytest.raises(ValueError, match="instruction"):
            plain_pickle(pickle.dumps(value, 2))
    for damaged in (b"", b".", b"(lp0\n", b"a.", b"t.", b"g7\n.", b"(lp0\ng0\na.", b"Iabc\n."):
        with pytest.raises((ValueError, IndexError, KeyError)):
            plain_pickle(damaged)
