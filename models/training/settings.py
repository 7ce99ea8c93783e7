"""The settings of a training: each with its default and the reason for it.

Their names are those of bendtrack.toml and of checkpoints.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from ...tracker.errors import TrainingError
from ..networks.heatmap_network import BACKBONES


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of one training; they are saved with the checkpoint.

    Attributes
    ----------
    backbone : str
        A key of `heatmap_network.BACKBONES`. resnet18 is as accurate as the larger ones on thirty frames of one
        actuator, in a third of the time.
    init : str
        Initial weights: "auto" (the best on this machine), "actuator" (the shipped network), "imagenet", "random", or
        the path of a weights file.
    steps : int or None
        Training steps. None takes ten for each training frame, between 300 and 3000, and two thirds of that where the
        start is the shipped network.
    batch_frames : int
        Frames of a batch: each gives the locator one crop and the refiner a patch for each keypoint.
    learning_rate : float or None
        AdamW's. None takes 2e-3, or 8e-3 where the start is the shipped network: its weights have grown, so the same
        step rotates them less. There the locator takes an eighth of the rate, given or not, to keep what it knows of
        actuators in front of other backgrounds.
    weight_decay : float
        AdamW's.
    decay_share : float
        Share of the steps in which the learning rate falls to zero; the decay begins earlier when the held-out error
        stops falling.
    average : float
        Decay of the exponential moving average of the weights; the average is what is saved and validated.
    consensus : float
        Share of the way from the labels to the denoised positions (`denoising.targets`) that the positions trained on
        go: from the first step where the start knows the keypoints, else from when predictions are better than a click.
        With the shipped network as start, moving ends are then registered too (`denoising.registration`). 0 trains on
        the labels as they are; with 1, thirty clicks with an error of 1 px each average out instead of being
        memorised one by one.
    held_out : float
        Share of each actuator's frames that is held out for validation.
    seed : int
        Every random draw follows from it.
    max_minutes : float or None
        Time limit; the schedule is shortened to meet it.

    Raises
    ------
    TrainingError
        A setting is out of its range.
    """

    backbone: str = "resnet18"
    init: str = "auto"
    steps: int | None = None
    batch_frames: int = 8
    learning_rate: float | None = None
    weight_decay: float = 1e-2
    decay_share: float = 0.5
    average: float = 0.98
    consensus: float = 1.0
    held_out: float = 0.1
    seed: int = 0
    max_minutes: float | None = None

    def __post_init__(self) -> None:
        check_start(self.backbone, self.seed)
        check_counts(batch_frames=self.batch_frames)
        if self.steps is not None:
            check_counts(steps=self.steps)
        if not 0.0 <= self.held_out < 1.0:
            raise TrainingError(f"held_out: expected a share in [0, 1), got {self.held_out}")
        if self.max_minutes is not None and not 0 < self.max_minutes < math.inf:
            raise TrainingError(f"max_minutes: expected a number above 0, got {self.max_minutes}")
        for name, value in (("decay_share", self.decay_share), ("consensus", self.consensus)):
            if not 0.0 <= value <= 1.0:
                raise TrainingError(f"{name}: expected a share in [0, 1], got {value}")

    def steps_for(self, n_frames: int, start: str) -> int:
        """Training steps for `n_frames` training frames and a start (from `initialisation.resolve_init`)."""
        if self.steps is not None:
            return self.steps
        steps = min(max(300, 10 * n_frames), 3000)
        return 2 * steps // 3 if start == "actuator" else steps

    def learning_rate_from(self, start: str) -> float:
        """The highest learning rate for a start (from `initialisation.resolve_init`)."""
        if self.learning_rate is not None:
            return self.learning_rate
        return 8e-3 if start == "actuator" else 2e-3

    def locator_share_from(self, start: str) -> float:
        """Share of the learning rate that the locator takes for a start (from `initialisation.resolve_init`)."""
        return 1 / 8 if start == "actuator" else 1.0

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, under the names of bendtrack.toml."""
        return asdict(self)


def check_start(backbone: str, seed: int) -> None:
    """Raise a TrainingError for an unknown backbone or a seed below 0."""
    if backbone not in BACKBONES:
        raise TrainingError(f"backbone: expected one of {', '.join(BACKBONES)}, got {backbone!r}")
    if seed < 0:
        raise TrainingError(f"seed: expected 0 or more, got {seed}")


def check_counts(**counts: int) -> None:
    """Raise a TrainingError that names the first count below 1."""
    for name, count in counts.items():
        if count < 1:
            raise TrainingError(f"{name}: expected at least 1, got {count}")
