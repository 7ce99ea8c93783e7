"""Reading HDF5 files of any origin: each data set is checked before it is read, and every failure is one user's error.

h5py runs nothing that a file holds, unlike PyTables, which unpickles attributes. What the data sets mean is up to the
caller.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from .errors import BendtrackError, reason

# Bytes that one file may ask for in memory. A compressed data set, or one that was never written, is larger than its
# file; 200 times is beyond any recording (gzip of constant columns reaches 1000, floats of a measurement 20).
_MAX_BYTES = 2**31
_MIN_BYTES = 2**26
_EXPANSION = 200
# Groups and data sets that one file may be walked through; hard links may form loops and lattices.
_MAX_ITEMS = 20_000
# Texts of variable length are read in portions, since many of them may be one large one.
_PORTION_BYTES = 2**28

# What h5py raises on damaged files, beyond OSError.
_FAILURES = (
    *(OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, IndexError, ArithmeticError),
    *(MemoryError, NotImplementedError, AssertionError),
)


class _Refused(ValueError):
    """The file asks for something that is never read."""


class Hdf5File:
    """An open HDF5 file that is read within limits.

    Parameters
    ----------
    file : h5py.File
        The file.
    max_bytes : int
        Bytes that may be read from it in all.

    Attributes
    ----------
    root : h5py.Group
        The file's root group.
    """

    def __init__(self, file: h5py.File, max_bytes: int) -> None:
        self.root: h5py.Group = file
        self._bytes_left = max_bytes
        self._items_left = _MAX_ITEMS
        self._portion = max(1, _PORTION_BYTES // max(1, Path(file.filename).stat().st_size))

    def item(self, group: h5py.Group, name: str) -> h5py.Group | h5py.Dataset:
        """Return a member of a group that lies in this file.

        Parameters
        ----------
        group : h5py.Group
            The group.
        name : str
            Name in it, without slashes.

        Returns
        -------
        h5py.Group or h5py.Dataset
            The member.

        Raises
        ------
        KeyError
            There is none.
        ValueError
            It lies in another file, or the file was walked through too far.
        """
        if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
            raise _Refused(f"'{name}' lies in another file")
        return self.counted(group[name])

    def counted(self, item: Any) -> Any:
        """Return an item, and refuse to go on after too many.

        Parameters
        ----------
        item : h5py.Group or h5py.Dataset
            An item of the file.

        Returns
        -------
        h5py.Group or h5py.Dataset
            The same item.

        Raises
        ------
        ValueError
            It is one too many.
        """
        self._items_left -= 1
        if self._items_left < 0:
            raise _Refused(f"expected at most {_MAX_ITEMS} items, got more")
        return item

    def array(self, source: h5py.Group | h5py.Dataset, name: str | None = None) -> np.ndarray:
        """Read a data set of numbers, fixed texts or references.

        Parameters
        ----------
        source : h5py.Group or h5py.Dataset
            The data set, or the group that holds it.
        name : str or None, optional
            Its name in the group.

        Returns
        -------
        ndarray
            Its values.

        Raises
        ------
        KeyError
            There is none of this name.
        ValueError
            It is no such data set, or larger than the limits.
        """
        dataset = self._checked(source, name)
        if dataset.dtype.hasobject and h5py.check_ref_dtype(dataset.dtype) is None:
            raise _Refused(f"'{dataset.name}': expected plain values, got {dataset.dtype}")
        return np.asarray(dataset[()])

    def texts(self, source: h5py.Group | h5py.Dataset, name: str | None, max_chars: int) -> list[str]:
        """Read a data set of texts, flattened.

        Parameters
        ----------
        source : h5py.Group or h5py.Dataset
            The data set, or the group that holds it.
        name : str or None
            Its name in the group.
        max_chars : int
            Characters that a text may have.

        Returns
        -------
        list of str
            Its texts.

        Raises
        ------
        KeyError
            There is none of this name.
        ValueError
            It is no data set of UTF-8 texts, or larger than the limits.
        """
        dataset = self._checked(source, name)
        kind = h5py.check_string_dtype(dataset.dtype)
        if kind is None:
            raise _Refused(f"'{dataset.name}': expected texts, got {dataset.dtype}")
        if dataset.ndim > 1:
            raise _Refused(f"'{dataset.name}': expected a list of texts, got {dataset.ndim} dimensions")
        if dataset.ndim == 0:
            found = [dataset[()]]
        elif kind.length is None:
            found = []
            same: dict[bytes, bytes] = {}  # repeated texts are one object
            for start in range(0, dataset.shape[0], self._portion):
                part = dataset[start : start + self._portion].tolist()
                found += [same.setdefault(text, text) for text in part]
        else:
            found = dataset[()].tolist()
        longest = max((len(text) for text in found), default=0)
        if longest > 4 * max_chars:
            raise _Refused(
                f"'{dataset.name}': expected texts of at most {max_chars} characters, got {longest}"
            )
        return [text.decode("utf-8") for text in found]

    def text(self, group: h5py.Group, name: str) -> str:
        """Read a data set that holds one text.

        Parameters
        ----------
        group : h5py.Group
            The group that holds it.
        name : str
            Its name.

        Returns
        -------
        str
            The text.

        Raises
        ------
        KeyError
            There is none of this name.
        ValueError
            It is no such data set, or larger than the limits.
        """
        texts = self.texts(group, name, self._bytes_left)
        if len(texts) != 1:
            raise _Refused(f"'{name}': expected one text, got {len(texts)}")
        return texts[0]

    def check_all(self) -> None:
        """Check every data set of the file, for a library that then reads it.

        Raises
        ------
        ValueError
            One lies in another file, or all together are larger than the limits.
        """
        groups, seen = [self.root], {h5py.h5o.get_info(self.root.id).addr}
        while groups:
            group = groups.pop()
            for name in group:
                item = self.item(group, name)
                address = h5py.h5o.get_info(item.id).addr
                if address in seen:
                    continue
                seen.add(address)
                if isinstance(item, h5py.Group):
                    groups.append(item)
                elif isinstance(item, h5py.Dataset) and item.shape is not None:
                    self._checked(item, None)

    def _checked(self, source: h5py.Group | h5py.Dataset, name: str | None) -> h5py.Dataset:
        dataset = source if name is None else self.item(source, name)
        if not isinstance(dataset, h5py.Dataset):
            raise _Refused(f"'{name or source.name}': expected a data set, got a {type(dataset).__name__}")
        if dataset.is_virtual or dataset.external:
            raise _Refused(f"'{dataset.name}': expected its values in this file, got some in another")
        if dataset.shape is None:
            raise _Refused(f"'{dataset.name}': expected values, got an empty data set")
        itemsize = max(int(dataset.dtype.itemsize), 1)
        wanted = int(dataset.size) * itemsize
        # A chunk is read as a whole, and may be larger than the data set.
        chunk = 0 if dataset.chunks is None else int(np.prod(dataset.chunks, dtype=object)) * itemsize
        if max(wanted, chunk) > self._bytes_left:
            raise _Refused(
                f"'{dataset.name}': expected at most {self._bytes_left / 1e6:.0f} MB from a file of this size, "
                f"got {max(wanted, chunk) / 1e6:.0f} MB"
            )
        self._bytes_left -= wanted
        return dataset


@contextmanager
def open_hdf5(path: Path, error: type[BendtrackError], what: str) -> Iterator[Hdf5File]:
    """Open an HDF5 file; whatever fails while the block reads it becomes one error.

    Parameters
    ----------
    path : Path
        The file.
    error : type of BendtrackError
        Class of the error to raise.
    what : str
        What the file is expected to be, for the message.

    Yields
    ------
    Hdf5File
        The open file.

    Raises
    ------
    error
        The file cannot be opened, or something in it cannot be read.
    """
    try:
        size = path.stat().st_size
        max_bytes = min(_MAX_BYTES, max(_MIN_BYTES, _EXPANSION * size))
        with h5py.File(path, "r") as file:
            yield Hdf5File(file, max_bytes)
    except RecursionError as failure:
        raise error(f"{path}: cannot be read as {what} (nested too deep)") from failure
    except _FAILURES as failure:
        if isinstance(failure, BendtrackError):  # none of them is today
            raise
        raise error(f"{path}: cannot be read as {what} ({reason(failure)})") from failure
