"""How far a network is from labels: px and degrees, per keypoint and actuator, on frames it has not trained on.

The figures are drawn in `figures.py`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..tracker.angle import AngleDefinition, bending_angle, end_vector_px, label_noise_floor_deg
from ..tracker.atomic import atomic_write_text
from ..tracker.errors import LabelError
from ..tracker.types import Detections, FloatArray, LabelledFrame
from .data.images import frame_id, read_image
from .inference.coarse_to_fine import concatenated
from .networks.checkpoint import Checkpoint


@dataclass(frozen=True)
class Evaluation:
    """Predictions beside labels for the same N frames.

    Attributes
    ----------
    frames : the labelled frames
    found : what the network found in them
    keypoints, definition : names and angle
    n_trained : frames that the network was trained on (the n of the label-noise floor)
    """

    frames: Sequence[LabelledFrame]
    found: Detections
    keypoints: tuple[str, ...]
    definition: AngleDefinition
    n_trained: int

    @property
    def labels(self) -> FloatArray:
        """(N, K, 2) px, NaN where not labelled."""
        return np.stack([frame.xy for frame in self.frames])

    @property
    def error_px(self) -> FloatArray:
        """Distance between found and labelled positions, (N, K) px, NaN where not labelled."""
        return np.linalg.norm(self.found.xy - self.labels, axis=2)

    @property
    def angle_error_deg(self) -> FloatArray:
        """Found minus labelled angle, (N,) degrees, NaN where a point of the angle is not labelled."""
        found, _, _ = bending_angle(self.found.xy, self.keypoints, self.definition)
        labelled, _, _ = bending_angle(self.labels, self.keypoints, self.definition)
        return found - labelled

    def summary(self) -> dict[str, Any]:
        """All figures, JSON-ready. Lengths px, angles degrees."""
        error, angle = self.error_px, self.angle_error_deg
        actuators = np.array([frame.actuator for frame in self.frames])
        length = end_vector_px(self.labels, self.keypoints, self.definition)
        return {
            "n_frames": len(self.frames),
            "n_trained": self.n_trained,
            "error_px": _figures(error),
            "angle_error_deg": _figures(np.abs(angle)),
            "per_keypoint_px": {name: _figures(error[:, k]) for k, name in enumerate(self.keypoints)},
            "per_actuator": {
                str(name): {
                    "error_px": _figures(error[actuators == name]),
                    "angle_error_deg": _figures(np.abs(angle[actuators == name])),
                }
                for name in sorted(set(actuators.tolist()))
            },
            "end_vector_px": _number(length),
            "floor_for_1px_labels_deg": _number(label_noise_floor_deg(1.0, max(self.n_trained, 1), length)),
            "frames": [
                {
                    "image": f"{frame.video}/{frame.image_path.name}",
                    "actuator": frame.actuator,
                    "error_px": [_number(v) for v in error[i]],
                    "angle_error_deg": _number(angle[i]),
                    "likelihood": [round(float(v), 4) for v in self.found.likelihood[i]],
                }
                for i, frame in enumerate(self.frames)
            ],
        }


def evaluate(
    checkpoint: Checkpoint,
    frames: Sequence[LabelledFrame],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Find the keypoints in labelled frames and set them beside the labels.

    Raises
    ------
    LabelError
        No frames, or a picture that cannot be read.
    """
    if not frames:
        raise LabelError("evaluation: expected at least one labelled frame, got none")
    found: list[Detections] = []
    for i, frame in enumerate(frames):
        image = read_image(frame)
        found.append(checkpoint.detect(image[None]))
        if progress:
            progress(i + 1, len(frames))
    trained = len(checkpoint.training.get("trained_on", []))
    return Evaluation(frames, concatenated(found), checkpoint.keypoints, checkpoint.definition, trained)


def not_trained_on(checkpoint: Checkpoint, frames: Sequence[LabelledFrame]) -> list[LabelledFrame]:
    """The frames that a checkpoint has not seen: held out in its training, or labelled since."""
    trained = set(checkpoint.training.get("trained_on", []))
    return [frame for frame in frames if frame_id(frame) not in trained]


def write_evaluation(evaluation: Evaluation, path: Path, **more: Any) -> dict[str, Any]:
    """Write `evaluation.json`, with further entries when given; returns what was written."""
    summary = {**more, **evaluation.summary()}
    atomic_write_text(path, json.dumps(summary, indent=2) + "\n")
    return summary


def _figures(values: FloatArray) -> dict[str, float | int | None]:
    values = values[~np.isnan(values)]
    if not values.size:
        return {"n": 0, "rms": None, "mean": None, "median": None, "p95": None, "max": None}
    return {
        "n": int(values.size),
        "rms": _number(float(np.sqrt((values**2).mean()))),
        "mean": _number(float(values.mean())),
        "median": _number(float(np.median(values))),
        "p95": _number(float(np.quantile(values, 0.95))),
        "max": _number(values.max()),
    }


def _number(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None
