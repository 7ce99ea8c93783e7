"""Optimisation steps: a network with its optimiser and its exponential moving average (EMA), and two in parallel.

What batches a step takes is drawn in `batches`.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
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
"""Weight of the spread loss: the head should describe the residuals without steering the features."""

LARGEST_GRADIENT = 5.0
"""Norm that gradients are clipped to, so that one odd batch does not throw the weights off."""


class NetworkOptimiser:
    """A network with its AdamW optimiser and the EMA of its weights.

    Parameters
    ----------
    network : HeatmapNetwork
        With its initial weights, on the device to train on; trained in place.
    average : float
        Decay of the EMA: the share of the averaged weights that is kept in each step.
    weight_decay : float
        AdamW's.
    cell_weight : float
        Weight of `heatmaps.cell_loss`.

    Attributes
    ----------
    network : HeatmapNetwork
        The one in training.
    average : HeatmapNetwork
        The same with averaged weights.
    optimizer : torch.optim.AdamW
    """

    def __init__(
        self,
        network: HeatmapNetwork,
        *,
        average: float,
        weight_decay: float,
        cell_weight: float = 0.0,
    ) -> None:
        # Channels last: the layout in which convolutions in bfloat16 are fastest.
        self.network = convert_conv2d_weight_memory_format(network, torch.channels_last)
        self.average = copy.deepcopy(network).requires_grad_(False)
        self.optimizer = torch.optim.AdamW(network.parameters(), weight_decay=weight_decay, fused=True)
        self._ema_decay = average
        self._cell_weight = cell_weight
        # For convolutions only; weights, losses and optimiser steps stay in float32.
        self._bfloat16 = has_bfloat16(network.mean.device)

    def learn(self, batch: Batch, step: int, learning_rate: float) -> float:
        """Take one optimisation step.

        Parameters
        ----------
        batch : Batch
        step : int
            Its number, from 0.
        learning_rate : float

        Returns
        -------
        float
            The loss before the step.

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
        # The decay rises from 0.1, so that the average soon forgets the random start.
        decay = min(self._ema_decay, (step + 1) / (step + 10))
        pairs = zip(self.average.state_dict().values(), self.network.state_dict().values(), strict=True)
        means, values = zip(*((m, v) for m, v in pairs if m.dtype.is_floating_point), strict=True)
        get_ema_multi_avg_fn(decay)(means, values, step)
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
    """Whether a device computes faster in bfloat16 than in float32."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    if not hasattr(torch.cpu, "get_capabilities"):  # torch before 2.8
        return False
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))


class TwoNetworkTrainer:
    """Both networks of a cascade, which take their steps in parallel.

    A context manager, entered once: within it torch computes with half of its threads, since two networks share the
    cores; afterwards the number of threads is what it was.

    Parameters
    ----------
    network : Cascade
        With its initial weights, on the device to train on; trained in place.
    average, weight_decay, cell_weight : float
        As `NetworkOptimiser`'s.
    locator_share : float
        Share of the learning rate that the locator takes.

    Attributes
    ----------
    optimisers : dict from str to NetworkOptimiser
        Both optimisers, by the names that their networks have in a cascade.
    average : Cascade
        The networks with averaged weights.
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
        self.optimisers = {"locator": locator, "refiner": refiner}
        self._locator_share = locator_share
        self.average = Cascade.of(locator.average, refiner.average)
        self._pool = ThreadPoolExecutor(max_workers=1)
        self._on_exit = ExitStack()

    def __enter__(self) -> TwoNetworkTrainer:
        threads = torch.get_num_threads()
        self._on_exit.callback(torch.set_num_threads, threads)
        self._on_exit.enter_context(self._pool)
        torch.set_num_threads(max(1, threads // 2))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._on_exit.close()

    def learn(self, locate: Batch, refine: Sequence[Batch], step: int, learning_rate: float) -> float:
        """Take one step of the locator and, in the meantime, one of the refiner for each of its batches.

        Parameters
        ----------
        locate : Batch
            The locator's.
        refine : sequence of Batch
            The refiner's.
        step : int
            Its number, from 0.
        learning_rate : float

        Returns
        -------
        float
            The locator's loss plus the mean of the refiner's.

        Raises
        ------
        TrainingError
            A loss or its gradient is not finite.
        """
        locator_loss = self._pool.submit(
            self.optimisers["locator"].learn, locate, step, learning_rate * self._locator_share
        )
        refiner, first = self.optimisers["refiner"], step * len(refine)
        losses = [refiner.learn(batch, first + i, learning_rate) for i, batch in enumerate(refine)]
        return locator_loss.result() + sum(losses) / len(losses)

    def state_of_average(self) -> dict[str, Tensor]:
        """A copy of the averaged weights."""
        return {name: value.clone() for name, value in self.average.state_dict().items()}
