"""The private folder <project>/.bendtrack/ of the labelling server: secret, ports, lock, journal and caches.

It can be deleted at any time. Only the undo history is lost: no label is stored only there.
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
from ..tracker.errors import ProjectError
from ..tracker.json_files import load_json

try:
    import fcntl
except ImportError:  # Windows: one server for each project, so its thread lock is enough
    fcntl = None  # type: ignore[assignment]

_PORTS_KEPT = 4


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
        self.path = root / ".bendtrack"
        if self.path.is_symlink() or (self.path.exists() and not self.path.is_dir()):
            raise ProjectError(f"{self.path}: expected a folder of bendtrack's own, got something else")
        self.path.mkdir(mode=0o700, exist_ok=True)
        self.path.chmod(0o700)
        if not (self.path / ".gitignore").exists():
            (self.path / ".gitignore").write_text("*\n", encoding="utf-8")
        self._thread_lock = threading.RLock()
        self._depth = 0

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the project against all other threads and servers until the block ends.

        The lock is reentrant. A process that is killed releases it.
        """
        with self._thread_lock:
            self._depth += 1
            descriptor = None
            try:
                if self._depth == 1:
                    self.path.mkdir(mode=0o700, exist_ok=True)  # it may have been deleted meanwhile
                if self._depth == 1 and fcntl is not None:
                    descriptor = os.open(self.path / "lock", os.O_RDWR | os.O_CREAT, 0o600)
                    with suppress(OSError):  # a file system without locks
                        fcntl.flock(descriptor, fcntl.LOCK_EX)
                yield
            finally:
                self._depth -= 1
                if descriptor is not None:
                    os.close(descriptor)

    def secret(self) -> str:
        """Return the session's secret, created at the first call. Its cookie stays valid after a restart."""
        path = self.path / "secret"
        with self.lock():
            with suppress(FileNotFoundError):
                path.chmod(0o600)
                text = path.read_text(encoding="ascii", errors="replace").strip()
                if len(text) >= 32 and text.isascii() and text.replace("-", "").replace("_", "").isalnum():
                    return text
                path.unlink()  # truncated, or not written by us
            text = secrets.token_urlsafe(32)
            descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
            with open(descriptor, "w", encoding="ascii") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            return text

    def ports(self) -> list[int]:
        """Return the ports that this project was served on, the oldest first: pages may be waiting there."""
        try:
            found = load_json(self.path / "ports.json")
        except (OSError, ValueError):
            return []
        return (
            [port for port in found if type(port) is int and 0 < port < 65536]
            if isinstance(found, list)
            else []
        )

    def remember_port(self, port: int) -> None:
        """Store a port for the next start."""
        with self.lock():
            ports = list(dict.fromkeys([*self.ports(), port]))[-_PORTS_KEPT:]
            if ports != self.ports():
                atomic_write_text(self.path / "ports.json", json.dumps(ports))
