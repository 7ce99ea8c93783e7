"""The private folder <project>/.bendtrack/ of the labelling server: the project's id, ports, lock, journal and caches.

It can be deleted at any time. Only the undo history is lost: no label is stored only there, and no secret at all.
"""

from __future__ import annotations

import json
import os
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..tracker.atomic import atomic_write_text
from ..tracker.errors import LabelError, ProjectError, reason
from ..tracker.links import LinkError, open_own_file, refuse_links
from ..tracker.project import SETTINGS_FILE

try:
    import fcntl
except ImportError:  # Windows: one server for each project, so its thread lock is enough
    fcntl = None  # type: ignore[assignment]

_PORTS_KEPT = 4
_ID_FILE = "project-id"


class FolderUnreachableError(LabelError):
    """The project's folder is not where it was: a drive is away, it was renamed, or another one is in its place."""


class PrivateFolder:
    """The project's private folder, readable by its owner only.

    Parameters
    ----------
    root : Path
        The project's folder.

    Raises
    ------
    ProjectError
        Its name is taken by a link or a file.
    OSError
        It cannot be created.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self.path = root / ".bendtrack"
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            found = "link" if self.path.is_symlink() else "file"
            raise ProjectError(
                f"{self.path}: expected a folder of bendtrack's own, got something else (a {found})"
            )
        refuse_links(self.path)  # a junction of Windows
        self.path.mkdir(mode=0o700, exist_ok=True)
        self.path.chmod(0o700)
        with suppress(OSError):
            (self.path / "secret").unlink()  # of earlier versions, whose session outlived the server
        self._thread_lock = threading.RLock()
        self._depth = 0
        self._identity = _identity(root)
        self._id: str | None = None
        with self.lock():
            self._id = _read_id(self.path) or secrets.token_hex(16)
            self._write_new(_ID_FILE, self._id)
            self._write_new(".gitignore", "*\n")

    def check_reachable(self) -> None:
        """Raise an error unless the project's folder is there, and is the one that was opened.

        A drive that was away may come back under other numbers, so an id in the folder decides. Where `.bendtrack`
        was deleted, the folder's inode does.

        Raises
        ------
        FolderUnreachableError
            There is no project, or another one.
        """
        try:
            identity = _identity(self._root)
            os.stat(self._root / SETTINGS_FILE)
            found = _read_id(self.path)
        except LinkError:
            raise  # there, but not to be used
        except OSError as error:
            raise FolderUnreachableError(
                f"the project's folder cannot be reached ({reason(error)}); is its drive connected, or was it renamed?"
            ) from error
        if found == self._id or (None in (found, self._id) and identity == self._identity):
            self._identity = identity
            return
        raise FolderUnreachableError(
            "another folder is in the place of the project's; put it back, or start the server anew"
        )

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the project against all other threads and servers until the block ends.

        The lock is reentrant. A process that is killed releases it.

        Raises
        ------
        FolderUnreachableError
            As in `check_reachable`.
        OSError
            The lock file cannot be opened, or is a link.
        """
        with self._thread_lock:
            self._depth += 1
            descriptor = None
            try:
                if self._depth == 1:
                    self.check_reachable()  # an empty mount point must not be written into
                    self.path.mkdir(mode=0o700, exist_ok=True)  # it may have been deleted meanwhile
                    descriptor = open_own_file(self.path / "lock", os.O_RDWR | os.O_CREAT)
                    with suppress(OSError):  # a file system without locks
                        if fcntl is not None:
                            fcntl.flock(descriptor, fcntl.LOCK_EX)
                    if self._id is not None:
                        self._write_new(_ID_FILE, self._id)
                yield
            finally:
                self._depth -= 1
                if descriptor is not None:
                    os.close(descriptor)

    def ports(self) -> list[int]:
        """Return the ports that this project was served on, the oldest first: pages may be waiting there."""
        try:
            found = json.loads(_read_own(self.path / "ports.json"))
        except (OSError, ValueError):
            return []
        return [port for port in found if isinstance(port, int)] if isinstance(found, list) else []

    def remember_port(self, port: int) -> None:
        """Store a port for the next start."""
        with self.lock():
            ports = list(dict.fromkeys([*self.ports(), port]))[-_PORTS_KEPT:]
            if ports != self.ports():
                atomic_write_text(self.path / "ports.json", json.dumps(ports))

    def _write_new(self, name: str, text: str) -> None:
        if os.path.lexists(self.path / name):
            return
        with suppress(FileExistsError):  # another server has just written it
            descriptor = open_own_file(self.path / name, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
            with open(descriptor, "w", encoding="utf-8") as file:
                file.write(text)


def _read_id(folder: Path) -> str | None:
    """Return the project's id, None where there is none yet."""
    try:
        return _read_own(folder / _ID_FILE)[:64].decode("ascii", "replace") or None
    except FileNotFoundError:
        return None


def _read_own(path: Path) -> bytes:
    # As for writing: a named pipe in a project of somebody else's would be waited for.
    with open(open_own_file(path, os.O_RDONLY), "rb") as file:
        return file.read()


def _identity(folder: Path) -> tuple[int, int]:
    status = os.stat(folder)
    return status.st_dev, status.st_ino
