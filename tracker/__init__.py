"""The instrument: video, geometry, angle, tracking, results, drawing, the study, synthetic renderer. Never loads torch.

The names in `__all__` are what other programs may build on. Each is loaded at first access, so that
importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if __name__ != "bendtrack.tracker":
    raise ImportError(f"import this package as bendtrack.tracker, not as {__name__}")

if TYPE_CHECKING:
    from .angle import AngleDefinition, bending_angle
    from .overlay import write_overlay
    from .project import Project
    from .results import AngleTable, read_results, write_results
    from .study.analysis import StudyResults, analyse_study
    from .study.report import write_report
    from .study.study_file import read_study
    from .study.trial_data import load_trials
    from .tracking import track
    from .types import Detections, Detector, LabelledFrame
    from .video import Video

_HOMES = {
    "AngleDefinition": "angle",
    "AngleTable": "results",
    "Detections": "types",
    "Detector": "types",
    "LabelledFrame": "types",
    "Project": "project",
    "StudyResults": "study.analysis",
    "Video": "video",
    "analyse_study": "study.analysis",
    "bending_angle": "angle",
    "load_trials": "study.trial_data",
    "read_results": "results",
    "read_study": "study.study_file",
    "track": "tracking",
    "write_overlay": "overlay",
    "write_report": "study.report",
    "write_results": "results",
}

__all__ = [
    "AngleDefinition",
    "AngleTable",
    "Detections",
    "Detector",
    "LabelledFrame",
    "Project",
    "StudyResults",
    "Video",
    "analyse_study",
    "bending_angle",
    "load_trials",
    "read_results",
    "read_study",
    "track",
    "write_overlay",
    "write_report",
    "write_results",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
