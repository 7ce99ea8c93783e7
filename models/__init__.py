"""The network: torch lives here and nowhere else. Training, evaluation, checkpoints, detection.

The names in `__all__` are what other programs may build on. Each is loaded when it is first asked for: tracking with a
compiled network needs no torch, and does not wait for it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if __name__ != "bendtrack.models":
    raise ImportError(f"import this package as bendtrack.models, not as {__name__}")

if TYPE_CHECKING:
    from .cross_validation import cross_validate
    from .detector import NetworkDetector
    from .evaluation import Evaluation, evaluate
    from .networks.checkpoint import Checkpoint, load_checkpoint
    from .training.settings import TrainingSettings
    from .training.trainer import train

_HOMES = {
    "Checkpoint": "networks.checkpoint",
    "Evaluation": "evaluation",
    "NetworkDetector": "detector",
    "TrainingSettings": "training.settings",
    "cross_validate": "cross_validation",
    "evaluate": "evaluation",
    "load_checkpoint": "networks.checkpoint",
    "train": "training.trainer",
}

__all__ = [
    "Checkpoint",
    "Evaluation",
    "NetworkDetector",
    "TrainingSettings",
    "cross_validate",
    "evaluate",
    "load_checkpoint",
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
