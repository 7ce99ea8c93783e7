"""Filling gaps: where to put further points in an interval so that its largest gap becomes as small as possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple


class Target(NamedTuple):
    """A point to add, and its distance from its neighbours when all are added."""

    value: float
    spacing: float


@dataclass
class _Gap:
    """An interval without points inside. An end of the whole interval is open: a point may be put on it."""

    start: float
    end: float
    open_ends: int
    points: int = 0

    @property
    def step(self) -> float:
        """Distance between neighbours. Beyond the last point it counts double, as it has no second neighbour."""
        length = self.end - self.start
        steps = self.points + 1 - self.open_ends
        if self.points == 0:
            return length * (2 if self.open_ends else 1)
        return length / steps if steps else 2 * length


def fill_gaps(low: float, high: float, taken: Sequence[float], count: int) -> list[Target]:
    """Add points between `low` and `high` (included) to those that are there.

    The widest gap gets the next point, and the points of a gap are evenly spaced.

    Parameters
    ----------
    low, high : float
        Ends of the interval.
    taken : sequence of float
        Points that are there, in any order.
    count : int
        Number of points to add.

    Returns
    -------
    list of Target
        The new points, by increasing value.

    Examples
    --------
    >>> [target.value for target in fill_gaps(0.0, 10.0, [], 3)]
    [0.0, 5.0, 10.0]
    >>> [target.value for target in fill_gaps(0.0, 10.0, [0.0, 4.0], 2)]
    [7.0, 10.0]
    """
    edges = [low, *sorted(value for value in taken if low <= value <= high), high]
    last = len(edges) - 2
    gaps = [
        _Gap(start, end, (index == 0) + (index == last)) for index, (start, end) in enumerate(pairwise(edges))
    ]
    for _ in range(count):
        max(gaps, key=lambda gap: gap.step).points += 1
    targets = []
    for gap in gaps:
        if gap.points == 1 and gap.open_ends == 2:
            targets.append(Target((gap.start + gap.end) / 2, gap.step))
            continue
        before = 0 if gap is gaps[0] else 1
        targets += [Target(gap.start + gap.step * (index + before), gap.step) for index in range(gap.points)]
    return targets
