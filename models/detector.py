"""A checkpoint as the Detector that `tracker.tracking.track` takes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from ..tracker.types import Detections, ImageArray
from ..tracker.video import file_sha256
from .checkpoint import WEIGHTS_FILE, Checkpoint, best_device, load_checkpoint


class NetworkDetector:
    """Finds the keypoints of a checkpoint in frames (the `Detector` protocol of `tracker.types`).

    Parameters
    ----------
    checkpoint : a trained network
    sha256 : hash of the file it was read from, recorded with the results
    device : where it runs; None takes the GPU when there is one
    """

    def __init__(self, checkpoint: Checkpoint, sha256: str, device: torch.device | None = None) -> None:
        self.checkpoint = checkpoint
        self.sha256 = sha256
        self.device = device or best_device()
        checkpoint.network.to(self.device).eval()

    @classmethod
    def load(cls, path: Path, device: torch.device | None = None) -> NetworkDetector:
        """Read a checkpoint file or folder (errors as in `checkpoint.load_checkpoint`)."""
        path = Path(path)
        checkpoint = load_checkpoint(path)
        return cls(checkpoint, file_sha256(path / WEIGHTS_FILE if path.is_dir() else path), device)

    @property
    def keypoints(self) -> tuple[str, ...]:
        """Names of the keypoints, in the order of the arrays."""
        return self.checkpoint.keypoints

    @property
    def batch_size(self) -> int:
        """A CPU's caches hold the maps of a few frames; a GPU wants many, as long as the frames are small."""
        most = 64 if self.device.type == "cuda" else 4
        largest = max(w * h for w, h in (region.frame_wh for region in self.checkpoint.regions))
        return max(1, min(most, most * 2 * 640 * 480 // largest))

    @property
    def provenance(self) -> Mapping[str, Any]:
        """What identifies the output: the checkpoint's hash. The device changes it by rounding only."""
        return {
            "checkpoint_sha256": self.sha256,
            "backbone": self.checkpoint.backbone,
            "engine": "torch float32",
        }

    def detect(self, frames: ImageArray) -> Detections:
        """Keypoints of RGB frames (N, H, W, 3) uint8."""
        return self.checkpoint.detect(frames)
