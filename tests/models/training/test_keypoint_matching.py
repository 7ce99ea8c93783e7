"""Keypoint matching by image content: labels match canonical keypoints, whatever their names and order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.models.networks.checkpoint import Checkpoint
from bendtrack.models.training.keypoint_matching import match_keypoints
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.models.training.transfer import keypoint_mapping
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.synthetic.stream import KEYPOINTS, TRAINING, Renderer, Sample, drawn_look
from bendtrack.tracker.types import LabelledFrame


@pytest.fixture(scope="module")
def source(shipped: Checkpoint) -> Checkpoint:
    return shipped


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """An actuator in eight bends."""
    look = drawn_look(778, 3, size_wh=(480, 360), families=TRAINING, bend_deg=(0.0, 170.0))
    renderer = Renderer(look)
    return [renderer.frame(float(bend), noise_seed=i) for i, bend in enumerate(np.linspace(0, 170, 8))]


def labels_of(samples: Sequence[Sample], points: Sequence[str]) -> np.ndarray:
    """Noisy labels (sd 1 px) of those canonical keypoints."""
    xy = np.stack([sample.keypoints_xy[[KEYPOINTS.index(point) for point in points]] for sample in samples])
    return xy + np.random.default_rng(0).normal(0, 1.0, xy.shape)


@pytest.mark.parametrize(
    "points",
    [
        ("base_1", "base_2", "tip_1", "tip_2"),
        ("tip_2", "tip_1", "base_2", "base_1"),
        ("tip_2", "mid_3", "base_1"),
    ],
    ids=["in the usual order", "tip first", "three points"],
)
def test_keypoints_match_by_where_they_are_labelled(
    points: tuple[str, ...], samples: list[Sample], source: Checkpoint
) -> None:
    names = ("a", "b", "c", "d")[: len(points)]
    images = [sample.image for sample in samples]
    matched = match_keypoints(source, names, labels_of(samples, points), images, ["film"] * len(samples))
    assert matched == dict(zip(names, points, strict=True))
    assert keypoint_mapping(names, source.keypoints, matched) == matched


def test_a_label_away_from_all_canonical_keypoints_matches_none(
    samples: list[Sample], source: Checkpoint
) -> None:
    """Something that hangs on the tip does not keep the tip from being known."""
    names, points = ("root", "tip", "load"), ("base_1", "tip_2", "tip_2")
    labels, images = labels_of(samples, points), [sample.image for sample in samples]
    labels[:, 2] += 1.5 * (labels[:, 1] - np.stack([sample.keypoints_xy[-2] for sample in samples]))
    matched = match_keypoints(source, names, labels, images, ["film"] * len(samples))
    assert matched == {"root": "base_1", "tip": "tip_2"}
    # Nor is it taken for what stands at its place in the list.
    assert keypoint_mapping(("root", "neck", "tip", "load"), source.keypoints, matched) == matched


def test_too_few_frames_or_images_without_an_actuator_match_nothing(
    samples: list[Sample], source: Checkpoint
) -> None:
    names, points = ("a", "b"), ("tip_2", "base_1")
    labels, images = labels_of(samples, points), [sample.image for sample in samples]
    assert match_keypoints(source, names, labels[:3], images[:3], ["film"] * 3) == {}
    assert match_keypoints(source, names, labels, images, [f"film {i % 3}" for i in range(8)]) == {}
    empty = [np.full_like(image, 128) for image in images]
    assert match_keypoints(source, names, labels, empty, ["film"] * 8) == {}


def test_frames_with_missing_labels_match_too(samples: list[Sample], source: Checkpoint) -> None:
    names, points = ("a", "b", "never"), ("tip_2", "base_1", "mid_3")
    labels, images = labels_of(samples, points), [sample.image for sample in samples]
    labels[::2, 0] = np.nan
    labels[:, 2] = np.nan
    assert match_keypoints(source, names, labels, images, ["film"] * 8) == {"a": "tip_2", "b": "base_1"}


@pytest.mark.slow
@pytest.mark.parametrize("backbone", ["resnet18", "resnet50"])
def test_a_training_starts_with_the_heads_that_its_labels_match(
    backbone: str, samples: list[Sample], tmp_path: Path
) -> None:
    names = ("nail", "wrist", "neck", "root")
    labels = labels_of(samples, ("tip_2", "tip_1", "base_2", "base_1"))
    frames = []
    for i, sample in enumerate(samples):
        path = tmp_path / f"img{i:05d}.png"
        cv2.imwrite(str(path), sample.image[..., ::-1])
        frames.append(LabelledFrame("film", path, labels[i], "default", i))
    # A step that changes nothing: what is found is what was known before.
    settings = TrainingSettings(
        backbone=backbone,
        init="actuator",
        steps=1,
        batch_frames=1,
        learning_rate=0.0,
        held_out=0.0,
        consensus=0.0,
    )
    network = train(frames, names, AngleDefinition("two-vector", names), tmp_path / "model", settings)
    known = dict(zip(names, ("tip_2", "tip_1", "base_2", "base_1"), strict=True))
    assert network.training["known_before"] == known
    found = network.detect(np.stack([sample.image for sample in samples]))
    off = np.linalg.norm(found.xy - labels, axis=2)
    assert np.median(off) < 6
    # Where the straight ends begin to bend nothing shows: there points slide along the body.
    assert np.median(off[:, [0, 3]], axis=0).max() < 6
