"""The network's shapes, its normalisation, and starting weights from real files."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import torch
import torchvision
from safetensors.torch import save_file

from bendtrack.models.networks import initialisation
from bendtrack.models.networks.heatmap_network import BACKBONES, HeatmapNetwork
from bendtrack.models.networks.initialisation import (
    imagenet_file,
    load_backbone,
    resolve_init,
    starting_weights,
)
from bendtrack.tracker.errors import WeightsError


@pytest.mark.parametrize("backbone", BACKBONES)
@pytest.mark.parametrize("stages", [2, 3])
def test_maps_have_a_cell_for_every_four_px(backbone: str, stages: int) -> None:
    maps = HeatmapNetwork(backbone, stages, n_keypoints=5)(torch.zeros(2, 3, 48, 64, dtype=torch.uint8))
    assert maps.heat.shape == (2, 5, 12, 16)
    assert maps.offset.shape == (2, 5, 2, 12, 16)
    assert maps.spread.shape == (2, 5, 3, 12, 16)
    assert float(maps.heat.detach().sigmoid().max()) < 0.1


@pytest.mark.parametrize("backbone", BACKBONES)
def test_a_stage_keeps_the_given_number_of_convolutions(backbone: str) -> None:
    network = HeatmapNetwork(backbone, 2, 1, convolutions=2)
    for stage in network.stages:
        square = [m for m in stage.modules() if isinstance(m, torch.nn.Conv2d) and m.kernel_size == (3, 3)]
        assert len(square) == 2
    assert network(torch.zeros(1, 3, 64, 64)).heat.shape == (1, 1, 16, 16)


def test_the_network_normalises_its_input() -> None:
    network = HeatmapNetwork("resnet18", 2, 1).eval()
    seen = []
    network.conv1.register_forward_hook(lambda module, given, out: seen.append(given[0]))
    mean = torch.tensor([123.675, 116.28, 103.53]).view(1, 3, 1, 1).expand(1, 3, 32, 32)
    network(mean)
    assert float(seen[0].abs().max()) < 1e-5


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of torch's in a temporary folder."""
    monkeypatch.setattr(torch.hub, "_hub_dir", str(tmp_path / "hub"))
    return tmp_path / "hub" / "checkpoints"


def put_imagenet_file(hub: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, torch.Tensor]:
    """A real torchvision ResNet-18 file in the cache, under a name that carries its true hash."""
    torch.manual_seed(5)
    state = torchvision.models.resnet18(weights=None).state_dict()
    hub.mkdir(parents=True)
    plain = hub / "plain.pth"
    torch.save(state, plain)
    digest = hashlib.sha256(plain.read_bytes()).hexdigest()[:8]
    path = plain.rename(hub / f"resnet18-{digest}.pth")
    monkeypatch.setattr(initialisation, "imagenet_file", lambda backbone: path)
    return state


def test_imagenet_weights_are_read_from_the_cache_and_reach_the_network(
    hub: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = put_imagenet_file(hub, monkeypatch)
    assert resolve_init("auto", "resnet34") == "imagenet"
    network = HeatmapNetwork("resnet18", 3, 4)
    load_backbone(network, starting_weights("imagenet", "resnet18"), "imagenet")
    assert torch.equal(network.conv1.weight, state["conv1.weight"])
    assert torch.equal(network.stages[2][1].conv2.weight, state["layer3.1.conv2.weight"])
    assert torch.equal(network.stages[1][0].bn1.running_var, state["layer2.0.bn1.running_var"])


def test_a_damaged_imagenet_file_is_refused(hub: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put_imagenet_file(hub, monkeypatch)
    path = next(hub.glob("*.pth"))
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(WeightsError, match=r"SHA-256 that begins with .* delete it"):
        starting_weights("imagenet", "resnet18")


def test_a_failed_download_names_the_file_and_where_to_put_it(
    hub: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A real attempt, through a proxy address on which nothing listens: no packet leaves the machine.
    for name in ("https_proxy", "HTTPS_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    assert resolve_init("auto", "resnet34") == "random"
    with pytest.raises(
        WeightsError, match=r"expected resnet18-f37072fd\.pth in .*checkpoints.* --init random"
    ):
        starting_weights("imagenet", "resnet18")
    assert imagenet_file("resnet18").parent == hub
    assert not list(hub.glob("*.pth")) if hub.exists() else True


def test_weights_from_a_file_in_both_forms(tmp_path: Path) -> None:
    state = torchvision.models.resnet18(weights=None).state_dict()
    save_file(state, tmp_path / "own.safetensors")
    torch.save({"state_dict": state}, tmp_path / "own.pth")
    for name in ("own.safetensors", "own.pth"):
        network = HeatmapNetwork("resnet18", 2, 4)
        load_backbone(network, starting_weights(str(tmp_path / name), "resnet18"), name)
        assert torch.equal(network.conv1.weight, state["conv1.weight"])


def test_weights_of_another_backbone_are_refused(tmp_path: Path) -> None:
    torch.save(torchvision.models.resnet50(weights=None).state_dict(), tmp_path / "fifty.pth")
    with pytest.raises(WeightsError, match=r"stages\.0\.0\.conv1\.weight: expected shape"):
        load_backbone(
            HeatmapNetwork("resnet18", 2, 4),
            starting_weights(str(tmp_path / "fifty.pth"), "resnet18"),
            "file",
        )


class Evil:
    """Unpickling this would call print."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return print, ("a pickle was run",)


@pytest.mark.parametrize("what", ["missing", "text", "pickle", "list"])
def test_a_file_without_weights_is_refused(
    what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "weights.pth"
    if what == "text":
        path.write_text("not weights")
    elif what == "pickle":
        torch.save({"conv1.weight": Evil()}, path)
    elif what == "list":
        torch.save([torch.zeros(2)], path)
    with pytest.raises(WeightsError, match=r"weights\.pth|expected"):
        starting_weights(str(path), "resnet18")
    assert "a pickle was run" not in capsys.readouterr().out
