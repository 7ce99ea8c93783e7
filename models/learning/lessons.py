"""What locator and refiner learn from in each step of a training on a few frames: those, and rendered ones again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..finding.finder import LOCATOR_MULTIPLE
from ..finding.regions import LOCATOR_SIDE, WorkingRegion
from .dataset import Batch, PreparedFrame, locator_batch, refiner_batch

REHEARSED_AT_ONCE = 2
"""Rendered frames that are shown again beside each batch's own, where there are any."""

REFINER_BATCHES = 2
LOCATOR_SHARE = 0.75
"""Batches that the refiner learns from in a step, and the part of one that the locator sees: both then take the same
time, and it is the refiner that decides how exact positions are."""

WRONG_AT_ONCE = 2
"""Frames in which something else is taken for a keypoint, beside each batch of the refiner's, where there are any."""


@dataclass(frozen=True)
class Lessons:
    """The batches of a training.

    Attributes
    ----------
    rehearsed : frames that are shown again, for what the network knows must not be lost
    crop_wh : size of the locator's crops
    partner : from `regions.partners`
    batch_frames : frames of a batch, besides those shown again
    seed : every batch depends on it and on the step only
    most : keypoints of a frame that the refiner is shown at once; None shows all
    refiner_batches : that the refiner learns from in a step
    wrong : frames in which keypoints are not in sight, though what lies at their positions looks like them
    """

    rehearsed: Sequence[PreparedFrame]
    crop_wh: tuple[int, int]
    partner: Sequence[int]
    batch_frames: int
    seed: int
    most: int | None = None
    refiner_batches: int = REFINER_BATCHES
    wrong: Sequence[PreparedFrame] = ()

    def batches(self, step: int, own: Mapping[int, PreparedFrame]) -> tuple[Batch, list[Batch]]:
        """What the locator and the refiner learn from in a step, of frames by number."""
        drawn: list[Batch] = []
        numbers, first = list(own), max(own) + 1
        for turn in range(self.refiner_batches):
            rng = np.random.default_rng([self.seed, 2, step, turn])
            # Every frame as often as any other: a permutation, again when a step needs more than there are.
            times = math.ceil(self.batch_frames / len(numbers))
            order = np.concatenate([rng.permutation(len(numbers)) for _ in range(times)])[: self.batch_frames]
            chosen = [numbers[i] for i in order]
            frames = {i: own[i] for i in chosen}
            again: list[int] = []
            if self.rehearsed:
                again = (first + rng.choice(len(self.rehearsed), REHEARSED_AT_ONCE)).tolist()
                frames |= {i: self.rehearsed[i - first] for i in again}
            if turn == 0:
                some = chosen[: math.ceil(LOCATOR_SHARE * self.batch_frames)]
                locate = locator_batch(frames, some + again, self.crop_wh, rng)
            drawn.append(refiner_batch(frames, chosen + again, self.partner, rng, most=self.most))
            if self.wrong:
                some = rng.choice(len(self.wrong), WRONG_AT_ONCE).tolist()
                others = dict(enumerate(self.wrong))
                drawn[-1] = _joined(drawn[-1], refiner_batch(others, some, self.partner, rng, elsewhere=0))
        return locate, drawn


def _joined(one: Batch, other: Batch) -> Batch:
    """Two batches in arrays as one."""
    pairs = ((getattr(one, part.name), getattr(other, part.name)) for part in fields(Batch))
    return Batch(*(np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in pairs))


def crop_wh(regions: Sequence[WorkingRegion]) -> tuple[int, int]:
    """Size of the locator's crops of frames with these working regions."""
    widest = [max(region.locator_view(LOCATOR_MULTIPLE).size_wh[i] for region in regions) for i in (0, 1)]
    return min(widest[0], LOCATOR_SIDE), min(widest[1], LOCATOR_SIDE)
