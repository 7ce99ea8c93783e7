"""How long a training goes on and how fast it learns: steady, then falling to zero, sooner when nothing is gained.

Kept apart from the loop because it must survive a kill (it is part of the saved state) and fit a time limit.
"""

from __future__ import annotations

from dataclasses import dataclass

PATIENCE = 4
"""Evaluations without a better held-out error before the learning rate begins to fall."""

GAIN = 0.98
"""An error counts as better when it is under this share of the best before."""


@dataclass
class Schedule:
    """Where a training stands. Steps count from 0.

    Attributes
    ----------
    planned : steps wanted
    total : steps after which training ends: `planned`, or what a time limit leaves of it
    decay_share : share of all steps in which the learning rate falls
    warmup : steps in which it rises
    decay_start : step at which it began to fall early, None while it has not
    best_px, stale : held-out error so far, and evaluations since it was best
    """

    planned: int
    decay_share: float
    total: int = 0
    warmup: int = 30
    decay_start: int | None = None
    best_px: float = float("inf")
    stale: int = 0

    def __post_init__(self) -> None:
        self.total = self.total or self.planned

    def factor(self, step: int) -> float:
        """Learning rate at a step, as a share of the highest."""
        warmup = min(self.warmup, max(1, self.total // 10))
        if step < warmup:
            return (step + 1) / warmup
        start = self._start()
        if step < start:
            return 1.0
        return max(0.01, (self.total - step) / max(1, self.total - start))

    def _start(self) -> int:
        if self.decay_start is not None:
            return self.decay_start
        return round(self.total * (1 - self.decay_share))

    def judge(self, step: int, held_out_px: float) -> bool:
        """Take in a held-out error after `step` steps; True when it is the best so far."""
        if held_out_px < self.best_px * GAIN:
            self.best_px, self.stale = held_out_px, 0
            return True
        self.stale += 1
        if self.stale >= PATIENCE and step < self._start():
            # What a fall takes is kept in proportion to what was learnt before it.
            self.decay_start = step
            share = self.decay_share / max(1 - self.decay_share, 0.05)
            self.planned = min(self.planned, step + max(1, round(step * share)))
            self.total = min(self.total, self.planned)
        return False

    def fit(self, step: int, elapsed_s: float, limit_s: float) -> None:
        """Shorten the training, or lengthen it again up to the plan, to end within a time limit at the speed seen."""
        affordable = max(step, int(limit_s / (elapsed_s / step)))
        self.total = min(self.planned, affordable)
