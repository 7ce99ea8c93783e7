"""Splitting labelled frames into those trained on and those held out for validation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import LabelledFrame

MIN_FRAMES_TO_HOLD_OUT = 5
"""An actuator with fewer labelled frames is trained on whole; without held-out frames the error is not known."""


def split(frames: Sequence[LabelledFrame], share: float, seed: int) -> tuple[list[int], list[int]]:
    """Split frames at random into training and held-out ones, actuator by actuator.

    A frame that alone shows some keypoint is trained on, and so is every one that nobody labelled.

    Parameters
    ----------
    frames : sequence of N LabelledFrame
    share : float
        Of each actuator's frames, what is held out: at least one frame where there are `MIN_FRAMES_TO_HOLD_OUT`.
    seed : int

    Returns
    -------
    trained, held_out : lists of int
        Indices of the frames, ascending.
    """
    rng = np.random.default_rng([seed, 1])
    held_out: list[int] = []
    for actuator in sorted({frame.actuator for frame in frames}):
        own = [i for i, frame in enumerate(frames) if frame.actuator == actuator and not frame.propagated]
        if share > 0 and len(own) >= MIN_FRAMES_TO_HOLD_OUT:
            count = min(len(own) - 1, max(1, round(share * len(own))))
            held_out += rng.choice(own, count, replace=False).tolist()
    known = np.stack([np.logical_not(np.isnan(frame.xy).any(axis=1)) for frame in frames])
    for k in range(known.shape[1]):
        if not known[[i for i in range(len(frames)) if i not in held_out], k].any():
            held_out.remove(next(i for i in held_out if known[i, k]))
    return [i for i in range(len(frames)) if i not in set(held_out)], sorted(held_out)
