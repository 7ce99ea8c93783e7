"""The shipped network: present, small, accurate on rendered frames, and copied where engines can be built."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bendtrack.models.data.synthetic import rendered_samples
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.networks.checkpoint import load_checkpoint
from bendtrack.models.networks.shipped import actuator_file, shipped_network, working_copy
from bendtrack.tracker.errors import BendtrackError, WeightsError
from bendtrack.tracker.synthetic.stream import KEYPOINTS

LARGEST_BYTES = 25e6


@pytest.mark.parametrize("backbone", ["resnet18", "resnet50"])
def test_the_shipped_network_finds_canonical_points(backbone: str) -> None:
    checkpoint = load_checkpoint(shipped_network(backbone))
    assert checkpoint.keypoints == KEYPOINTS
    assert checkpoint.backbone == backbone
    assert checkpoint.kind == "pretrained"
    # In images that it was not trained on: those had the seeds 10 and 12.
    pairs = [pair for pair in rendered_samples(1001, range(12)) if pair[0].visible.all()]
    off = []
    for sample, frame in pairs:
        geometry = CropGeometry(frame.region, checkpoint.reference)
        xy = checkpoint.network.estimator().propose(sample.image[None], geometry).xy
        length = np.linalg.norm(np.diff(frame.xy, axis=0), axis=1).sum()
        off.append(np.linalg.norm(xy[0] - frame.xy, axis=1) / length)
    assert len(pairs) >= 5
    assert np.median(off) < 0.05


def test_the_shipped_network_is_small() -> None:
    assert shipped_network("resnet18").stat().st_size <= LARGEST_BYTES


def test_a_backbone_without_a_shipped_network_is_a_weights_error() -> None:
    assert not actuator_file("resnet34").exists()
    with pytest.raises(
        WeightsError, match=r"expected a backbone that they come with \(.*resnet18.*\), got resnet34"
    ):
        shipped_network("resnet34")


def test_the_working_copy_is_the_same_file_in_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = working_copy("resnet18")
    assert folder.is_relative_to(tmp_path)
    assert (folder / "weights.safetensors").read_bytes() == actuator_file("resnet18").read_bytes()
    before = (folder / "weights.safetensors").stat().st_mtime_ns
    assert working_copy("resnet18") == folder
    assert (folder / "weights.safetensors").stat().st_mtime_ns == before


def test_a_cache_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bendtrack").write_text("a file where a folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(BendtrackError, match="expected a cache folder that can be written"):
        working_copy("resnet18")
