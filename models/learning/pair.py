"""Locator and refiner while they learn. They know nothing of each other, so they learn side by side, each on half of
the cores. What they learn from is drawn in `dataset.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import torch
from torch import Tensor

from ..cascade import Cascade
from .dataset import Batch
from .learner import Learner


class Pair:
    """The two networks of a cascade, a step at a time. A context: torch has half of the cores in every thread there.

    Parameters
    ----------
    network : with the weights to start from, on the device to train on
    average, weight_decay, cell_weight : as `Learner`'s
    locator_share : of the learning rate, what the locator takes

    Attributes
    ----------
    learners : both, by the names that their networks have in a cascade
    average : the averaged networks as a cascade
    """

    def __init__(
        self,
        network: Cascade,
        *,
        average: float,
        weight_decay: float,
        cell_weight: float = 0.0,
        locator_share: float = 1.0,
    ) -> None:
        locator, refiner = (
            Learner(part, average=average, weight_decay=weight_decay, cell_weight=cell_weight)
            for part in (network.locator, network.refiner)
        )
        self.learners = {"locator": locator, "refiner": refiner}
        self._locator_share = locator_share
        self.average = Cascade.of(locator.average, refiner.average)

    def __enter__(self) -> Pair:
        self._threads_before = torch.get_num_threads()
        torch.set_num_threads(max(1, self._threads_before // 2))
        self._pool = ThreadPoolExecutor(max_workers=1)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown()
        torch.set_num_threads(self._threads_before)

    def learn(self, locate: Batch, refine: Sequence[Batch], step: int, learning_rate: float) -> float:
        """Take step number `step`, from 0: the locator from its batch, the refiner from each of its own.

        Returns
        -------
        The sum of the two networks' losses.
        """
        located = self._pool.submit(
            self.learners["locator"].learn, locate, step, learning_rate * self._locator_share
        )
        refiner, first = self.learners["refiner"], step * len(refine)
        losses = [refiner.learn(batch, first + i, learning_rate) for i, batch in enumerate(refine)]
        return located.result() + sum(losses) / len(losses)

    def state_of_average(self) -> dict[str, Tensor]:
        """A copy of the averaged weights."""
        return {name: value.clone() for name, value in self.average.state_dict().items()}
