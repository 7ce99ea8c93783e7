"""A trained network on disk: weights in safetensors, everything else as JSON in the same file's header.

One file, so that weights and what they mean cannot part; a readable copy of the header lies beside it. Never a pickle.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from safetensors.torch import load_file

from ...tracker.atomic import atomic_write_text
from ...tracker.types import Detections, Frames
from ..inference.metadata import (
    WEIGHTS_FILE,
    CheckpointMetadata,
    damage_reported,
    read_metadata,
    weights_file,
)
from .cascade import Cascade
from .end_regressor import EndRegressionNetwork
from .heatmap_network import BACKBONES
from .tensor_files import write_tensors


@dataclass(frozen=True, kw_only=True)
class Checkpoint(CheckpointMetadata):
    """A trained cascade and all that is needed to use it.

    Attributes
    ----------
    network : the two networks; the others are `header.CheckpointMetadata`'s
    """

    network: Cascade

    def detect(self, frames: Frames) -> Detections:
        """Keypoints of RGB frames of one size (N, H, W, 3) uint8, each found by itself, calibrated."""
        h, w = frames[0].shape[:2]
        geometry = self.geometry_for((w, h))
        return self.calibrated(self.network.detect(frames, geometry), geometry)

    def save(self, folder: Path, *, half: bool = False) -> Path:
        """Write `weights.safetensors` and `checkpoint.json` into a folder; returns the former.

        half : in float16, half the size; each weight is rounded by up to a two-thousandth of itself
        """
        folder.mkdir(parents=True, exist_ok=True)
        header = self.to_dict()
        weights = self.network.state_dict()
        if half:
            weights = {n: w.half() if w.is_floating_point() else w for n, w in weights.items()}
        write_tensors(folder / WEIGHTS_FILE, weights, header)
        atomic_write_text(folder / "checkpoint.json", json.dumps(header, indent=2) + "\n")
        return folder / WEIGHTS_FILE


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint from its file or its folder.

    Raises
    ------
    CheckpointError
        If it is missing, damaged, of another format, or not ours.
    """
    path = weights_file(path)
    header = read_metadata(path, tuple(BACKBONES))
    with damage_reported(path):
        weights = load_file(path)
        # Earlier networks had fewer stages.
        stages = [
            sum(name.startswith(f"{part}.lateral.") for name in weights) for part in ("locator", "refiner")
        ]
        network = Cascade(header.backbone, len(header.keypoints), *stages)
        if "aligner.ends" in weights:
            network.aligner = EndRegressionNetwork(len(weights["aligner.ends"]))
        network.load_state_dict(weights)
    return Checkpoint(
        network=network.eval(), **{part.name: getattr(header, part.name) for part in fields(header)}
    )


def best_device() -> torch.device:
    """The GPU when there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")
