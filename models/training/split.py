"""Which labelled frames are trained on and which are held out to judge by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import LabelledFrame

MIN_FRAMES_TO_HOLD_OUT = 5
"""With fewer, every frame is trained on, and nothing is known of the error."""


def split(frames: Sequence[LabelledFrame], share: float, seed: int) -> tuple[list[int], list[int]]:
    """Indices of the frames to train on and to hold out: a share of each actuator's, at least one of five.

    Actuators with fewer than `MIN_FRAMES_TO_HOLD_OUT` frames are trained on whole, and so is a frame without which
    some keypoint would not be trained at all.
    """
    rng = np.random.default_rng([seed, 1])
    held: list[int] = []
    for actuator in sorted({frame.actuator for frame in frames}):
        own = [i for i, frame in enumerate(frames) if frame.actuator == actuator]
        if share > 0 and len(own) >= MIN_FRAMES_TO_HOLD_OUT:
            count = min(len(own) - 1, max(1, round(share * len(own))))
            held += rng.choice(own, count, replace=False).tolist()
    known = np.stack([np.logical_not(np.isnan(frame.xy).any(axis=1)) for frame in frames])
    for k in range(known.shape[1]):
        if not known[[i for i in range(len(frames)) if i not in held], k].any():
            held.remove(next(i for i in held if known[i, k]))
    return [i for i in range(len(frames)) if i not in set(held)], sorted(held)
