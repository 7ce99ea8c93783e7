"""A network that knows actuators learns one by itself from the frames of a video in which it is sure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from bendtrack.models.adaptation import self_training
from bendtrack.models.adaptation.self_training import alike, self_train
from bendtrack.models.denoising.registration import shipped_features
from bendtrack.models.inference.roi import RegionOfInterest, regions_of_interest
from bendtrack.models.localization.probe_frames import PseudoLabels
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.checkpoint import Checkpoint, load_checkpoint
from bendtrack.models.networks.shipped import shipped_network
from bendtrack.tracker.synthetic.stream import TRAINING, Renderer, drawn_look, inflation_deg
from bendtrack.tracker.types import BoolArray

FRAMES = 24
SIZE_WH = (400, 300)
NOTHING_WRONG = np.zeros((FRAMES, 2), bool)


@pytest.fixture(scope="module")
def film() -> tuple[np.ndarray, np.ndarray, RegionOfInterest]:
    """Frames (N, H, W, 3) of one actuator while it bends, its keypoints (N, 9, 2) px, and where it is."""
    look = drawn_look(21, 3, size_wh=SIZE_WH, families=TRAINING, bend_deg=(0.0, 150.0))
    stage = Renderer(look)
    samples = [stage.frame(float(bend), noise_seed=i) for i, bend in enumerate(inflation_deg(look, FRAMES))]
    truth = np.stack([sample.keypoints_xy for sample in samples])
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    return np.stack([sample.image for sample in samples]), truth, region


@pytest.fixture(scope="module")
def shipped() -> Checkpoint:
    return load_checkpoint(shipped_network("resnet18"))


def test_it_learns_what_it_is_shown_and_the_network_it_began_with_stays_as_it_was(
    film, shipped: Checkpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is shown a tip a little nearer to the fixed end than it would see it, and not in the frames that count."""
    pictures, truth, region = film
    wanted = truth.copy()
    wanted[:, -1] += 0.5 * (truth[:, -2] - truth[:, -1])
    shown = np.arange(FRAMES) % 3 > 0
    before = {name: value.clone() for name, value in shipped.network.state_dict().items()}
    steps: list[tuple[int, int | None]] = []
    monkeypatch.setattr(self_training, "REHEARSED", 4)
    monkeypatch.setattr(self_training, "SETTINGS", replace(self_training.SETTINGS, steps=40))
    taught = self_train(
        shipped.network,
        pictures,
        PseudoLabels(wanted, shown, NOTHING_WRONG),
        region,
        shipped.reference,
        lambda *done: steps.append(done),
    )
    assert steps == [(i + 1, 40) for i in range(40)]

    def off_px(network: Cascade) -> float:
        found = network.estimator().refine(pictures[~shown], truth[~shown], region, shipped.reference)
        return float(np.median(np.linalg.norm(found.xy[:, -1] - wanted[~shown, -1], axis=1)))

    assert off_px(taught) < 0.5 * off_px(shipped.network)
    after = shipped.network.state_dict()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_an_end_that_looks_like_no_other_is_not_learnt_from(film) -> None:
    pictures, truth, region = film
    odd = pictures.copy()
    x, y = truth[7, -1].astype(int)
    odd[7, max(y - 30, 0) : y + 30, max(x - 30, 0) : x + 30] = (10, 90, 30)  # something lies on it
    sure = np.ones(FRAMES, bool)
    sure[3] = False
    features = shipped_features()
    examples = PseudoLabels(truth, sure, NOTHING_WRONG)
    kept = alike(odd, examples, region, features)
    assert not kept[[3, 7]].any()
    assert kept.sum() >= FRAMES - 4
    assert alike(pictures, examples, region, features)[7]


def test_what_was_taken_for_the_moving_end_and_is_not_is_not_taken_for_it_again(
    film, shipped: Checkpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a third of the frames the fixed end was taken for it, the other way round."""
    pictures, truth, region = film
    wrong = np.arange(FRAMES) % 3 == 0
    xy = truth.copy()
    xy[wrong, -2:] = truth[wrong, 1::-1]
    monkeypatch.setattr(self_training, "REHEARSED", 4)
    monkeypatch.setattr(self_training, "SETTINGS", replace(self_training.SETTINGS, steps=40))

    def peak(said: BoolArray) -> float:
        examples = PseudoLabels(xy, ~wrong, said)
        taught = self_train(shipped.network, pictures, examples, region, shipped.reference)
        found = taught.estimator().refine(pictures[wrong], xy[wrong], region, shipped.reference)
        return float(np.median(found.likelihood[:, -1]))

    assert peak(np.tile(wrong[:, None], 2)) < 0.5 * peak(NOTHING_WRONG)
