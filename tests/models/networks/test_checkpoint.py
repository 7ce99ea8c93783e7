"""Checkpoints: a round trip changes nothing, older files are read, other files are a CheckpointError."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.metadata import FORMAT, OLDEST_FORMAT, PRETRAINED_CANDIDATES, WEIGHTS_FILE
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.checkpoint import Checkpoint, load_checkpoint
from bendtrack.models.networks.end_regressor import EndRegressionNetwork
from bendtrack.models.networks.tensor_files import write_tensors
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import CheckpointError

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2", "Schlauch")


@pytest.fixture
def checkpoint() -> Checkpoint:
    torch.manual_seed(0)
    return Checkpoint(
        network=Cascade("resnet18", 5).eval(),
        backbone="resnet18",
        keypoints=KEYPOINTS,
        definition=AngleDefinition("two-vector", KEYPOINTS[:4], -1),
        regions=(
            RegionOfInterest((160, 120), 10, 20, 100, 90, 1.0, 1.5),
            RegionOfInterest((320, 240), 20, 40, 200, 180, 0.5, 0.75),
        ),
        reference=(1, 0, 3, 2, 0),
        calibration=Calibration(1.5, 0.9, 27, (0.8, 0.9, 0.7, 0.6, 1.0)),
        systematic_bias=tuple(((x, 0.5), (0.1, 0.2), (0.0, x)) for x in (0.5, -0.25, 0.0, 0.3, 1.0)),
        distance_range=((20.0, 24.5), (20.0, 24.5), (0.0, np.inf), (31.0, 40.0), (31.0, 40.0)),
        training={"trained_on": ["v/img00001.png"], "started_from": "random"},
    )


def test_round_trip(checkpoint: Checkpoint, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "model")
    again = load_checkpoint(tmp_path / "model")
    assert (
        again.to_dict()
        == checkpoint.to_dict()
        == json.loads((tmp_path / "model/checkpoint.json").read_text())
    )
    frames = np.random.default_rng(0).integers(0, 255, (2, 120, 160, 3), dtype=np.uint8)
    before, after = checkpoint.detect(frames), again.detect(frames)
    np.testing.assert_array_equal(before.xy, after.xy)
    np.testing.assert_array_equal(before.covariance, after.covariance)
    assert again.region_for((320, 240)).locator_scale == 0.5
    assert again.region_for((640, 480)).width == 640


def with_end_regressor(checkpoint: Checkpoint) -> Checkpoint:
    """The same with an end regressor that moves the second pair of keypoints."""
    torch.manual_seed(1)
    regressor = EndRegressionNetwork(1)
    regressor.ends[0] = torch.tensor([2, 3])
    torch.nn.init.normal_(regressor.slope, std=1e-4)
    regressor.rest[:] = torch.tensor([2.0, -3.0, 0.1])
    checkpoint.network.aligner = regressor.eval()
    return checkpoint


def test_round_trip_of_an_end_regressor(checkpoint: Checkpoint, tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 255, (2, 120, 160, 3), dtype=np.uint8)
    without = checkpoint.detect(frames)
    before = with_end_regressor(checkpoint).detect(frames)
    checkpoint.save(tmp_path / "model")
    after = load_checkpoint(tmp_path / "model").detect(frames)
    np.testing.assert_array_equal(before.xy, after.xy)
    assert np.abs(after.xy - without.xy)[:, 2:4].min(axis=(0, 1)).max() > 0.1
    np.testing.assert_array_equal(after.xy[:, [0, 1, 4]], without.xy[:, [0, 1, 4]])


def test_the_oldest_format_is_read(checkpoint: Checkpoint, tmp_path: Path) -> None:
    metadata = checkpoint.to_dict() | {"format": OLDEST_FORMAT}
    write_tensors(tmp_path / WEIGHTS_FILE, checkpoint.network.state_dict(), metadata)
    frames = np.random.default_rng(0).integers(0, 255, (1, 120, 160, 3), dtype=np.uint8)
    np.testing.assert_array_equal(load_checkpoint(tmp_path).detect(frames).xy, checkpoint.detect(frames).xy)


def test_the_weights_file_has_the_usual_permissions(checkpoint: Checkpoint, tmp_path: Path) -> None:
    file = checkpoint.save(tmp_path)
    assert file.stat().st_mode == (tmp_path / "checkpoint.json").stat().st_mode


def test_float16_halves_the_file_and_hardly_changes_the_weights(
    checkpoint: Checkpoint, tmp_path: Path
) -> None:
    whole, half = checkpoint.save(tmp_path / "whole"), checkpoint.save(tmp_path / "half", half=True)
    assert half.stat().st_size < 0.51 * whole.stat().st_size
    again = load_checkpoint(half)
    assert again.to_dict() == checkpoint.to_dict()
    for name, value in checkpoint.network.state_dict().items():
        torch.testing.assert_close(again.network.state_dict()[name], value, rtol=5e-4, atol=1e-7)


@pytest.mark.parametrize("stages", [(3, 2), (4, 2)])
def test_networks_with_fewer_residual_stages_are_read(
    stages: tuple[int, int], checkpoint: Checkpoint, tmp_path: Path
) -> None:
    early = replace(checkpoint, network=Cascade("resnet18", 5, *stages).eval())
    early.save(tmp_path)
    frames = np.random.default_rng(0).integers(0, 255, (1, 120, 160, 3), dtype=np.uint8)
    np.testing.assert_array_equal(load_checkpoint(tmp_path).detect(frames).xy, early.detect(frames).xy)


def test_a_constant_systematic_bias_of_an_older_file_is_read(checkpoint: Checkpoint, tmp_path: Path) -> None:
    early = replace(checkpoint, systematic_bias=tuple((of[0],) for of in checkpoint.systematic_bias))
    metadata = early.to_dict()
    metadata["label_offset_patch_px"] = [of[0] for of in metadata["label_offset_patch_px"]]
    write_tensors(tmp_path / WEIGHTS_FILE, checkpoint.network.state_dict(), metadata)
    again = load_checkpoint(tmp_path)
    assert again.to_dict() == early.to_dict()
    frames = np.random.default_rng(0).integers(0, 255, (1, 120, 160, 3), dtype=np.uint8)
    np.testing.assert_array_equal(again.detect(frames).xy, early.detect(frames).xy)


def test_the_hash_identifies_a_network_in_any_folder(checkpoint: Checkpoint, tmp_path: Path) -> None:
    checkpoint.save(tmp_path / "a")
    (tmp_path / "a").rename(tmp_path / "b")
    first = NetworkDetector.load(tmp_path / "b").provenance
    with torch.no_grad():
        checkpoint.network.locator.head.bias += 0.1
    checkpoint.save(tmp_path / "c")
    second = NetworkDetector.load(tmp_path / "c" / WEIGHTS_FILE).provenance
    assert first["checkpoint_sha256"] != second["checkpoint_sha256"]


def test_a_checkpoint_is_safetensors_with_metadata_and_no_pickle(
    checkpoint: Checkpoint, tmp_path: Path
) -> None:
    path = checkpoint.save(tmp_path)
    with safe_open(path, "pt") as file:
        assert json.loads(file.metadata()["bendtrack"])["keypoints"] == list(KEYPOINTS)
    assert {p.name for p in tmp_path.iterdir()} == {WEIGHTS_FILE, "checkpoint.json"}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("missing", "expected a trained network at"),
        ("text", "got a damaged file"),
        ("truncated", "got a damaged file"),
        ("foreign", "safetensors without its header"),
        (
            "newer",
            f"expected checkpoint format {OLDEST_FORMAT} to {FORMAT}, got {FORMAT + 1}: update bendtrack",
        ),
        (
            "older",
            f"expected checkpoint format {OLDEST_FORMAT} to {FORMAT}, got {OLDEST_FORMAT - 1}: train again",
        ),
        ("backbone", "expected a known backbone, got 'resnet9000'"),
        ("other weights", "got a damaged file"),
    ],
)
def test_a_file_that_is_no_checkpoint_is_a_checkpoint_error(
    damage: str, message: str, checkpoint: Checkpoint, tmp_path: Path
) -> None:
    path = checkpoint.save(tmp_path)
    metadata, tensors = checkpoint.to_dict(), load_file(path)
    if damage == "missing":
        path.unlink()
    elif damage == "text":
        path.write_text("weights")
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:-100])
    elif damage == "foreign":
        save_file({"a": torch.zeros(2)}, path)
    elif damage in ("newer", "older"):
        other = FORMAT + 1 if damage == "newer" else OLDEST_FORMAT - 1
        save_file(tensors, path, {"bendtrack": json.dumps(metadata | {"format": other})})
    elif damage == "backbone":
        save_file(tensors, path, {"bendtrack": json.dumps(metadata | {"backbone": "resnet9000"})})
    elif damage == "other weights":
        save_file({"a": torch.zeros(2)}, path, {"bendtrack": json.dumps(metadata)})
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(tmp_path)


@pytest.mark.parametrize("kind", ["project", "pretrained"])
def test_round_trip_of_the_kind(kind: str, checkpoint: Checkpoint, tmp_path: Path) -> None:
    file = replace(checkpoint, kind=kind).save(tmp_path)
    with safe_open(file, "pt") as opened:
        assert json.loads(opened.metadata()["bendtrack"])["kind"] == kind
    again = load_checkpoint(file)
    assert again.kind == kind
    assert again.pretrained == (kind == "pretrained")
    assert again.candidates == (PRETRAINED_CANDIDATES if again.pretrained else 1)


@pytest.mark.parametrize(
    ("training", "kind"),
    [({"pictures": 3000}, "pretrained"), ({"trained_on": []}, "project"), ({}, "project")],
)
def test_the_kind_of_an_older_file_follows_from_its_training(
    training: dict[str, object], kind: str, checkpoint: Checkpoint, tmp_path: Path
) -> None:
    metadata = checkpoint.to_dict() | {"training": training}
    del metadata["kind"]
    write_tensors(tmp_path / WEIGHTS_FILE, checkpoint.network.state_dict(), metadata)
    assert load_checkpoint(tmp_path).kind == kind


def test_a_foreign_kind_is_a_checkpoint_error(checkpoint: Checkpoint, tmp_path: Path) -> None:
    metadata = checkpoint.to_dict() | {"kind": "borrowed"}
    write_tensors(tmp_path / WEIGHTS_FILE, checkpoint.network.state_dict(), metadata)
    with pytest.raises(CheckpointError, match="expected project or pretrained, got 'borrowed'"):
        load_checkpoint(tmp_path)
