"""What the command line says: results and sentences on stdout; warnings, errors and progress on stderr.

Where programs read stdout as it comes (`bendtrack live`), sentences go to stderr too.
"""

from __future__ import annotations

import shlex
import sys
import time
from dataclasses import dataclass
from typing import Any


@dataclass
class _Settings:
    quiet: bool = False
    debug: bool = False
    stdout_is_for_programs: bool = False
    started_s: float = 0.0
    words: tuple[str, ...] = ()


_settings = _Settings()


def configure(*, quiet: bool, debug: bool, words: tuple[str, ...] = ()) -> None:
    """Begin a command.

    Parameters
    ----------
    quiet : bool
        Whether --quiet was given.
    debug : bool
        Whether --debug was given.
    words : tuple of str
        What the command is called, such as ("track",).
    """
    _settings.quiet, _settings.debug, _settings.stdout_is_for_programs = quiet, debug, False
    _settings.started_s, _settings.words = time.monotonic(), words


def started_s() -> float:
    """`time.monotonic()` at which the command began."""
    return _settings.started_s


def command_begun() -> tuple[str, ...]:
    """What the command at work is called, without the program's name."""
    return _settings.words


def command(*words: object) -> str:
    """A bendtrack command as it can be pasted into a shell.

    >>> command("track", "my study", "a.mp4")
    "bendtrack track 'my study' a.mp4"
    """
    return shlex.join(["bendtrack", *map(str, words)])


def leave_stdout_to_programs() -> None:
    """From here on `say` speaks on stderr."""
    _settings.stdout_is_for_programs = True


def debugging() -> bool:
    """Whether --debug was given."""
    return _settings.debug


def shows_progress() -> bool:
    """Whether someone is there to watch: stderr is a terminal and --quiet was not given."""
    return not _settings.quiet and sys.stderr.isatty()


def say(text: str = "") -> None:
    """Print what goes on and where things are; silent with --quiet."""
    if not _settings.quiet:
        print(text, file=sys.stderr if _settings.stdout_is_for_programs else sys.stdout, flush=True)


def show(result: Any) -> None:
    """Print a result that was asked for: text, or a rich table."""
    if isinstance(result, str):
        print(result, flush=True)
        return
    from rich.console import Console

    Console(highlight=False).print(result)


def warn(text: str) -> None:
    """Print what was worked around, or what the user should look at."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def complain(text: str) -> None:
    """Print why the command ends here."""
    print(f"error: {text}", file=sys.stderr, flush=True)
