"""How a network is trained: every setting, its default and the reason for it, once."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from ...tracker.errors import TrainingError
from ..networks.heatmap_network import BACKBONES


@dataclass(frozen=True)
class TrainingSettings:
    """Settings of one training; they travel with the checkpoint.

    Attributes
    ----------
    backbone : resnet18 finds what the larger ones find on thirty frames of one actuator, in a third of the time
    init : "auto" (the best start on this machine), "actuator" (the network that comes with bendtrack), "imagenet",
        "random", or the path of a weights file
    steps : training steps; None takes ten for each training frame, between 300 and 3000, and two thirds of that where
        both networks know actuators already
    batch_frames : frames of a batch; a frame gives the locator one crop and the refiner a patch a keypoint
    learning_rate, weight_decay : AdamW's; None takes a learning rate of 2e-3, or of 8e-3 where both networks know
        actuators already: their weights have grown, so that the same step turns them less. There the locator takes
        an eighth of the rate, given or not: what it knows of actuators before other backgrounds is worth keeping.
    decay_share : share of the steps in which the learning rate falls to zero; it begins earlier when the
        held-out error stops falling
    average : how much of the averaged weights is kept each step; the average is what is saved and judged
    consensus : how far training positions move from the labels to what the averaged network says less its own errors
        (`consensus.denoised_positions`), at once where it knew the keypoints before, else once it is better than a single
        click; with what comes with bendtrack as a start, moving ends are then laid over each other
        (`registration.registered`). 0 trains on the labels as they are. Thirty clicks with 1 px of error each then
        weigh together instead of being learnt by heart one by one.
    held_out : share of each actuator's frames that is not trained on but judged
    seed : everything random follows from it
    max_minutes : the schedule is shortened to end by then
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
        """Training steps for so many training frames, from what `initialisation.resolve_init` says."""
        if self.steps is not None:
            return self.steps
        steps = min(max(300, 10 * n_frames), 3000)
        return 2 * steps // 3 if start == "actuator" else steps

    def learning_rate_from(self, start: str) -> float:
        """The highest learning rate, from what `initialisation.resolve_init` says."""
        if self.learning_rate is not None:
            return self.learning_rate
        return 8e-3 if start == "actuator" else 2e-3

    def locator_share_from(self, start: str) -> float:
        """Of the learning rate, what the locator takes, from what `initialisation.resolve_init` says."""
        return 1 / 8 if start == "actuator" else 1.0

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return asdict(self)


def check_start(backbone: str, seed: int) -> None:
    """Refuse a backbone that is not known, or a seed below 0, with a TrainingError."""
    if backbone not in BACKBONES:
        raise TrainingError(f"backbone: expected one of {', '.join(BACKBONES)}, got {backbone!r}")
    if seed < 0:
        raise TrainingError(f"seed: expected 0 or more, got {seed}")


def check_counts(**counts: int) -> None:
    """Refuse what there must be at least one of, by its name, with a TrainingError."""
    for name, count in counts.items():
        if count < 1:
            raise TrainingError(f"{name}: expected at least 1, got {count}")
