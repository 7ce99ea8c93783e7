"""Optimisation steps: one network with its optimiser and its exponential moving average, and two of them in parallel.

What a step learns from is drawn in `batches.py`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

import torch
from torch import Tensor
from torch.nn.utils import convert_conv2d_weight_memory_format
from torch.optim.swa_utils import get_ema_multi_avg_fn

from ...tracker.errors import TrainingError
from ..networks.cascade import Cascade
from ..networks.heatmap_network import HeatmapNetwork
from ..networks.heatmaps import cell_loss, heatmap_loss
from .batches import Batch

SPREAD_WEIGHT = 0.1
"""The spread head only describes; it must not steer the features."""

LARGEST_GRADIENT = 5.0
"""Norm that a step's gradient is cut to: one strange batch must not throw the weights about."""


class NetworkOptimiser:
    """Network, average and optimiser, a step at a time.

    Parameters
    ----------
    network : with the weights to start from, on the device to train on
    average : how much of the averaged weights is kept each step
    weight_decay : AdamW's
    cell_weight : of `heatmaps.cell_loss`
    """

    def __init__(
        self,
        network: HeatmapNetwork,
        *,
        average: float,
        weight_decay: float,
        cell_weight: float = 0.0,
    ) -> None:
        # Convolutions read pixel after pixel, where bfloat16 pays most.
        self.network = convert_conv2d_weight_memory_format(network, torch.channels_last)
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.optimizer = torch.optim.AdamW(network.parameters(), weight_decay=weight_decay, fused=True)
        self._keep = average
        self._cell_weight = cell_weight
        # Convolutions only; weights, losses and steps stay in float32.
        self._bfloat16 = has_bfloat16(network.mean.device)

    def learn(self, batch: Batch, step: int, learning_rate: float) -> float:
        """Take step number `step`, from 0; returns the loss before it.

        Raises
        ------
        TrainingError
            The loss or its gradient is not finite.
        """
        self.network.train()
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.zero_grad(set_to_none=True)
        loss = self._loss(batch)
        if not torch.isfinite(loss):
            raise TrainingError(
                f"training: expected a finite loss, got {loss.item()} at step {step};"
                " check the labels, or train with a lower learning rate or another seed"
            )
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
        if not torch.isfinite(norm):
            raise TrainingError(
                f"training: expected finite gradients, got {norm.item()} at step {step};"
                " train with a lower learning rate or another seed"
            )
        self.optimizer.step()
        # A short memory at first, so that the average does not carry the random start along.
        keep = min(self._keep, (step + 1) / (step + 10))
        pairs = zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True)
        means, values = zip(*((m, v) for m, v in pairs if m.dtype.is_floating_point), strict=True)
        get_ema_multi_avg_fn(keep)(means, values, step)
        return float(loss.detach())

    def _loss(self, batch: Batch) -> Tensor:
        device = self.network.mean.device
        images, xy, known, present = (
            torch.as_tensor(part).to(device) for part in (batch.images, batch.xy, batch.known, batch.present)
        )
        with torch.autocast(device.type, torch.bfloat16, enabled=self._bfloat16):
            maps = self.network(images)
        losses = heatmap_loss(maps, xy, known, present)
        loss = losses["heat"] + losses["offset"] + SPREAD_WEIGHT * losses["spread"]
        return loss + self._cell_weight * cell_loss(maps, xy, known, present) if self._cell_weight else loss


def has_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies numbers in bfloat16 faster than in float32."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if not hasattr(torch.cpu, "get_capabilities"):  # torch before 2.8
        return False
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))


class TwoNetworkTrainer:
    """The two networks of a cascade, a step at a time. A context: torch has half of the cores in every thread there.

    Parameters
    ----------
    network : with the weights to start from, on the device to train on
    average, weight_decay, cell_weight : as `NetworkOptimiser`'s
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
            NetworkOptimiser(part, average=average, weight_decay=weight_decay, cell_weight=cell_weight)
            for part in (network.locator, network.refiner)
        )
        self.learners = {"locator": locator, "refiner": refiner}
        self._locator_share = locator_share
        self.average = Cascade.of(locator.average, refiner.average)

    def __enter__(self) -> TwoNetworkTrainer:
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
