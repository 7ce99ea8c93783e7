"""A trained network on disk: weights in safetensors, its metadata as JSON in the header of the same file.

One file, so that weights and metadata stay together; a readable copy of the metadata lies next to it. Never a pickle.
What the metadata means is in `inference.metadata`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from safetensors.torch import load_file

from ...tracker.atomic import atomic_write_text
from ...tracker.links import make_folder
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
    """A trained cascade and its metadata.

    Attributes
    ----------
    network : Cascade
        The others are `CheckpointMetadata`'s.
    """

    network: Cascade

    def detect(self, frames: Frames) -> Detections:
        """Detect the keypoints in frames, each frame by itself.

        Parameters
        ----------
        frames : (N, H, W, 3) uint8 array
            RGB.

        Returns
        -------
        Detections
            Calibrated, in frame px.
        """
        h, w = frames[0].shape[:2]
        geometry = self.geometry_for((w, h))
        return self.calibrated(self.network.detect(frames, geometry), geometry)

    def save(self, folder: Path, *, half: bool = False) -> Path:
        """Write `weights.safetensors` and `checkpoint.json` into a folder.

        Parameters
        ----------
        folder : Path
        half : bool
            In float16: half the size, and each weight is rounded by up to a two-thousandth of itself.

        Returns
        -------
        Path
            The weights' file.

        Raises
        ------
        CheckpointError
            The weights cannot be written.
        """
        make_folder(folder)
        metadata = self.to_dict()
        weights = self.network.state_dict()
        if half:
            weights = {n: w.half() if w.is_floating_point() else w for n, w in weights.items()}
        write_tensors(folder / WEIGHTS_FILE, weights, metadata)
        atomic_write_text(folder / "checkpoint.json", json.dumps(metadata, indent=2) + "\n")
        return folder / WEIGHTS_FILE


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint.

    Parameters
    ----------
    path : Path
        Its file or its folder.

    Returns
    -------
    Checkpoint
        On the CPU, in evaluation mode.

    Raises
    ------
    CheckpointError
        It is missing, damaged, of another format, or not ours.
    """
    path = weights_file(path)
    metadata = read_metadata(path, tuple(BACKBONES))
    with damage_reported(path):
        weights = load_file(path)
        # Networks of earlier versions have fewer stages.
        stages = [
            sum(name.startswith(f"{part}.lateral.") for name in weights) for part in ("locator", "refiner")
        ]
        network = Cascade(metadata.backbone, len(metadata.keypoints), *stages)
        if "aligner.ends" in weights:
            network.aligner = EndRegressionNetwork(len(weights["aligner.ends"]))
        network.load_state_dict(weights)
    return Checkpoint(
        network=network.eval(), **{part.name: getattr(metadata, part.name) for part in fields(metadata)}
    )


def best_device() -> torch.device:
    """The GPU where there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")
