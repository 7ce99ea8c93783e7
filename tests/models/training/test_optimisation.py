"""Two networks trained in parallel: each takes its share of the learning rate."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.training.batches import Batch
from bendtrack.models.training.optimisation import TwoNetworkTrainer


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_locator_takes_its_share_of_the_learning_rate(share: float) -> None:
    torch.manual_seed(0)
    network = Cascade("resnet18", 2)
    before = {name: value.clone() for name, value in network.named_parameters()}
    batch = Batch(
        np.zeros((2, 3, 64, 64), np.uint8),
        np.full((2, 2, 2), 30, np.float32),
        np.ones((2, 2), bool),
        np.ones((2, 2), bool),
    )
    with TwoNetworkTrainer(network, average=0.9, weight_decay=0.0, locator_share=share) as pair:
        pair.learn(batch, [batch], 0, 1e-3)
    moved = {
        part: any(
            not torch.equal(value, before[name])
            for name, value in network.named_parameters()
            if name.startswith(part)
        )
        for part in ("locator", "refiner")
    }
    assert moved == {"locator": share > 0, "refiner": True}


def test_two_networks_share_torchs_threads_and_give_them_back() -> None:
    torch.set_num_threads(4)
    with TwoNetworkTrainer(Cascade("resnet18", 2), average=0.9, weight_decay=0.0):
        assert torch.get_num_threads() == 2
    assert torch.get_num_threads() == 4
