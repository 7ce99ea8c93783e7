"""Evaluation of a network against labels: errors in px and degrees, by keypoint and by actuator.

Figures are drawn in `figures`.
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
    """Detections and labels of the same N frames.

    Attributes
    ----------
    frames : sequence of N LabelledFrame
    found : Detections
        The network's, in these frames.
    keypoints : tuple of K str
    definition : AngleDefinition
    n_trained : int
        Labelled frames of one actuator that the network was trained on: the n of the label-noise floor.
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
        """Distance of detections from labels, (N, K) px, NaN where not labelled."""
        return np.linalg.norm(self.found.xy - self.labels, axis=2)

    @property
    def angle_error_deg(self) -> FloatArray:
        """Detected minus labelled angle, (N,) degrees, NaN where a keypoint of the angle is not labelled."""
        found, _, _ = bending_angle(self.found.xy, self.keypoints, self.definition)
        labelled, _, _ = bending_angle(self.labels, self.keypoints, self.definition)
        return found - labelled

    def summary(self) -> dict[str, Any]:
        """All statistics, JSON-ready: lengths in px, angles in degrees."""
        error, angle = self.error_px, self.angle_error_deg
        actuators = np.array([frame.actuator for frame in self.frames])
        length = end_vector_px(self.labels, self.keypoints, self.definition)
        return {
            "n_frames": len(self.frames),
            "n_trained": self.n_trained,
            "error_px": _statistics(error),
            "angle_error_deg": _statistics(np.abs(angle)),
            "per_keypoint_px": {name: _statistics(error[:, k]) for k, name in enumerate(self.keypoints)},
            "per_actuator": {
                str(name): {
                    "error_px": _statistics(error[actuators == name]),
                    "angle_error_deg": _statistics(np.abs(angle[actuators == name])),
                }
                for name in sorted(set(actuators.tolist()))
            },
            "end_vector_px": _number(length),
            # What a single label, which each frame here is judged by, is itself off by.
            "one_label_of_1px_deg": _number(label_noise_floor_deg(1.0, 1, length)),
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
    """Detect the keypoints in labelled frames, each frame by itself.

    Parameters
    ----------
    checkpoint : Checkpoint
    frames : sequence of N LabelledFrame
    progress : callable, optional
        Called after each frame with the number of frames done, and of all.

    Returns
    -------
    Evaluation

    Raises
    ------
    LabelError
        There are no frames, or an image cannot be read.
    """
    if not frames:
        raise LabelError("evaluation: expected at least one labelled frame, got none")
    found: list[Detections] = []
    for i, frame in enumerate(frames):
        image = read_image(frame)
        found.append(checkpoint.detect(image[None]))
        if progress:
            progress(i + 1, len(frames))
    # Where the points of one actuator lie, the labels of another do not say.
    trained = len(checkpoint.training.get("trained_on", [])) // max(
        1, len(checkpoint.training.get("actuators", []))
    )
    return Evaluation(frames, concatenated(found), checkpoint.keypoints, checkpoint.definition, trained)


def not_trained_on(checkpoint: Checkpoint, frames: Sequence[LabelledFrame]) -> list[LabelledFrame]:
    """The frames that a checkpoint was not trained on: held out, or labelled since."""
    trained = set(checkpoint.training.get("trained_on", []))
    return [frame for frame in frames if frame_id(frame) not in trained]


def write_evaluation(evaluation: Evaluation, path: Path, **more: Any) -> dict[str, Any]:
    """Write an evaluation's summary as JSON.

    Parameters
    ----------
    evaluation : Evaluation
    path : Path
        Of `evaluation.json`.
    **more
        Further entries, JSON-ready.

    Returns
    -------
    dict
        What was written.
    """
    summary = {**more, **evaluation.summary()}
    atomic_write_text(path, json.dumps(summary, indent=2) + "\n")
    return summary


def _statistics(values: FloatArray) -> dict[str, float | int | None]:
    """Statistics of the values that are not NaN, rounded to four decimals."""
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
    """The value rounded to four decimals, None where it is not finite: JSON has no NaN."""
    return round(float(value), 4) if np.isfinite(value) else None
