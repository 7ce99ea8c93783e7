"""Compiled engines: their quantisation error is recorded, one above the limit is refused, a stale one is not used."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from bendtrack.models.detector import NetworkDetector
from bendtrack.models.export import MAX_DRIFT_PX, MIN_FRAMES, build
from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.inference.runtime import RECORD, engine_folder, engine_record
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.checkpoint import Checkpoint, load_checkpoint
from bendtrack.models.networks.conversion import compiled_networks
from bendtrack.models.networks.end_regressor import EndRegressionNetwork
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import CheckpointError
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.project import Project

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


def frames(n: int, seed: int = 0) -> list[np.ndarray]:
    """Images of coarse noise: structure at every scale, nothing to find."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 255, (n, 12, 16, 3), dtype=np.uint8)
    return [np.kron(image, np.ones((10, 10, 1), np.uint8)) for image in coarse]


def detector_of(folder: Path, engine: str) -> NetworkDetector:
    return NetworkDetector.load(folder, engine=engine, device="cpu")


@pytest.fixture(scope="module")
def untrained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A network with random weights, saved with its engines; its cells disagree by some px about positions."""
    torch.manual_seed(0)
    network = Cascade("resnet18", len(KEYPOINTS)).eval()
    with torch.no_grad():
        network.refiner.head.weight[len(KEYPOINTS) : 3 * len(KEYPOINTS)] *= 300
    checkpoint = Checkpoint(
        network=network,
        backbone="resnet18",
        keypoints=KEYPOINTS,
        definition=AngleDefinition("two-vector", KEYPOINTS),
        regions=(RegionOfInterest((160, 120), 0, 0, 160, 120, 1.0, 1.5),),
        reference=(1, 0, 3, 2),
        calibration=Calibration(),
    )
    file = checkpoint.save(tmp_path_factory.mktemp("untrained"))
    build(checkpoint, file, file_sha256(file), frames(8))
    return file.parent


def test_compiled_float32_equals_torch(untrained: Path) -> None:
    images = np.stack(frames(5, seed=1))
    one, other = (detector_of(untrained, engine).detect(images) for engine in ("torch", "openvino"))
    np.testing.assert_allclose(one.xy, other.xy, atol=2e-3)
    np.testing.assert_allclose(one.likelihood, other.likelihood, atol=1e-4)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-2, atol=1e-4)


def test_networks_compiled_without_files_equal_torch(untrained: Path) -> None:
    checkpoint = load_checkpoint(untrained)
    images, geometry = np.stack(frames(4, seed=1)), checkpoint.geometry_for((160, 120))
    expected = checkpoint.network.estimator(candidates=2).detect(images, geometry)
    found = compiled_networks(checkpoint.network, 2, workers=2, threads=2).detect(images, geometry)
    assert np.linalg.norm(found.xy - expected.xy, axis=2).max() < MAX_DRIFT_PX
    np.testing.assert_allclose(found.likelihood, expected.likelihood, atol=1e-3)


def test_a_compiled_end_regressor_equals_torch(untrained: Path, tmp_path: Path) -> None:
    checkpoint = load_checkpoint(untrained)
    torch.manual_seed(1)
    checkpoint.network.aligner = regressor = EndRegressionNetwork(1).eval()
    regressor.ends[0] = torch.tensor([2, 3])
    torch.nn.init.normal_(regressor.slope, std=1e-4)
    regressor.rest[0] = torch.tensor([1.0, -2.0, 0.1])
    file = checkpoint.save(tmp_path)
    record = build(checkpoint, file, file_sha256(file), frames(8))
    assert record.ends == ((2, 3),)
    images = np.stack(frames(5, seed=1))
    one, other = (detector_of(tmp_path, engine).detect(images) for engine in ("torch", "openvino"))
    np.testing.assert_allclose(one.xy, other.xy, atol=2e-3)
    plain = detector_of(untrained, "openvino").detect(images)
    np.testing.assert_allclose(plain.xy[:, :2], other.xy[:, :2], atol=1e-9)
    assert np.linalg.norm(plain.xy - other.xy, axis=2)[:, 2:].min() > 0.1


def test_an_engine_above_the_drift_limit_is_refused_and_recorded(untrained: Path) -> None:
    file = untrained / "weights.safetensors"
    record = engine_record(file, file_sha256(file))
    check = record.engines["openvino-int8"]
    # Cells that disagree by some px turn rounding into some px.
    assert check.drift_px > MAX_DRIFT_PX
    assert not check.passed
    assert not list(engine_folder(file).glob("*int8*"))
    assert detector_of(untrained, "auto").engine == "openvino"
    with pytest.raises(CheckpointError, match="expected to stay within its limits, got"):
        detector_of(untrained, "openvino-int8")


def test_the_recorded_drift_is_the_measured_drift(untrained: Path) -> None:
    file = untrained / "weights.safetensors"
    check = engine_record(file, file_sha256(file)).engines["openvino"]
    judged = np.stack(frames(8)[1::2])
    one, other = (detector_of(untrained, engine).detect(judged).xy for engine in ("torch", "openvino"))
    assert check.drift_px == pytest.approx(np.sqrt(((one - other) ** 2).sum(axis=2).mean()), abs=2e-4)


def test_an_engine_of_other_weights_or_another_version_is_not_used(untrained: Path, tmp_path: Path) -> None:
    file = untrained / "weights.safetensors"
    assert engine_record(file, "0" * 64) is None
    record = engine_folder(file) / RECORD
    text = record.read_text()
    try:
        for damage in (json.dumps(json.loads(text) | {"openvino": "1.0"}), "{", json.dumps([])):
            record.write_text(damage)
            assert engine_record(file, file_sha256(file)) is None
            assert detector_of(untrained, "auto").engine == "torch"
            with pytest.raises(CheckpointError, match="expected a compiled network, got none"):
                detector_of(untrained, "openvino")
    finally:
        record.write_text(text)


def test_provenance_names_the_engine(trained_project: Project) -> None:
    folder = trained_project.models_dir / "model"
    provenances = [detector_of(folder, engine).provenance for engine in ("torch", "openvino")]
    assert [provenance["engine"] for provenance in provenances] == ["torch", "openvino"]
    assert detector_of(folder, "torch").follow().provenance["follows"] is True


def test_tracking_with_a_compiled_network_needs_no_torch(untrained: Path) -> None:
    code = (
        "import sys, numpy as np; from pathlib import Path; from bendtrack.models import NetworkDetector;"
        f"found = NetworkDetector.load(Path({str(untrained)!r}), device='cpu').follow()"
        ".detect(np.zeros((2, 120, 160, 3), np.uint8)); assert found.xy.shape == (2, 4, 2);"
        "assert not {'torch', 'torchvision'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_chunks_of_a_video_do_not_depend_on_the_cores(untrained: Path) -> None:
    for threads in (1, 2):
        detector = NetworkDetector.load(untrained, engine="openvino", device="cpu", threads=threads)
        assert detector.workers == threads
        lengths = {None: 48, 6000: 48, 60: 30, 31: 16, 5: 8, 0: 8}
        assert {n: detector.chunk_frames((640, 480), n) for n in lengths} == lengths
        assert detector.chunk_frames((1920, 1080), 6000) == 8


def test_low_latency_mode_finds_the_same(untrained: Path) -> None:
    images = frames(3, seed=4)
    low_latency, default = (
        NetworkDetector.load(untrained, engine="openvino", device="cpu", threads=2, low_latency=is_low)
        for is_low in (True, False)
    )
    assert (low_latency.workers, default.workers) == (1, 2)
    one, other = low_latency.detect(images), default.detect(images)
    np.testing.assert_allclose(one.xy, other.xy, atol=1e-3)
    np.testing.assert_allclose(one.likelihood, other.likelihood, atol=1e-4)


@pytest.fixture(scope="module")
def few_frames(untrained: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Checkpoint]:
    """The same network with engines built from too few labelled frames: its folder, and the checkpoint built from."""
    folder = tmp_path_factory.mktemp("few_frames")
    file = Path(shutil.copy(untrained / "weights.safetensors", folder))
    checkpoint = load_checkpoint(file)
    build(checkpoint, file, file_sha256(file), frames(MIN_FRAMES - 1))
    return folder, checkpoint


def test_building_engines_leaves_the_checkpoint_unchanged(
    untrained: Path, few_frames: tuple[Path, Checkpoint]
) -> None:
    image = frames(1, seed=3)[0][None]
    before, after = load_checkpoint(untrained), few_frames[1]
    np.testing.assert_array_equal(before.detect(image).xy, after.detect(image).xy)


def test_the_record_says_why_int8_was_not_built(few_frames: tuple[Path, Checkpoint]) -> None:
    folder, _ = few_frames
    file = folder / "weights.safetensors"
    record = engine_record(file, file_sha256(file))
    assert list(record.engines) == ["openvino"]
    assert record.frames_fitted == 0
    why = "expected at least 4 of the labelled frames that it was trained on, got 3"
    assert record.skipped == {"openvino-int8": why}
    with pytest.raises(CheckpointError, match=f"expected a compiled network, got none: {why}"):
        detector_of(folder, "openvino-int8")
    assert detector_of(folder, "auto").engine == "openvino"
