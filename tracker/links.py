"""Links in a project are not followed by anything that is written: a project may come from somebody else.

A project that was downloaded or is shared can hold a link under any name that bendtrack writes, and the link can lead
to a file of the user's outside. So between a project's own folder and a file that is written, nothing may be a link.
The project's folder itself may be reached by links, and reading follows them. Writing whole files is in `atomic.py`.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

PROJECT_FILE = "bendtrack.toml"
# A folder with one of these in it was made or received as a whole.
_MARKERS = (PROJECT_FILE, "study.toml")

# Windows: what Explorer calls a junction; `lstat` does not call it a link.
_JUNCTION = getattr(stat, "IO_REPARSE_TAG_MOUNT_POINT", 0xA0000003)


class LinkError(OSError):
    """A file that is written in a project is a link, or lies behind one."""


def link_within_project(path: str | Path) -> Path | None:
    """Return the first link between a project's folder and a path.

    Parameters
    ----------
    path : str or Path
        A file or folder, which need not exist. Where it lies in several projects, the outermost counts.

    Returns
    -------
    Path or None
        The link (symbolic, or a junction of Windows); None where there is none, or the path lies in no project.
    """
    # Not normalised: "results/.." leads to the parent of what `results` is a link to.
    whole = Path(os.getcwd()) / path
    above = list(reversed(whole.parents))
    start = next((n for n, folder in enumerate(above) if _is_project(folder)), None)
    if start is None:
        return None
    return next((part for part in (*above[start + 1 :], whole) if _is_link(part)), None)


def refuse_links(path: str | Path) -> None:
    """Raise an error where writing to a path would follow a link of a project.

    Parameters
    ----------
    path : str or Path
        A file or folder, which need not exist.

    Raises
    ------
    LinkError
        The path, or a folder of the project above it, is a link.
    """
    link = link_within_project(path)
    if link is not None:
        raise LinkError(
            errno.ELOOP,
            f"expected a file or folder of the project's own, got a link to {_target(link)}; nothing is written through"
            " links in a project: name another folder with --out, or keep the whole project there",
            str(link),
        )


def make_folder(folder: str | Path) -> None:
    """Make a folder with its parents, unless that would follow a link of a project.

    Parameters
    ----------
    folder : str or Path
        The folder; it may exist.

    Raises
    ------
    LinkError
        The folder, or one above it in the project, is a link.
    OSError
        It cannot be made.
    """
    refuse_links(folder)
    Path(folder).mkdir(parents=True, exist_ok=True)


def open_own_file(path: str | Path, flags: int, mode: int = 0o600) -> int:
    """Open a file that is changed in place (a journal, a lock), if it is a plain file with no other name.

    Parameters
    ----------
    path : str or Path
        The file.
    flags : int
        Flags of `os.open`.
    mode : int, optional
        Permissions of a new file.

    Returns
    -------
    int
        The descriptor.

    Raises
    ------
    LinkError
        The file is a link, lies behind one in a project, or has a second name (a hard link).
    OSError
        It is no plain file, or cannot be opened.
    """
    refuse_links(path)
    # O_NOFOLLOW: a link that has come since. O_NONBLOCK: a named pipe would wait for a reader.
    flags |= getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)
    descriptor = os.open(path, flags, mode)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_nlink <= 1:
        return descriptor
    os.close(descriptor)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "expected a plain file, got something else", str(path))
    raise LinkError(
        errno.EMLINK,
        "expected a file with one name, got a hard link to a file with another; delete it, or put a copy in its place",
        str(path),
    )


def _is_project(folder: Path) -> bool:
    return any(os.path.lexists(folder / marker) for marker in _MARKERS)


def _is_link(path: Path) -> bool:
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", 0) == _JUNCTION


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return os.path.realpath(link)
