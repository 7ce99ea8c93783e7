"""Adaptation to one video, on rendered frames whose truth is known: registration, end regression, self-training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bendtrack.models.adaptation import self_training
from bendtrack.models.adaptation.adapt import register_and_fit
from bendtrack.models.detector import NetworkDetector
from bendtrack.models.export import build
from bendtrack.models.inference.affine import stacked
from bendtrack.models.inference.crops import crop_end, move_ends
from bendtrack.models.inference.metadata import WEIGHTS_FILE
from bendtrack.models.inference.roi import orientations, regions_of_interest
from bendtrack.models.inference.stages import StageSettings
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.models.networks.conversion import compiled_end_regressor
from bendtrack.models.networks.end_regressor import TorchEndRegressor
from bendtrack.models.networks.shipped import shipped_network, working_copy
from bendtrack.tracker.angle import bending_angle
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.synthetic.stream import KEYPOINTS

FRAMES = 32
SIZE_WH = (400, 300)
ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
REFERENCE = (1, 0, 3, 2)


@pytest.fixture(scope="module")
def film(render_film):
    """Frames of one actuator while it bends, where its ends are (N, 4, 2) px, and its angle (N,) degrees."""
    own = render_film(FRAMES)
    return own.images, own.keypoints_xy[:, ENDS], own.angle_deg


def tip_deg(xy: np.ndarray, truth: np.ndarray) -> np.ndarray:
    difference = orientations(xy, REFERENCE)[:, 3] - orientations(truth, REFERENCE)[:, 3]
    return np.asarray(np.degrees((difference + np.pi) % (2 * np.pi) - np.pi))


def test_registered_ends_train_a_regressor_that_corrects_other_frames(film, features) -> None:
    images, truth, _ = film
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    found = truth + np.random.default_rng(0).normal(0, 0.8, truth.shape)
    probe_frames, others = slice(0, None, 2), slice(1, None, 2)
    inlier = np.ones(FRAMES // 2, bool)
    inlier[5] = False
    registered, network = register_and_fit(
        images[probe_frames], found[probe_frames], inlier, region, REFERENCE, features
    )
    before, after = (
        tip_deg(found[probe_frames], truth[probe_frames]),
        tip_deg(registered, truth[probe_frames]),
    )
    assert after[inlier].std() < 0.5 * before[inlier].std()
    np.testing.assert_array_equal(registered[5], found[probe_frames][5])
    np.testing.assert_array_equal(registered[:, :2], found[probe_frames][:, :2])
    assert network is not None
    crops = [crop_end(image, xy[2:], region).image for image, xy in zip(images, found, strict=True)]
    steps = TorchEndRegressor(network)(stacked(crops[others]))[:, 0]
    compiled = compiled_end_regressor(network, workers=2, threads=2)
    assert compiled.ends == ((2, 3),)
    np.testing.assert_allclose(compiled(stacked(crops[others]))[:, 0], steps, atol=1e-3)
    corrected = found[others].copy()
    corrected[:, 2:] = move_ends(corrected[:, 2:], steps, region.refiner_scale)
    assert tip_deg(corrected, truth[others]).std() < 0.5 * tip_deg(found[others], truth[others]).std()


def test_noise_images_give_no_end_regressor(film, features) -> None:
    _, truth, _ = film
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    noise = np.random.default_rng(1).integers(0, 255, (FRAMES, SIZE_WH[1], SIZE_WH[0], 3), dtype=np.uint8)
    found = truth + np.random.default_rng(0).normal(0, 0.8, truth.shape)
    assert register_and_fit(noise, found, np.ones(FRAMES, bool), region, REFERENCE, features)[1] is None


def test_the_shipped_network_measures_an_actuator_without_labels(film) -> None:
    """With an end regressor, which is fitted to the video."""
    images, _, angle_deg = film
    network: Path = shipped_network("resnet18")
    detector = NetworkDetector.load(network, engine="torch")
    assert detector._estimator.end_regressor is None
    fitted = detector.for_video(images)
    assert fitted._estimator.end_regressor.ends == ((7, 8),)
    found = fitted.detect(images[::4])
    angle, _, _ = bending_angle(found.xy, fitted.keypoints, fitted.metadata.definition)
    error = np.abs(angle) - np.abs(angle_deg[::4])
    assert np.sqrt(np.mean(error**2)) < 1.0


def test_an_unsure_network_is_self_trained_unless_the_stage_is_off(
    film, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Something lies on the tip in every fourth frame."""
    images, truth, _ = film
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    network = working_copy("resnet18") / WEIGHTS_FILE
    build(load_checkpoint(network), network, file_sha256(network), list(images[:2]))
    hidden = images.copy()
    for image, (x, y) in zip(hidden[::4], truth[::4, -1].astype(int), strict=True):
        image[max(y - 40, 0) : y + 40, max(x - 40, 0) : x + 40] = (60, 110, 60)
    monkeypatch.setattr(self_training, "REPLAY_FRAMES", 4)
    monkeypatch.setattr(self_training, "SETTINGS", replace(self_training.SETTINGS, steps=3))
    steps: list[tuple[int, int | None]] = []
    for engine, self_trains in (("torch", False), ("openvino", True)):
        steps.clear()
        detector = NetworkDetector.load(
            network, engine=engine, stages=StageSettings(self_training=self_trains)
        )
        fitted = detector.for_video(hidden, lambda *done: steps.append(done))
        assert steps == ([(1, 3), (2, 3), (3, 3)] if self_trains else [])
        assert fitted.provenance == detector.provenance
        assert fitted.provenance["stages"]["self_training"] == self_trains
        # Three steps change little; they show that the fitted networks run.
        found = fitted.detect(hidden[1::4])
        assert np.median(np.linalg.norm(found.xy[:, -1] - truth[1::4, -1], axis=1)) < 3
    steps.clear()
    detector.for_video(images, lambda *done: steps.append(done))
    assert steps == []


def test_a_base_that_moves_is_registered_and_regressed_as_the_moving_end_is(film, features) -> None:
    images, truth, _ = film
    (region,) = regions_of_interest(truth, [SIZE_WH] * FRAMES)
    found = truth + np.random.default_rng(0).normal(0, 0.8, truth.shape)
    some = slice(0, None, 2)
    registered, network = register_and_fit(
        images[some], found[some], np.ones(FRAMES // 2, bool), region, REFERENCE, features, base_moves=True
    )
    before, after = (
        orientations(xy, REFERENCE)[:, 0] - orientations(truth[some], REFERENCE)[:, 0]
        for xy in (found[some], registered)
    )
    assert after.std() < 0.5 * before.std()
    assert network is not None
    assert TorchEndRegressor(network).ends == ((0, 1), (2, 3))
