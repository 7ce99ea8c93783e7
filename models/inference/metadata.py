"""What a trained network means: its keypoints, its angle, where it looks and how far it can be believed.

All of a checkpoint but the weights, and all that is needed beside a compiled network; knows nothing of torch.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from ...tracker.angle import AngleDefinition
from ...tracker.errors import BendtrackError, CheckpointError
from ...tracker.types import BoolArray, Detections, FloatArray
from .bias import correct_bias
from .calibration import Calibration
from .roi import RegionOfInterest

WEIGHTS_FILE = "weights.safetensors"
FORMAT, OLDEST_FORMAT = 3, 2
"""The former is raised when the networks' layers change, the latter when those of earlier ones cannot be read any more.
"""

SHORTER, LONGER = 0.8, 1.25
"""A keypoint and its partner may lie nearer than in any label, or further apart, by these factors: an end turns away
from the camera a little, or is beyond the labelled bends, but does not stretch. (In films of nine
looks, ends that were found to 3 px measured 0.86 to 1.14 of the labels' median.)"""

PRETRAINED_PEAKS = 4
"""`CheckpointMetadata.peaks` of a network that has seen no actuator's labels, and so takes one thing for another."""


@dataclass(frozen=True, kw_only=True)
class CheckpointMetadata:
    """What a trained network means.

    Attributes
    ----------
    backbone : of both its networks
    keypoints : names, in the order of its output
    definition : the angle the project measures, its sign resolved
    regions : one for each frame size among the labels
    partner : for each keypoint the one that its patch is turned by
    calibration : what turns the network's spreads into covariances of positions
    label_offset : for each keypoint from `learning.consensus.systematic_bias`; empty where it is in the weights
    lengths : for each keypoint the shortest and the longest labelled distance from its partner, in patch px
        (`regions.reference_distances`); empty where nobody labelled any
    training : settings, what the weights started from and which keypoints they knew, frames trained on and held out
    """

    backbone: str
    keypoints: tuple[str, ...]
    definition: AngleDefinition
    regions: tuple[RegionOfInterest, ...]
    reference: tuple[int, ...]
    calibration: Calibration
    systematic_bias: tuple[tuple[tuple[float, float], ...], ...] = ()
    lengths: tuple[tuple[float, float], ...] = ()
    training: Mapping[str, Any] = field(default_factory=dict)

    @property
    def pretrained(self) -> bool:
        """Whether it learnt from the stream's pictures, and not from labels."""
        return "pictures" in self.training

    @property
    def peaks(self) -> int:
        """Places that the locator offers for each keypoint: several where it may take one end for the other."""
        return PRETRAINED_PEAKS if self.pretrained else 1

    def region_for(self, frame_wh: tuple[int, int]) -> RegionOfInterest:
        """The working region for frames of a size: its own, or the first one's, searched whole."""
        own = (region for region in self.regions if region.frame_wh == frame_wh)
        return next(own, self.regions[0].for_frame(frame_wh))

    def fits(self, xy: FloatArray, region: RegionOfInterest) -> BoolArray:
        """Which keypoints (N, K) of positions (N, K, 2) px lie about as far from their partners as in some label."""
        if not self.lengths:
            return np.ones(xy.shape[:2], bool)
        apart = np.linalg.norm(xy - xy[:, list(self.reference)], axis=2) * region.refiner_scale
        shortest, longest = np.array(self.lengths).T
        return np.asarray((apart >= SHORTER * shortest) & (apart <= LONGER * longest))

    def calibrated(self, found: Detections, region: RegionOfInterest) -> Detections:
        """What the networks found in frames of a region, put where labels lie, with believable uncertainties.

        A keypoint that lies nowhere near as far from its partner as in the labels is not believed at all.
        """
        found = replace(found, likelihood=np.where(self.fits(found.xy, region), found.likelihood, 0.0))
        if self.systematic_bias:
            xy = correct_bias(found.xy, np.array(self.systematic_bias), self.reference, region.refiner_scale)
            found = replace(found, xy=xy)
        return self.calibration.apply(found)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, and read back by `read_metadata`."""
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
            "partner": list(self.reference),
            "label_offset_patch_px": [[list(wave) for wave in offset] for offset in self.systematic_bias],
            # JSON knows no infinity.
            "lengths_patch_px": [[low, None if high == np.inf else high] for low, high in self.lengths],
            "calibration": self.calibration.to_dict(),
            "training": dict(self.training),
        }


def weights_file(path: Path) -> Path:
    """The checkpoint's file, given itself or its folder."""
    path = Path(path)
    return path / WEIGHTS_FILE if path.is_dir() else path


def read_metadata(path: Path, backbones: Sequence[str] = ()) -> CheckpointMetadata:
    """Read what a checkpoint means from its file or its folder, without its weights.

    Parameters
    ----------
    backbones : those that are known; empty takes any

    Raises
    ------
    CheckpointError
        If it is missing, damaged, of another format, or not ours.
    """
    path = weights_file(path)
    if not path.is_file():
        raise CheckpointError(
            f"expected a trained network at {path}, got no such file; run `bendtrack train` first"
        )
    with reading_checkpoint(path):
        with safe_open(path, "np") as file:
            metadata = file.metadata() or {}
        if "bendtrack" not in metadata:
            raise CheckpointError(
                f"{path}: expected a bendtrack checkpoint, got safetensors without its header"
            )
        header = json.loads(metadata["bendtrack"])
        if not OLDEST_FORMAT <= header["format"] <= FORMAT:
            remedy = "update bendtrack" if header["format"] > FORMAT else "train again"
            raise CheckpointError(
                f"{path}: expected checkpoint format {OLDEST_FORMAT} to {FORMAT}, got {header['format']}: {remedy}"
            )
        if backbones and header["backbone"] not in backbones:
            raise CheckpointError(f"{path}: expected a known backbone, got {header['backbone']!r}")
        angle = header["angle"]
        return CheckpointMetadata(
            backbone=header["backbone"],
            keypoints=tuple(header["keypoints"]),
            definition=AngleDefinition(angle["definition"], tuple(angle["points"]), angle["sign"]),
            regions=tuple(RegionOfInterest.from_dict(r) for r in header["regions"]),
            reference=tuple(header["partner"]),
            calibration=Calibration.from_dict(header["calibration"]),
            systematic_bias=tuple(_offset(values) for values in header.get("label_offset_patch_px", [])),
            lengths=tuple(
                (low, np.inf if high is None else high) for low, high in header.get("lengths_patch_px", [])
            ),
            training=header["training"],
        )


def _offset(values: Sequence[Any]) -> tuple[tuple[float, float], ...]:
    """A keypoint's label offset: of each wave, or as networks were saved before, the same in all attitudes."""
    return tuple((x, y) for x, y in (values if np.ndim(values) == 2 else [values]))


@contextmanager
def reading_checkpoint(path: Path) -> Iterator[None]:
    """Turn the errors of a file that is not what it should be into a CheckpointError."""
    try:
        yield
    except BendtrackError:
        raise
    except (SafetensorError, OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise CheckpointError(
            f"{path}: expected a bendtrack checkpoint, got a damaged file ({reason})"
        ) from error
