"""A trained network on disk: weights in safetensors, everything else as JSON in the same file's header.

One file, so that weights and what they mean cannot part; a readable copy of the header lies beside it. Never a pickle.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file

from ..tracker.angle import AngleDefinition
from ..tracker.atomic import atomic_write_text
from ..tracker.errors import BendtrackError, CheckpointError
from ..tracker.types import Detections, ImageArray
from .calibration import Calibration
from .cascade import Cascade
from .label_mean import with_offset
from .network import BACKBONES
from .regions import WorkingRegion
from .tensor_files import write_tensors

WEIGHTS_FILE = "weights.safetensors"
FORMAT = 1


@dataclass(frozen=True)
class Checkpoint:
    """A trained cascade and all that is needed to use it.

    Attributes
    ----------
    network : the two networks
    backbone : their backbone
    keypoints : names, in the order of its output
    definition : the angle the project measures, its sign resolved
    regions : one for each frame size among the labels
    partner : for each keypoint the one that its patch is turned by
    calibration : what turns the network's spreads into covariances of positions
    label_offset : for each keypoint from `label_mean.label_offset`; empty where it is in the weights
    training : settings, what the weights started from, frames trained on and held out
    """

    network: Cascade
    backbone: str
    keypoints: tuple[str, ...]
    definition: AngleDefinition
    regions: tuple[WorkingRegion, ...]
    partner: tuple[int, ...]
    calibration: Calibration
    label_offset: tuple[tuple[float, float], ...] = ()
    training: Mapping[str, Any] = field(default_factory=dict)

    def region_for(self, frame_wh: tuple[int, int]) -> WorkingRegion:
        """The working region for frames of a size: its own, or the first one's, searched whole."""
        own = (region for region in self.regions if region.frame_wh == frame_wh)
        return next(own, self.regions[0].for_frame(frame_wh))

    def detect(self, frames: Sequence[ImageArray] | ImageArray) -> Detections:
        """Keypoints of RGB frames of one size (N, H, W, 3) uint8, calibrated."""
        h, w = frames[0].shape[:2]
        region = self.region_for((w, h))
        found = self.network.detect(frames, region, self.partner)
        if self.label_offset:
            xy = with_offset(found.xy, np.array(self.label_offset), self.partner, region.refiner_scale)
            found = replace(found, xy=xy)
        return self.calibration.apply(found)

    def header(self) -> dict[str, Any]:
        """All but the weights, JSON-ready."""
        return {
            "format": FORMAT,
            "bendtrack": version("bendtrack"),
            "backbone": self.backbone,
            "keypoints": list(self.keypoints),
            "angle": {
                "definition": self.definition.name,
                "points": list(self.definition.points),
                "sign": self.definition.sign,
            },
            "regions": [region.to_dict() for region in self.regions],
            "partner": list(self.partner),
            "label_offset_patch_px": [list(offset) for offset in self.label_offset],
            "calibration": {**asdict(self.calibration), "usual_peak": list(self.calibration.usual_peak)},
            "training": dict(self.training),
        }

    def save(self, folder: Path) -> Path:
        """Write `weights.safetensors` and `checkpoint.json` into a folder; returns the former."""
        folder.mkdir(parents=True, exist_ok=True)
        header = self.header()
        write_tensors(folder / WEIGHTS_FILE, self.network.state_dict(), header)
        atomic_write_text(folder / "checkpoint.json", json.dumps(header, indent=2) + "\n")
        return folder / WEIGHTS_FILE


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint from its file or its folder.

    Raises
    ------
    CheckpointError
        If it is missing, damaged, of a newer format, or not ours.
    """
    path = Path(path)
    if path.is_dir():
        path = path / WEIGHTS_FILE
    if not path.is_file():
        raise CheckpointError(
            f"expected a trained network at {path}, got no such file; run `bendtrack train` first"
        )
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
        if "bendtrack" not in metadata:
            raise CheckpointError(
                f"{path}: expected a bendtrack checkpoint, got safetensors without its header"
            )
        header = json.loads(metadata["bendtrack"])
        if header["format"] > FORMAT:
            raise CheckpointError(
                f"{path}: expected checkpoint format {FORMAT} or older, got {header['format']}: update bendtrack"
            )
        if header["backbone"] not in BACKBONES:
            raise CheckpointError(f"{path}: expected a known backbone, got {header['backbone']!r}")
        network = Cascade(header["backbone"], len(header["keypoints"]))
        network.load_state_dict(load_file(path))
        angle = header["angle"]
        return Checkpoint(
            network=network.eval(),
            backbone=header["backbone"],
            keypoints=tuple(header["keypoints"]),
            definition=AngleDefinition(angle["definition"], tuple(angle["points"]), angle["sign"]),
            regions=tuple(WorkingRegion.from_dict(r) for r in header["regions"]),
            partner=tuple(header["partner"]),
            calibration=Calibration.from_dict(header["calibration"]),
            label_offset=tuple((x, y) for x, y in header.get("label_offset_patch_px", [])),
            training=header["training"],
        )
    except BendtrackError:
        raise
    except (SafetensorError, OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise CheckpointError(
            f"{path}: expected a bendtrack checkpoint, got a damaged file ({reason})"
        ) from error


def best_device() -> torch.device:
    """The GPU when there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")
