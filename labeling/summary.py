"""Summary of the labels: for each actuator their number, the floor of the angle error, and gaps in the angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..tracker.angle import AngleDefinition, bending_angle, end_vector_px, label_noise_floor_deg
from ..tracker.project import Project
from .annotations import VideoFolder, by_actuator
from .repeatability import Repeatability

# Assumed where no frame was labelled twice: a careful labeller on a sharp image.
ASSUMED_SIGMA_PX = 1.0


def labels_summary(
    project: Project,
    folders: Sequence[VideoFolder],
    definition_of: Callable[[Sequence[VideoFolder]], AngleDefinition],
    repeatability: Repeatability | None,
) -> dict[str, Any]:
    """Summarise the labels of a project.

    Parameters
    ----------
    project : Project
        The project.
    folders : sequence of VideoFolder
        All folders of the project.
    definition_of : callable
        The angle in some folders, with the sign of what they show.
    repeatability : Repeatability or None
        The labeller's repeatability, None where it was not measured.

    Returns
    -------
    dict of str to Any
        JSON-ready figures, see GET /api/summary in page/API.md. Lengths in px, angles in degrees, None where unknown.
    """
    sigma = repeatability.px if repeatability is not None else ASSUMED_SIGMA_PX
    return {
        "actuators": [
            {
                "name": name,
                "n_frames": sum(len(folder.states) for folder in own),
                "sigma_px": round(sigma, 3),
                "sigma_measured": repeatability is not None,
                **_figures(own, project.keypoints, definition_of(own), sigma),
            }
            for name, own in by_actuator(project, folders).items()
        ],
        "spread": None if repeatability is None else repeatability.to_json(),
    }


def _figures(
    folders: Sequence[VideoFolder], keypoints: Sequence[str], definition: AngleDefinition, sigma_px: float
) -> dict[str, Any]:
    states = [state for folder in folders for state in folder.states.values() if state.points]
    xy = np.array([[state.points.get(k, (np.nan, np.nan)) for k in keypoints] for state in states])
    xy = xy.reshape(len(states), len(keypoints), 2)
    angle_deg, _, _ = bending_angle(xy, keypoints, definition)
    angle_deg = np.sort(angle_deg[np.isfinite(angle_deg)])
    length = end_vector_px(xy, keypoints, definition)
    floor = label_noise_floor_deg(sigma_px, angle_deg.size, length)
    gap = int(np.argmax(np.diff(angle_deg))) if angle_deg.size > 1 else None
    return {
        "n_labelled": int(angle_deg.size),
        "end_vector_px": _number(length),
        "floor_deg": _number(floor),
        "angle_min_deg": _number(angle_deg[0]) if angle_deg.size else None,
        "angle_max_deg": _number(angle_deg[-1]) if angle_deg.size else None,
        "largest_gap_deg": None if gap is None else _number(angle_deg[gap + 1] - angle_deg[gap]),
        "largest_gap_at_deg": None if gap is None else [_number(angle_deg[gap]), _number(angle_deg[gap + 1])],
    }


def _number(value: float) -> float | None:
    return round(float(value), 3) if np.isfinite(value) else None
