"""Training pictures without labels: rendered actuators at the scales the networks look at, and batches of them.

What is drawn is in `tracker.synthetic.stream`; knows nothing of torch, so that a process which only draws is small.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ...tracker.synthetic.stream import KEYPOINTS, TRAINING, Sample, draw
from ...tracker.types import ImageArray
from ..finding.regions import MAX_MAGNIFICATION, WorkingRegion
from ..finding.views import PATCH_SIDE
from .dataset import Batch, PreparedFrame, locator_batch, prepare, refiner_batch

PICTURE_WH = (256, 256)

LOCATOR_INPUT = 96
"""Side of the locator's input in pretraining: far cheaper than a project's, and the convolutions do not mind."""

PATCH_SHARES = (0.15, 0.35)
"""How much of the body's length a patch shows: around `regions.PATCH_BODY_SHARE`."""

PARTNER = tuple(KEYPOINTS.index(name) for name in (
    "base_2", "base_1", "mid_2", "mid_1", "mid_4", "mid_3", "mid_4", "tip_2", "tip_1",
))  # fmt: skip
"""For each canonical keypoint its neighbour, by which its patch is turned."""


def prepared_sample(sample: Sample, rng: np.random.Generator) -> PreparedFrame:
    """A rendered picture as a labelled frame whose every keypoint is known."""
    height, width = sample.picture.shape[:2]
    body_px = float(np.linalg.norm(np.diff(sample.midline_xy, axis=0), axis=1).sum())
    fine = min(MAX_MAGNIFICATION, PATCH_SIDE / (rng.uniform(*PATCH_SHARES) * body_px))
    region = WorkingRegion((width, height), 0, 0, width, height, LOCATOR_INPUT / max(width, height), fine)
    return prepare(sample.picture, sample.keypoints_xy, region, sample.visible)


def rendered_samples(seed: int, indices: Sequence[int]) -> Iterator[tuple[Sample, PreparedFrame]]:
    """The stream's pictures of these numbers, as they are and as labelled frames."""
    for index in indices:
        sample = draw(seed, index, size_wh=PICTURE_WH, families=TRAINING)
        yield sample, prepared_sample(sample, np.random.default_rng([seed, 7, index]))


def rendered_batches(seed: int, step: int, pictures: int, crops: int, patches: int) -> tuple[Batch, Batch]:
    """What the locator and the refiner learn from in a step: crops of pictures never seen before, and patches."""
    indices = range(step * pictures, (step + 1) * pictures)
    frames = {i: frame for i, (_, frame) in zip(indices, rendered_samples(seed, indices), strict=True)}
    rng = np.random.default_rng([seed, 8, step])
    chosen = list(frames)
    side = (LOCATOR_INPUT, LOCATOR_INPUT)
    return (
        locator_batch(frames, crops * chosen, side, rng, change=_as_it_is),
        refiner_batch(frames, chosen, PARTNER, rng, most=patches, elsewhere=0, change=_as_it_is),
    )


def _as_it_is(picture: ImageArray, _: np.random.Generator) -> ImageArray:
    """The stream has a camera and a light of its own: changed once more, pictures only teach more slowly."""
    return picture
