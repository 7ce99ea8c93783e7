"""Initial weights: of the shipped network, from ImageNet, from a file, or random.

Never loads a pickle. How heads are taken over from a network of ours is in `training.transfer`.
"""

from __future__ import annotations

import hashlib
import http.client
import re
from collections.abc import Mapping
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor
from torchvision.models import ResNet18_Weights, ResNet34_Weights, ResNet50_Weights

from ...tracker.errors import WeightsError
from ..inference.checksum import HEADER, check_checksum
from .cascade import Cascade
from .heatmap_network import HeatmapNetwork
from .shipped import actuator_file

IMAGENET_WEIGHTS = {
    "resnet18": ResNet18_Weights.IMAGENET1K_V1,
    "resnet34": ResNet34_Weights.IMAGENET1K_V1,
    "resnet50": ResNet50_Weights.IMAGENET1K_V2,
}

WORDS = ("actuator", "imagenet", "random")
"""Starts that are not paths of files."""


def random_cascade(backbone: str, n_keypoints: int, seed: int) -> Cascade:
    """A cascade with random weights that depend on the seed only; torch's own random state stays as it was.

    Parameters
    ----------
    backbone : str
        A key of `heatmap_network.BACKBONES`.
    n_keypoints : int
    seed : int

    Returns
    -------
    Cascade
        On the CPU.
    """
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(seed)
        return Cascade(backbone, n_keypoints)


def imagenet_file(backbone: str) -> Path:
    """Path of torchvision's ImageNet weights of a backbone on this machine, whether they exist or not."""
    return Path(torch.hub.get_dir()) / "checkpoints" / Path(IMAGENET_WEIGHTS[backbone].url).name


def resolve_init(init: str, backbone: str) -> str:
    """Resolve `init` on this machine to "actuator", "imagenet", "random" or a path.

    "auto" takes the shipped network where there is one with this backbone, else ImageNet weights where they have been
    downloaded already, else random weights. It never downloads: a laboratory or a cluster may have no internet.
    """
    if init != "auto":
        return init
    if actuator_file(backbone).is_file():
        return "actuator"
    return "imagenet" if imagenet_file(backbone).is_file() else "random"


def starting_weights(init: str, backbone: str) -> dict[str, Tensor] | None:
    """Load a backbone's state dict.

    Parameters
    ----------
    init : str
        "imagenet", "random" or the path of a weights file.
    backbone : str
        A key of `heatmap_network.BACKBONES`.

    Returns
    -------
    dict from str to tensor, or None
        In torchvision's names; None for random weights.

    Raises
    ------
    WeightsError
        The file is missing, damaged or holds no weights, or the download fails.
    CheckpointError
        It is a network of ours, and damaged.
    """
    if init == "random":
        return None
    if init == "imagenet":
        return _imagenet(backbone)
    return _read(Path(init))


def load_backbone(network: HeatmapNetwork, state: Mapping[str, Tensor], source: str) -> None:
    """Load a backbone's weights into a network that keeps some of its stages.

    Parameters
    ----------
    network : HeatmapNetwork
        Changed in place.
    state : mapping from str to tensor
        In torchvision's names, or in `HeatmapNetwork`'s.
    source : str
        Named in the error.

    Raises
    ------
    WeightsError
        A weight that the network needs is missing or has another shape.
    """
    wanted = {
        name: value
        for name, value in network.state_dict().items()
        if name.startswith(("conv1.", "bn1.", "stages."))
    }
    renamed = {re.sub(r"^layer([1-4])\.", _stage_name, name): value for name, value in state.items()}
    missing = [n for n in wanted if n not in renamed and not n.endswith("num_batches_tracked")]
    if missing:
        raise WeightsError(
            f"{source}: expected the weights of a torchvision ResNet, {len(missing)} of {len(wanted)} are missing"
            f" (first: {missing[0]})"
        )
    for name, value in wanted.items():
        if name in renamed and renamed[name].shape != value.shape:
            raise WeightsError(
                f"{source}: {name}: expected shape {tuple(value.shape)}, got {tuple(renamed[name].shape)}"
                " (another backbone?)"
            )
    network.load_state_dict({n: renamed[n] for n in wanted if n in renamed}, strict=False)


def _stage_name(match: re.Match[str]) -> str:
    return f"stages.{int(match[1]) - 1}."


def _imagenet(backbone: str) -> dict[str, Tensor]:
    weights, path = IMAGENET_WEIGHTS[backbone], imagenet_file(backbone)
    if not path.is_file():
        try:
            torch.hub.load_state_dict_from_url(
                weights.url, check_hash=True, progress=False, weights_only=True
            )
        except (OSError, http.client.HTTPException, RuntimeError) as error:
            raise WeightsError(
                f"ImageNet weights: expected {path.name} in {path.parent}, and its download failed"
                f" ({_reason(error)}); get {weights.url} on a machine with a network and put it there, or use"
                " --init random"
            ) from error
    # torchvision's file names end in the first digits of their SHA-256.
    claimed = path.stem.rsplit("-", 1)[-1]
    found = hashlib.sha256(path.read_bytes()).hexdigest()
    if not found.startswith(claimed):
        raise WeightsError(
            f"{path}: expected a SHA-256 that begins with {claimed}, got {found[: len(claimed)]}:"
            " the file is damaged; delete it and try again"
        )
    return _read(path)


def _read(path: Path) -> dict[str, Tensor]:
    if not path.is_file():
        raise WeightsError(
            f"--init: expected auto, actuator, imagenet, random or a weights file, got {path} (no such file)"
        )
    try:
        if path.suffix == ".safetensors":
            with safe_open(path, "pt") as file:
                own_network = HEADER in (file.metadata() or {})
            if own_network:
                check_checksum(path)
        state: Any = (
            load_file(path)
            if path.suffix == ".safetensors"
            else torch.load(path, map_location="cpu", weights_only=True)
        )
    except (SafetensorError, OSError, RuntimeError, ValueError, EOFError, KeyError, UnpicklingError) as error:
        raise WeightsError(
            f"{path}: expected a weights file, got one that cannot be read ({_reason(error)})"
        ) from error
    if isinstance(state, Mapping) and isinstance(state.get("state_dict"), Mapping):
        state = state["state_dict"]
    if not isinstance(state, Mapping) or not all(isinstance(v, Tensor) for v in state.values()):
        raise WeightsError(f"{path}: expected named weights (a state dict), got something else")
    # A checkpoint of ours holds two networks; the backbone of its locator initialises both.
    weights: dict[str, Tensor] = dict(state)
    own = {n.removeprefix("locator."): v for n, v in weights.items() if n.startswith("locator.")}
    return own or weights


def _reason(error: BaseException) -> str:
    return str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
