"""The front door's reporter on a terminal: sentences as `console.py` prints them, progress as `progress_bars.py`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from . import console

if TYPE_CHECKING:
    from ...models.training.trainer import Progress as TrainingProgress


class ConsoleReporter:
    """Prints what the front door tells (`bendtrack.reporting.Reporter`)."""

    def say(self, text: str) -> None:
        """Print a sentence; silent with --quiet."""
        console.say(text)

    def warn(self, text: str) -> None:
        """Print a warning."""
        console.warn(text)

    def detail(self, text: str) -> None:
        """Print a sentence with --debug."""
        if console.debugging():
            console.say(text)

    def counting(
        self, title: str, unit: str = "frames"
    ) -> AbstractContextManager[Callable[[int, int | None], None]]:
        """Show a bar."""
        from . import progress_bars

        return progress_bars.counting(title, unit)

    def training(self, title: str) -> AbstractContextManager[Callable[[TrainingProgress], None]]:
        """Show a bar."""
        from . import progress_bars

        return progress_bars.training(title)

    def folds(self, count: int) -> AbstractContextManager[Callable[[int, TrainingProgress], None]]:
        """Show a bar."""
        from . import progress_bars

        return progress_bars.folds(count)
