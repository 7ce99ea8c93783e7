"""Learning-rate schedule and length of a training: warm-up, constant, linear decay that begins early on a plateau.

Apart from the loop because it is part of the saved state and can be fitted to a time limit.
"""

from __future__ import annotations

from dataclasses import dataclass

PATIENCE = 4
"""Evaluations without a better held-out error after which the decay begins."""

GAIN = 0.98
"""A held-out error is better when it is below this share of the best one before."""


@dataclass
class Schedule:
    """The schedule and what it has seen of the held-out error. Steps count from 0.

    Attributes
    ----------
    planned : int
        Steps without a time limit.
    decay_share : float
        Share of all steps in which the learning rate decays.
    total : int
        Steps after which the training ends: `planned`, or fewer under a time limit.
    warmup : int
        Steps in which the learning rate rises.
    decay_start : int or None
        Step at which the decay began early, None while it has not.
    best_px : float
        Lowest held-out error so far, px.
    stale : int
        Evaluations since then.
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
        """Learning rate at a step, as a share of the highest one."""
        warmup = min(self.warmup, max(1, self.total // 10))
        if step < warmup:
            return (step + 1) / warmup
        start = self._decay_start()
        if step < start:
            return 1.0
        return max(0.01, (self.total - step) / max(1, self.total - start))

    def _decay_start(self) -> int:
        if self.decay_start is not None:
            return self.decay_start
        return round(self.total * (1 - self.decay_share))

    def validate(self, step: int, held_out_px: float) -> bool:
        """Record the held-out error after `step` steps, and begin the decay early on a plateau.

        Parameters
        ----------
        step : int
        held_out_px : float
            Root mean square, px.

        Returns
        -------
        bool
            Whether it is the best so far.
        """
        if held_out_px < self.best_px * GAIN:
            self.best_px, self.stale = held_out_px, 0
            return True
        self.stale += 1
        if self.stale >= PATIENCE and step < self._decay_start():
            # The decay keeps its proportion to the steps before it.
            self.decay_start = step
            share = self.decay_share / max(1 - self.decay_share, 0.05)
            self.planned = min(self.planned, step + max(1, round(step * share)))
            self.total = min(self.total, self.planned)
        return False

    def fit(self, step: int, elapsed_s: float, limit_s: float) -> None:
        """Shorten the training to end within a time limit at its speed so far, or lengthen it again up to the plan.

        Parameters
        ----------
        step : int
            Steps taken.
        elapsed_s, limit_s : float
            Seconds that they took, and seconds in all.
        """
        affordable = max(step, int(limit_s / (elapsed_s / step)))
        self.total = min(self.planned, affordable)
