"""Self-training of the shipped network on one rendered film: positives, negatives, outlier rejection."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from bendtrack.models.adaptation import self_training
from bendtrack.models.adaptation.self_training import self_train, typical_appearance
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.roi import RegionOfInterest, regions_of_interest
from bendtrack.models.localization.probe_frames import PseudoLabels
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.checkpoint import Checkpoint
from bendtrack.tracker.types import BoolArray

FRAMES = 24
SIZE_WH = (400, 300)
NO_NEGATIVES = np.zeros((FRAMES, 2), bool)


@pytest.fixture(scope="module")
def film(render_film) -> tuple[np.ndarray, np.ndarray, RegionOfInterest]:
    """Frames (N, H, W, 3) of one actuator while it bends, its keypoints (N, 9, 2) px, and where it is."""
    own = render_film(FRAMES)
    (region,) = regions_of_interest(own.keypoints_xy, [SIZE_WH] * FRAMES)
    return own.images, own.keypoints_xy, region


def test_self_training_learns_its_positives_and_leaves_the_source_network_unchanged(
    film, shipped: Checkpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The pseudo-labels put the tip half an end nearer to the fixed end; other frames judge."""
    images, truth, region = film
    geometry = CropGeometry(region, shipped.reference)
    wanted = truth.copy()
    wanted[:, -1] += 0.5 * (truth[:, -2] - truth[:, -1])
    is_trained_on = np.arange(FRAMES) % 3 > 0
    before = {name: value.clone() for name, value in shipped.network.state_dict().items()}
    steps: list[tuple[int, int | None]] = []
    monkeypatch.setattr(self_training, "REPLAY_FRAMES", 4)
    monkeypatch.setattr(self_training, "SETTINGS", replace(self_training.SETTINGS, steps=40))
    trained = self_train(
        shipped.network,
        images,
        PseudoLabels(wanted, is_trained_on, NO_NEGATIVES),
        region,
        shipped.reference,
        lambda *done: steps.append(done),
    )
    assert steps == [(i + 1, 40) for i in range(40)]

    def off_px(network: Cascade) -> float:
        found = network.estimator().refine(images[~is_trained_on], truth[~is_trained_on], geometry)
        return float(np.median(np.linalg.norm(found.xy[:, -1] - wanted[~is_trained_on, -1], axis=1)))

    assert off_px(trained) < 0.5 * off_px(shipped.network)
    after = shipped.network.state_dict()
    assert all(torch.equal(value, after[name]) for name, value in before.items())


def test_an_end_of_atypical_appearance_is_rejected(film, features) -> None:
    images, truth, region = film
    odd = images.copy()
    x, y = truth[7, -1].astype(int)
    odd[7, max(y - 30, 0) : y + 30, max(x - 30, 0) : x + 30] = (10, 90, 30)  # something covers it
    sure = np.ones(FRAMES, bool)
    sure[3] = False
    labels = PseudoLabels(truth, sure, NO_NEGATIVES)
    kept = typical_appearance(odd, labels, region, features)
    assert not kept[[3, 7]].any()
    assert kept.sum() >= FRAMES - 4
    assert typical_appearance(images, labels, region, features)[7]


def test_negatives_lower_the_peak_where_the_network_was_wrong(
    film, shipped: Checkpoint, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a third of the frames the fixed end, reversed, was taken for the moving end."""
    images, truth, region = film
    geometry = CropGeometry(region, shipped.reference)
    wrong = np.arange(FRAMES) % 3 == 0
    xy = truth.copy()
    xy[wrong, -2:] = truth[wrong, 1::-1]
    monkeypatch.setattr(self_training, "REPLAY_FRAMES", 4)
    monkeypatch.setattr(self_training, "SETTINGS", replace(self_training.SETTINGS, steps=40))

    def peak(negative: BoolArray) -> float:
        labels = PseudoLabels(xy, ~wrong, negative)
        trained = self_train(shipped.network, images, labels, region, shipped.reference)
        found = trained.estimator().refine(images[wrong], xy[wrong], geometry)
        return float(np.median(found.likelihood[:, -1]))

    assert peak(np.tile(wrong[:, None], 2)) < 0.5 * peak(NO_NEGATIVES)
