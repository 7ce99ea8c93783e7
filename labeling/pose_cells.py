"""What is kept of a video while it streams by: cells of frames that are alike, a few glimpses in each.

Memory does not grow with the video. Which cells become pictures to label is decided in `selection.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..tracker.types import FloatArray
from .glimpses import Glimpse

# Enough to find a sharp one among them; they are drawn by chance, so from all the times the pose was passed.
_MEMBERS = 6


@dataclass
class Cell:
    """Frames that are alike.

    Attributes
    ----------
    members : glimpses drawn by chance from the cell's frames, at most `_MEMBERS`; the first opened the cell
    count : frames that belong to it
    branch : kind of its frames (loading or unloading); cells of different branches are never joined
    """

    members: list[Glimpse]
    count: int = 1
    branch: int = 0

    def take(self, other: Cell, rng: np.random.Generator) -> None:
        """Take over the frames of another cell."""
        self.count += other.count
        for glimpse in other.members:
            if len(self.members) < _MEMBERS:
                self.members.append(glimpse)
            else:  # reservoir sampling, but the first stays
                place = int(rng.integers(1, self.count))
                if place < _MEMBERS:
                    self.members[place] = glimpse


class LookCells:
    """Cells of frames that look alike: the looks of any two cells differ by more than a radius.

    The radius begins at nothing and grows whenever there are more than `limit` cells, which are then joined:
    the doubling algorithm of Charikar, Chekuri, Feder and Motwani (1997) for k-centre clustering of a stream.
    A pose passed once in an hour keeps its cell as well as one held for an hour.
    """

    def __init__(self, limit: int, seed: int = 0) -> None:
        self.limit = limit
        self.cells: list[Cell] = []
        self._centres = np.empty((0, 0), np.float32)  # rows beyond len(cells) are free
        self._squares = np.empty(0, np.float32)
        self._radius = 0.0
        self._rng = np.random.default_rng(seed)

    def add(self, glimpse: Glimpse) -> None:
        """Put a frame into the cell that it looks like, or open a new one."""
        # About a grey of 128, so that float32 keeps the differences of long vectors.
        look = glimpse.look.ravel() - np.float32(128)
        n = len(self.cells)
        if n == 0:
            self._centres = np.empty((self.limit + 1, look.size), np.float32)
            self._squares = np.empty(self.limit + 1, np.float32)
        else:
            square = self._squares[:n] - 2 * (self._centres[:n] @ look) + look @ look
            nearest = int(np.argmin(square))
            if square[nearest] <= self._radius**2 * look.size:
                self.cells[nearest].take(Cell([glimpse]), self._rng)
                return
        self._centres[n], self._squares[n] = look, look @ look
        self.cells.append(Cell([glimpse]))
        while len(self.cells) > self.limit:
            self._coarsen()

    def _coarsen(self) -> None:
        """Join cells until a fifth of the places is free."""
        distance = rms_distances(self._centres[: len(self.cells)])
        np.fill_diagonal(distance, np.inf)
        self._radius = max(1.2 * self._radius, float(np.quantile(distance.min(axis=1), 0.2)))
        kept: list[int] = []
        for place, cell in enumerate(self.cells):
            near = distance[place, kept]
            if len(kept) and near.min() <= self._radius:
                self.cells[kept[int(np.argmin(near))]].take(cell, self._rng)
            else:
                kept.append(place)
        self.cells = [self.cells[place] for place in kept]
        self._centres[: len(kept)] = self._centres[kept]
        self._squares[: len(kept)] = self._squares[kept]


@dataclass
class BinCells:
    """Cells of frames at which a number, known from their time, is nearly the same: the time itself, a pressure.

    Attributes
    ----------
    place : time_s -> (number, branch); None for a time of which nothing is known
    width : of a bin, in the number's unit; doubled whenever there are more than `limit` cells
    """

    place: Callable[[float], tuple[float, int] | None]
    width: float
    limit: int
    seed: int = 0
    _bins: dict[tuple[int, int], Cell] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    @property
    def cells(self) -> list[Cell]:
        """The cells, in the order of their numbers."""
        return [self._bins[key] for key in sorted(self._bins)]

    def add(self, glimpse: Glimpse) -> None:
        """Put a frame where its time belongs."""
        found = self.place(glimpse.time_s)
        if found is not None:
            number, branch = found
            self._put((branch, int(number // self.width)), Cell([glimpse], branch=branch))
        while len(self._bins) > self.limit:
            self.width *= 2
            finer, self._bins = self._bins, {}
            for (branch, place), cell in finer.items():
                self._put((branch, place // 2), cell)

    def _put(self, key: tuple[int, int], cell: Cell) -> None:
        if key in self._bins:
            self._bins[key].take(cell, self._rng)
        else:
            self._bins[key] = cell


def rms_distances(looks: FloatArray, others: FloatArray | None = None) -> FloatArray:
    """Root mean square difference of each look (n, P) to each other look (m, P), grey levels, (n, m)."""
    others = looks if others is None else others
    squares = [(array * array).sum(axis=1, dtype=np.float64) for array in (looks, others)]
    square = squares[0][:, None] + squares[1][None] - 2 * (looks @ others.T)
    return np.sqrt(np.maximum(square, 0) / looks.shape[1])
