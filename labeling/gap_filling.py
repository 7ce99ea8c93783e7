"""Where on a line to put further points so that the largest gap becomes as small as it can."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple


class Target(NamedTuple):
    """A point to be put, and how far it is from its neighbours when all are put."""

    value: float
    room: float


@dataclass
class _Gap:
    """A stretch of the line without points; an end of the line is open, a point may lie on it."""

    start: float
    end: float
    open_ends: int
    points: int = 0

    @property
    def step(self) -> float:
        """Distance between neighbours. What is beyond the last point counts double: nothing is on its other side."""
        length = self.end - self.start
        steps = self.points + 1 - self.open_ends
        if self.points == 0:
            return length * (2 if self.open_ends else 1)
        return length / steps if steps else 2 * length


def fill_gaps(low: float, high: float, taken: Sequence[float], count: int) -> list[Target]:
    """Put `count` further points between `low` and `high` (included), beside those that are there.

    The gap that stays the widest gets the next point, and the points of a gap lie evenly in it.

    Returns
    -------
    Increasing values.

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
        _Gap(start, end, (place == 0) + (place == last)) for place, (start, end) in enumerate(pairwise(edges))
    ]
    for _ in range(count):
        max(gaps, key=lambda gap: gap.step).points += 1
    targets = []
    for gap in gaps:
        if gap.points == 1 and gap.open_ends == 2:
            targets.append(Target((gap.start + gap.end) / 2, gap.step))
            continue
        before = 0 if gap is gaps[0] else 1
        targets += [Target(gap.start + gap.step * (place + before), gap.step) for place in range(gap.points)]
    return targets
