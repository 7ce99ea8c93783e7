"""Writing a file so that it is whole or not there: temporary file, fsync, rename.

Every file that bendtrack writes goes through here. What a file contains is up to the caller.
"""

from __future__ import annotations

import glob
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .links import link_within_project, refuse_links

try:
    import fcntl
except ImportError:  # Windows, where a file that is open cannot be removed anyway
    fcntl = None  # type: ignore[assignment]


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; what is written there becomes `path` on success.

    The temporary name begins with a dot and ends in the suffix of `path` (writers such as OpenCV and FFmpeg
    choose their format by it). When the block ends well, the file and then its folder are flushed to disk
    around the rename, so a crash or a full disk leaves the old file or the new one. If the block raises, the
    temporary file is removed and `path` stays as it was. A process killed on the spot may leave the temporary
    file behind; code that lists a folder skips names that begin with a dot. A file that is being
    written is locked, so `remove_leftovers` keeps it.

    A symbolic link is followed: its target is replaced, the link stays. In a project, where a link may be somebody
    else's, it is refused, and so is a folder of the project that is a link (see `links.py`).

    Parameters
    ----------
    path : str or Path
        The file to write or replace.

    Raises
    ------
    LinkError
        The file lies in a project and is a link, or lies behind one.
    OSError
        The file cannot be written (missing or read-only folder, full disk).
    """
    refuse_links(path)
    target = Path(os.path.realpath(path))
    temporary, lock = _new_file(target)
    try:
        yield temporary
        _fsync_file(temporary)
        os.replace(temporary, target)
    except BaseException:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    finally:
        if lock is not None:
            os.close(lock)
    _fsync_folder(target.parent)


def remove_leftovers(folder: str | Path, stem: str | None = None) -> None:
    """Remove temporary files that killed writers left, of all files of a folder or of those with one stem.

    Files that another process is writing stay, and so do files that may not be leftovers.

    Parameters
    ----------
    folder : str or Path
        Folder to clean.
    stem : str or None, optional
        Only temporary files of files with this stem; None for all.
    """
    if link_within_project(folder) is not None:
        return
    name = "*" if stem is None else glob.escape(stem[:40])
    for leftover in Path(folder).glob(f".{name}.{'[0-9a-f]' * 12}.tmp*"):
        with suppress(OSError):
            descriptor = None if fcntl is None else _locked(leftover)
            try:
                leftover.unlink(missing_ok=True)
            finally:
                if descriptor is not None:
                    os.close(descriptor)


def _new_file(target: Path) -> tuple[Path, int | None]:
    """An empty temporary file for `target`, and the descriptor that holds its lock."""
    while True:
        # The stem is cut so that the name stays under the usual 255 bytes.
        path = target.with_name(f".{target.stem[:40]}.{secrets.token_hex(6)}.tmp{target.suffix}")
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except OSError as error:  # in the name that the user knows
            raise OSError(error.errno, error.strerror, str(target)) from error
        if fcntl is None:
            return path, None
        try:
            descriptor = _locked(path)
        except (BlockingIOError, FileNotFoundError):
            continue  # taken for a leftover before it was locked
        except OSError:
            return path, None  # a file system without locks
        if path.exists():
            return path, descriptor
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Open a file and lock it until the descriptor is closed or the process ends; OSError if it is already locked."""
    descriptor = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def atomic_write_text(path: str | Path, text: str) -> None:
    """Write `text` as UTF-8 with its newlines as they are, whole or not at all (see `atomic_path`).

    Parameters
    ----------
    path : str or Path
        The file to write or replace.
    text : str
        Contents; newlines are not converted.

    Raises
    ------
    OSError
        As in `atomic_path`.
    """
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def atomic_write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data`, whole or not at all (see `atomic_path`).

    Parameters
    ----------
    path : str or Path
        The file to write or replace.
    data : bytes
        Contents.

    Raises
    ------
    OSError
        As in `atomic_path`.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def _fsync_file(path: Path) -> None:
    descriptor = os.open(path, os.O_RDWR)  # Windows flushes only what is open for writing
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _fsync_folder(folder: Path) -> None:
    """Make the rename itself durable, where the system can open a folder (Windows cannot)."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
