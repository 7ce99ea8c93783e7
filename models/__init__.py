"""The network: torch lives here and nowhere else. Training, evaluation, checkpoints, detection."""

if __name__ != "bendtrack.models":
    raise ImportError(f"import this package as bendtrack.models, not as {__name__}")

from .checkpoint import Checkpoint, load_checkpoint
from .cross_validation import cross_validate
from .detector import NetworkDetector
from .evaluation import Evaluation, evaluate
from .settings import TrainingSettings
from .training import train

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
