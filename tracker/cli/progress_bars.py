"""Progress on a terminal: how far, how fast, how long still. Silent with --quiet or without a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars
from rich.text import Text

from . import console

if TYPE_CHECKING:
    from ...models.training.trainer import Progress


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


class _Count(ProgressColumn):
    """How many of how many; nothing before the first."""

    def __init__(self, unit: str) -> None:
        super().__init__()
        self._unit = unit

    def render(self, task: Task) -> Text:
        done = f"{task.completed:.0f}"
        of = done if task.total is None else f"{done}/{task.total:.0f}"
        return Text(f"{of} {self._unit}" if task.completed else "")


@contextmanager
def counting(title: str, unit: str = "frames") -> Iterator[Callable[[int, int | None], None]]:
    """Yields what is to be called with the number done and the number in all (None: not known)."""
    if not console.shows_progress():
        yield lambda done, total: None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        _Count(unit),
        _Rate(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)


@contextmanager
def training(title: str) -> Iterator[Callable[[Progress], None]]:
    """Yields what is to be called with the progress of a training."""
    if not console.shows_progress():
        yield lambda progress: None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("step {task.completed}/{task.total}"),
        _Rate(),
        TextColumn("{task.fields[words]}", markup=False),
    )
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None, words="")

        def update(progress: Progress) -> None:
            bars.update(task, completed=progress.step, total=progress.total, words=_words(progress))

        yield update


@contextmanager
def folds(count: int) -> Iterator[Callable[[int, Progress], None]]:
    """Yields what is to be called with the fold (from 0) and its training's progress."""
    with training(f"{count} folds") as update:

        def progress(fold: int, of_fold: Progress) -> None:
            # One bar for all: the folds are alike, so the rest will take what this one takes.
            update(
                replace(
                    of_fold,
                    step=fold * of_fold.total + of_fold.step,
                    total=count * of_fold.total,
                    left_s=of_fold.left_s + (count - 1 - fold) * (of_fold.elapsed_s + of_fold.left_s),
                )
            )

        yield progress


def _words(progress: Progress) -> str:
    words = f"loss {progress.loss:.4f}"
    if progress.held_out_px == progress.held_out_px:
        words += f", held out {progress.held_out_px:.2f} px"
    if progress.held_out_deg == progress.held_out_deg:
        words += f" {progress.held_out_deg:.2f}°"
    return f"{words}, {clock(progress.left_s)} left"


def clock(seconds: float) -> str:
    """A duration as people say it.

    >>> clock(9.6), clock(250)
    ('10 s', '4:10 min')
    """
    whole = round(seconds)
    return f"{whole} s" if whole < 60 else f"{whole // 60}:{whole % 60:02d} min"
