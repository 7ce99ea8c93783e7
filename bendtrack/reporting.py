"""What the front door tells while it works: sentences and progress. A program may listen; nothing is printed here."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Protocol

from .tracker.errors import BendtrackWarning

if TYPE_CHECKING:
    from .models.training.trainer import Progress as TrainingProgress


class Reporter(Protocol):
    """Is told what goes on. The command line prints it."""

    def say(self, text: str) -> None:
        """What is done, one sentence."""

    def warn(self, text: str) -> None:
        """What was worked around, or should be looked at, one sentence."""

    def detail(self, text: str) -> None:
        """What matters only to someone who looks for a fault."""

    def counting(
        self, title: str, unit: str = "frames"
    ) -> AbstractContextManager[Callable[[int, int | None], None]]:
        """Context that gives what is called with the number done and the number in all (None: not known)."""

    def training(self, title: str) -> AbstractContextManager[Callable[[TrainingProgress], None]]:
        """Context that gives what is called with the progress of a training."""

    def folds(self, count: int) -> AbstractContextManager[Callable[[int, TrainingProgress], None]]:
        """Context that gives what is called with a fold, counted from 0, and the progress of its training."""


class SilentReporter:
    """Says nothing; a warning becomes a `BendtrackWarning`."""

    def say(self, text: str) -> None:
        """Nothing."""

    def warn(self, text: str) -> None:
        """A `BendtrackWarning`."""
        warnings.warn(text, BendtrackWarning, stacklevel=4)

    def detail(self, text: str) -> None:
        """Nothing."""

    @contextmanager
    def counting(self, title: str, unit: str = "frames") -> Iterator[Callable[[int, int | None], None]]:
        """Counts for nobody."""
        yield lambda done, total: None

    @contextmanager
    def training(self, title: str) -> Iterator[Callable[[TrainingProgress], None]]:
        """Counts for nobody."""
        yield lambda progress: None

    @contextmanager
    def folds(self, count: int) -> Iterator[Callable[[int, TrainingProgress], None]]:
        """Counts for nobody."""
        yield lambda fold, progress: None


SILENT = SilentReporter()
