"""HDF5 files of any origin: what is refused before it is read, and how it is said."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.hdf5_files import open_hdf5


def read(path: Path, name: str) -> np.ndarray:
    with open_hdf5(path, ResultsError, "a test") as file:
        return file.array(file.root, name)


def made(path: Path, fill: Callable[[h5py.File], object]) -> Path:
    with h5py.File(path, "w") as file:
        fill(file)
    return path


def never_written(file: h5py.File) -> None:
    file.create_dataset("a", (10**9,), "f8", chunks=(1000,))


def compressed(file: h5py.File) -> None:
    file.create_dataset("a", data=np.zeros(3 * 10**7), compression="gzip", compression_opts=9)


def one_large_chunk(file: h5py.File) -> None:
    file.create_dataset("a", (10,), "f8", chunks=(10**8,), maxshape=(None,))


def of_another_file(file: h5py.File) -> None:
    file["a"] = h5py.ExternalLink("/etc/hostname", "a")


def values_of_another_file(file: h5py.File) -> None:
    file.create_dataset("a", (2,), "f8", external=[("/etc/passwd", 0, 16)])


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((2,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "a", (2,))
    file.create_virtual_dataset("a", layout)


def group(file: h5py.File) -> None:
    file.create_group("a")


def nothing(file: h5py.File) -> None:
    file.create_dataset("a", data=h5py.Empty("f8"))


REFUSED = {
    never_written: "expected at most 67 MB from a file of this size, got 8000 MB",
    compressed: "MB from a file of this size, got 240 MB",
    one_large_chunk: "got 800 MB",
    of_another_file: "lies in another file",
    values_of_another_file: "expected its values in this file",
    virtual: "expected its values in this file",
    group: "expected a data set, got a Group",
    nothing: "got an empty data set",
    lambda file: None: "object 'a' doesn't exist",
}


@pytest.mark.parametrize("fill", REFUSED, ids=lambda fill: fill.__name__)
def test_what_is_refused(tmp_path: Path, fill: Callable[[h5py.File], object]) -> None:
    path = made(tmp_path / "a.h5", fill)
    tracemalloc.start()
    with pytest.raises(ResultsError) as caught:
        read(path, "a")
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6
    assert REFUSED[fill] in str(caught.value)
    assert str(caught.value).startswith(f"{path}: cannot be read as a test (")
    assert "\n" not in str(caught.value)


def test_small_data_sets_add_up(tmp_path: Path) -> None:
    def many(file: h5py.File) -> None:
        for name in "abc":
            file.create_dataset(name, (4 * 10**6,), "f8", chunks=(1000,))

    path = made(tmp_path / "a.h5", many)
    with open_hdf5(path, ResultsError, "a test") as file:
        for name in "ab":
            file.array(file.root, name)
        with pytest.raises(ValueError, match="got 32 MB"):
            file.array(file.root, "c")


def test_texts_are_read_whole_and_long_ones_refused(tmp_path: Path) -> None:
    texts = ["", "ä", "low_likelihood"] * 1000

    def fill(file: h5py.File) -> None:
        file.create_dataset("a", data=texts, dtype=h5py.string_dtype())
        file["fixed"] = np.array([b"x", b"yz"])
        file.create_dataset("long", data=["x" * 1000], dtype=h5py.string_dtype())

    path = made(tmp_path / "a.h5", fill)
    with open_hdf5(path, ResultsError, "a test") as file:
        assert file.texts(file.root, "a", 64) == texts
        assert file.texts(file.root, "fixed", 64) == ["x", "yz"]
        with pytest.raises(ValueError, match="at most 64 characters, got 1000"):
            file.texts(file.root, "long", 64)


def test_an_error_of_the_block_itself_is_named_too(tmp_path: Path) -> None:
    path = made(tmp_path / "a.h5", never_written)
    with (
        pytest.raises(ResultsError, match=r"cannot be read as a test .nested too deep"),
        open_hdf5(path, ResultsError, "a test"),
    ):
        raise RecursionError
    (tmp_path / "b.h5").write_text("no hdf5")
    with (
        pytest.raises(ResultsError, match=r"b\.h5: cannot be read as a test"),
        open_hdf5(tmp_path / "b.h5", ResultsError, "a test"),
    ):
        pass
