"""Transfer from a source network: which keypoints match, and that their weights are taken over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.networks.cascade import Cascade
from bendtrack.models.networks.checkpoint import Checkpoint
from bendtrack.models.training.settings import TrainingSettings
from bendtrack.models.training.trainer import train
from bendtrack.models.training.transfer import keypoint_mapping, source_checkpoint, transfer_weights
from bendtrack.tracker.angle import AngleDefinition

KNOWN = ("base_1", "base_2", "middle", "tip_1", "tip_2")


@pytest.fixture(params=[2, 3])
def source(request: pytest.FixtureRequest) -> Checkpoint:
    """A network with random weights, heads and statistics; its refiner has as many stages as ours, or fewer."""
    torch.manual_seed(3)
    network = Cascade("resnet18", len(KNOWN), refiner_stages=request.param)
    with torch.no_grad():
        for value in network.state_dict().values():
            if value.dtype.is_floating_point:
                value.add_(0.1 * torch.rand_like(value))
    return Checkpoint(
        network=network.eval(),
        backbone="resnet18",
        keypoints=KNOWN,
        definition=AngleDefinition("two-vector", KNOWN),
        regions=(RegionOfInterest((64, 64), 0, 0, 64, 64, 1.0, 1.0),),
        reference=(1, 0, 3, 4, 3),
        calibration=Calibration(),
    )


@pytest.mark.parametrize(
    ("keypoints", "mapping"),
    [
        (("tip_2", "spot", "base_1"), {"tip_2": "tip_2", "base_1": "base_1"}),
        (("a", "b", "c", "d", "e"), {"a": "base_1", "b": "base_2", "d": "tip_1", "e": "tip_2"}),
        (("a", "b", "c"), {}),
    ],
)
def test_mapped_keypoints_have_the_same_maps_as_in_the_source(
    keypoints: tuple[str, ...], mapping: dict[str, str], source: Checkpoint
) -> None:
    network = Cascade("resnet18", len(keypoints)).eval()
    assert keypoint_mapping(keypoints, KNOWN) == mapping
    transfer_weights(network, keypoints, source, mapping)
    image = torch.randint(
        0, 255, (1, 3, 64, 64), dtype=torch.uint8, generator=torch.Generator().manual_seed(1)
    )
    for part in ("locator", "refiner"):
        with torch.inference_mode():
            ours, theirs = (getattr(n, part)(image) for n in (network, source.network))
        assert float(theirs.heat.std()) > 0
        for own, other in zip(ours, theirs, strict=True):
            for name, known in mapping.items():
                i, j = keypoints.index(name), KNOWN.index(known)
                torch.testing.assert_close(own[:, i], other[:, j], rtol=0, atol=1e-5)


def test_a_training_starts_from_a_trained_network(
    make_frames, definition: AngleDefinition, source: Checkpoint, tmp_path: Path
) -> None:
    file = source.save(tmp_path / "source")
    # A step that changes nothing shows what was there before it.
    settings = TrainingSettings(init=str(file), steps=1, batch_frames=1, learning_rate=0.0)
    trained = train(
        make_frames(np.array([0.0, 30.0])), definition.points, definition, tmp_path / "trained", settings
    )
    assert trained.training["started_from"] == str(file)
    assert torch.equal(trained.network.refiner.conv1.weight, source.network.refiner.conv1.weight)
    assert not torch.equal(source.network.refiner.conv1.weight, source.network.locator.conv1.weight)


def test_only_a_checkpoint_of_ours_with_the_same_backbone_is_a_source(
    source: Checkpoint, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = source.save(tmp_path)
    assert source_checkpoint(str(file), "resnet18") is not None
    assert source_checkpoint(str(file), "resnet50") is None
    assert source_checkpoint("random", "resnet18") is None
    source.save(tmp_path / "random")
    monkeypatch.chdir(tmp_path)
    assert source_checkpoint("random", "resnet18") is None
    save_file({"conv1.weight": torch.zeros(1)}, tmp_path / "plain.safetensors")
    assert source_checkpoint(str(tmp_path / "plain.safetensors"), "resnet18") is None
