"""What the labels so far are worth: for each actuator their number, the floor of the angle error, missing angles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..tracker.angle import AngleDefinition, bending_angle, end_vector_px, label_noise_floor_deg
from ..tracker.project import Project
from .annotations import VideoFolder
from .repeats import Spread

# Where nobody has labelled twice: a careful hand on a sharp picture.
ASSUMED_SIGMA_PX = 1.0


def labels_summary(
    project: Project, folders: Sequence[VideoFolder], definition: AngleDefinition, spread: Spread | None
) -> dict[str, Any]:
    """Figures for the page, JSON-ready; lengths px, angles degrees, None where not known.

    Parameters
    ----------
    folders : all of the project
    definition : its angle
    spread : the labeller's own, if it was measured
    """
    sigma = spread.px if spread is not None else ASSUMED_SIGMA_PX
    by_actuator: dict[str, list[VideoFolder]] = {}
    for folder in folders:
        by_actuator.setdefault(project.actuator_of(folder.video), []).append(folder)
    return {
        "actuators": [
            {
                "name": name,
                "n_frames": sum(len(folder.states) for folder in by_actuator[name]),
                "sigma_px": round(sigma, 3),
                "sigma_measured": spread is not None,
                **_figures(by_actuator[name], project.keypoints, definition, sigma),
            }
            for name in sorted(by_actuator)
        ],
        "spread": None if spread is None else spread.to_json(),
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
