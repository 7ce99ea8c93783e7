"""What a trained network means: its keypoints, its angle, its region of interest, its calibration.

All of a checkpoint but the weights, and all that is needed next to a compiled network. Imports no torch.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from safetensors import SafetensorError, safe_open

from ...tracker.angle import AngleDefinition
from ...tracker.errors import BendtrackError, CheckpointError
from ...tracker.types import BoolArray, Correlation, Detections, FloatArray
from .bias import correct_bias
from .calibration import Calibration
from .checksum import HEADER
from .crops import CropGeometry
from .roi import RegionOfInterest
from .stages import ALL_STAGES, StageSettings

WEIGHTS_FILE = "weights.safetensors"
FORMAT, OLDEST_FORMAT = 3, 2
"""The first is raised when the networks' layers change, the second when older files can no longer be read."""

SHORTER, LONGER = 0.8, 1.25
"""Factors on the labelled distances from the reference keypoint within which a distance is plausible. An end turns away
from the camera a little, or is beyond the labelled bends, but does not stretch. In films of nine looks, ends that were
found to 3 px measured 0.86 to 1.14 of the labels' median."""

PRETRAINED_CANDIDATES = 4
"""Candidate peaks per keypoint of a pretrained network, which may take one end for the other."""

Kind = Literal["project", "pretrained"]
"""What a network was trained on: a project's labels, or rendered actuators."""


@dataclass(frozen=True, kw_only=True)
class CheckpointMetadata:
    """What a trained network means.

    Attributes
    ----------
    backbone : str
        Of both its networks.
    keypoints : tuple of str
        Names of the K keypoints, in the order of the network's output.
    definition : AngleDefinition
        The angle that the project measures, its sign resolved.
    regions : tuple of RegionOfInterest
        One for each frame size among the labels.
    reference : tuple of int
        For each keypoint the one that its crop is turned by.
    calibration : Calibration
        From the network's spreads and peaks to covariances and likelihoods.
    kind : "project" or "pretrained"
        What it was trained on.
    systematic_bias : tuple
        Of networks trained by earlier versions: for each keypoint the coefficients for `bias.correct_bias`. Else empty.
    distance_range : tuple of (float, float)
        For each keypoint the shortest and longest labelled distance from its reference keypoint, crop px; empty where
        nothing was labelled.
    training : mapping
        Settings, what the weights started from, which keypoints they knew, frames trained on and held out.
    """

    backbone: str
    keypoints: tuple[str, ...]
    definition: AngleDefinition
    regions: tuple[RegionOfInterest, ...]
    reference: tuple[int, ...]
    calibration: Calibration
    kind: Kind = "project"
    systematic_bias: tuple[tuple[tuple[float, float], ...], ...] = ()
    distance_range: tuple[tuple[float, float], ...] = ()
    training: Mapping[str, Any] = field(default_factory=dict)

    @property
    def pretrained(self) -> bool:
        """Whether it learnt from rendered actuators, and not from a project's labels."""
        return self.kind == "pretrained"

    @property
    def candidates(self) -> int:
        """Candidate peaks that the locator returns for each keypoint."""
        return PRETRAINED_CANDIDATES if self.pretrained else 1

    def region_for(self, frame_wh: tuple[int, int]) -> RegionOfInterest:
        """The region of interest for frames of a size: their own, or the first one's, searched whole."""
        own = (region for region in self.regions if region.frame_wh == frame_wh)
        return next(own, self.regions[0].for_frame(frame_wh))

    def geometry_for(self, frame_wh: tuple[int, int]) -> CropGeometry:
        """How frames of a size are cropped."""
        return CropGeometry(self.region_for(frame_wh), self.reference)

    def plausible_distances(self, xy: FloatArray, geometry: CropGeometry) -> BoolArray:
        """Which keypoints are about as far from their reference keypoints as in some label.

        Parameters
        ----------
        xy : ndarray of float, shape (N, K, 2)
            Positions, px of the frames.
        geometry : CropGeometry
            For frames of this size.

        Returns
        -------
        ndarray of bool, shape (N, K)
        """
        if not self.distance_range:
            return np.ones(xy.shape[:2], bool)
        distance = geometry.reference_distances(xy)
        shortest, longest = np.array(self.distance_range).T
        return np.asarray((distance >= SHORTER * shortest) & (distance <= LONGER * longest))

    def calibrated(
        self, found: Detections, geometry: CropGeometry, stages: StageSettings = ALL_STAGES
    ) -> Detections:
        """The last stages: check distances, correct the systematic bias, calibrate.

        Parameters
        ----------
        found : Detections
            (N, K), from the coarse-to-fine estimator.
        geometry : CropGeometry
            For frames of this size.
        stages : StageSettings, optional
            Which of these stages run.

        Returns
        -------
        Detections
            (N, K), likelihoods in [0, 1] and covariances in px^2. A keypoint at an implausible distance from its
            reference keypoint has likelihood 0.
        """
        if stages.distance_check:
            plausible = self.plausible_distances(found.xy, geometry)
            found = replace(found, likelihood=np.where(plausible, found.likelihood, 0.0))
        if self.systematic_bias:
            bias = np.array(self.systematic_bias)
            found = replace(found, xy=correct_bias(found.xy, bias, self.reference, geometry.crop_scale))
        return self.calibration.apply(found)

    @property
    def correlations(self) -> tuple[Correlation, ...]:
        """Keypoints whose errors go together: both of a moving end that is regressed as one piece."""
        return tuple(
            Correlation(self.keypoints[k], self.keypoints[p], coefficient)
            for k, p, coefficient in self.calibration.end_correlation
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, under the names of the checkpoint's format, and read back by `read_metadata`."""
        return {
            "format": FORMAT,
            "bendtrack": version("bendtrack"),
            "kind": self.kind,
            "backbone": self.backbone,
            "keypoints": list(self.keypoints),
            "angle": {
                "definition": self.definition.name,
                "points": list(self.definition.points),
                "sign": self.definition.sign,
            },
            "regions": [region.to_dict() for region in self.regions],
            "partner": list(self.reference),
            "label_offset_patch_px": [[list(term) for term in bias] for bias in self.systematic_bias],
            # JSON knows no infinity.
            "lengths_patch_px": [
                [low, None if high == np.inf else high] for low, high in self.distance_range
            ],
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
    path : Path
        The checkpoint's file or folder.
    backbones : sequence of str, optional
        Those that are known; empty accepts any.

    Raises
    ------
    CheckpointError
        It is missing, damaged, of another format, or not written by bendtrack.
    """
    path = weights_file(path)
    with damage_reported(path):
        header = _header(path)
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
            kind=_kind(header),
            systematic_bias=tuple(_bias_terms(values) for values in header.get("label_offset_patch_px", [])),
            distance_range=tuple(
                (low, np.inf if high is None else high) for low, high in header.get("lengths_patch_px", [])
            ),
            training=header["training"],
        )


def trained_at(path: Path) -> datetime | None:
    """When a network was trained, as it records itself; None for one from before this was recorded.

    Parameters
    ----------
    path : Path
        The checkpoint's file or folder.

    Returns
    -------
    datetime or None
        With its time zone.

    Raises
    ------
    CheckpointError
        The checkpoint is missing or cannot be read.
    """
    path = weights_file(path)
    with damage_reported(path):
        recorded = _header(path)["training"].get("trained_at")
        if recorded is None:
            return None
        moment = datetime.fromisoformat(recorded)
        if moment.tzinfo is None:
            raise ValueError(f"trained_at: expected a time zone, got {recorded!r}")
        return moment


def later_than(latest: datetime | None) -> str:
    """Now, in ISO 8601; where the clock stands at or before the latest time recorded so far, a microsecond after that.

    So what is trained later is recorded as later, also after the clock was set back.
    """
    now = datetime.now(UTC)
    if latest is not None and now <= latest:
        now = latest + timedelta(microseconds=1)
    return now.isoformat(timespec="microseconds")


def _header(path: Path) -> dict[str, Any]:
    """A checkpoint's own header, not yet interpreted."""
    if not path.is_file():
        raise CheckpointError(
            f"expected a trained network at {path}, got no such file; run `bendtrack train` first"
        )
    with safe_open(path, "np") as file:
        metadata = file.metadata() or {}
    if HEADER not in metadata:
        raise CheckpointError(f"{path}: expected a bendtrack checkpoint, got safetensors without its header")
    header = json.loads(metadata[HEADER])
    if not isinstance(header, dict):
        raise TypeError(f"header: expected an object, got {type(header).__name__}")
    return header


def _kind(header: Mapping[str, Any]) -> Kind:
    """What a checkpoint was trained on; files from before it was recorded say it by what their training counts."""
    known = header.get("kind", "pretrained" if "pictures" in header["training"] else "project")
    if known not in ("project", "pretrained"):
        raise ValueError(f"kind: expected project or pretrained, got {known!r}")
    return "pretrained" if known == "pretrained" else "project"


def _bias_terms(values: Sequence[Any]) -> tuple[tuple[float, float], ...]:
    """A keypoint's bias: all terms of the Fourier series, or, as in older files, the constant term alone."""
    return tuple((x, y) for x, y in (values if np.ndim(values) == 2 else [values]))


@contextmanager
def damage_reported(path: Path) -> Iterator[None]:
    """Turn the errors of a file that is not what it should be into a CheckpointError."""
    try:
        yield
    except BendtrackError:
        raise
    except (
        SafetensorError,
        OSError,
        RuntimeError,
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        OverflowError,
    ) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise CheckpointError(
            f"{path}: expected a bendtrack checkpoint, got a damaged file ({reason})"
        ) from error
