"""A lock on a folder between processes, so that two commands do not write the same set of files at once.

It is held on the folder itself, without a file in it, and is released however the process ends. Whether one waits for
it or says that the folder is in use is up to the caller.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows cannot open folders: there each file is written whole, but a set may be mixed
    fcntl = None  # type: ignore[assignment]


class FolderInUseError(Exception):
    """Another process holds the lock."""


@contextmanager
def folder_lock(folder: Path, *, wait: bool) -> Iterator[None]:
    """Hold the lock of a folder while the block runs.

    Parameters
    ----------
    folder : Path
        An existing folder.
    wait : bool
        Whether to wait for another process that holds it.

    Raises
    ------
    FolderInUseError
        Another process holds it, and `wait` is false.

    Notes
    -----
    On a file system without locks, and on Windows, the block runs without one.
    """
    descriptor = None
    try:
        if fcntl is not None:
            try:
                descriptor = os.open(folder, os.O_RDONLY)
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                raise FolderInUseError(str(folder)) from None
            except OSError:
                pass  # no locks here
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
