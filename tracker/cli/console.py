"""What the command line says: results and chatter on stdout; warnings, errors and progress on stderr.

Where programs read stdout as it comes (`bendtrack live`), chatter goes to stderr too.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any


@dataclass
class _Settings:
    quiet: bool = False
    debug: bool = False
    stdout_is_for_programs: bool = False


_settings = _Settings()


def configure(*, quiet: bool, debug: bool) -> None:
    """Set for this run of the program what --quiet and --debug ask for."""
    _settings.quiet, _settings.debug, _settings.stdout_is_for_programs = quiet, debug, False


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
    """What goes on and where things are; silent with --quiet."""
    if not _settings.quiet:
        print(text, file=sys.stderr if _settings.stdout_is_for_programs else sys.stdout, flush=True)


def show(result: Any) -> None:
    """A result that was asked for: text, or a rich table."""
    if isinstance(result, str):
        print(result, flush=True)
        return
    from rich.console import Console

    Console(highlight=False).print(result)


def warn(text: str) -> None:
    """Something that was worked around, or that the user should look at."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


def complain(text: str) -> None:
    """Why the command ends here."""
    print(f"error: {text}", file=sys.stderr, flush=True)
