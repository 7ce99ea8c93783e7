"""Training pictures without labels: rendered actuators, stacked to be learnt from, and as labelled frames that a
pretraining is judged by. What is drawn is in `tracker.synthetic.stream`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...tracker.synthetic.stream import KEYPOINTS, TRAINING, Sample, draw
from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..inference.affine import PATCH_SIDE, stacked
from ..inference.roi import MAX_MAGNIFICATION, PATCH_BODY_SHARE, RegionOfInterest
from .prepared import PreparedFrame, prepare

PICTURE_SIDE = 320
"""Bodies are 60 to 300 px long in such pictures, as in a webcam's: a patch of one is as sharp as there."""

PICTURE_WH = (PICTURE_SIDE, PICTURE_SIDE)

LOCATOR_INPUT = 96
"""Side of the locator's input in pretraining: far cheaper than a project's, and the convolutions do not mind."""

REFERENCE = tuple(KEYPOINTS.index(name) for name in (
    "base_2", "base_1", "mid_2", "mid_1", "mid_4", "mid_3", "mid_4", "tip_2", "tip_1",
))  # fmt: skip
"""For each canonical keypoint its neighbour, by which its patch is turned."""


class Rendered(NamedTuple):
    """N rendered pictures and what is learnt from them.

    Attributes
    ----------
    pictures : (N, 3, PICTURE_SIDE, PICTURE_SIDE) uint8
    xy : (N, K, 2) px
    visible : (N, K) bool
    body_px : (N,) length of the midline
    """

    pictures: ImageArray
    xy: FloatArray
    visible: BoolArray
    body_px: FloatArray


def rendered_pictures(seed: int, indices: Sequence[int]) -> Rendered:
    """The stream's pictures of these numbers."""
    samples = [draw(seed, index, size_wh=PICTURE_WH, families=TRAINING) for index in indices]
    return Rendered(
        stacked([sample.image for sample in samples]),
        np.stack([sample.keypoints_xy for sample in samples]),
        np.stack([sample.visible for sample in samples]),
        np.array([body_px(sample) for sample in samples]),
    )


def body_px(sample: Sample) -> float:
    """Length of the midline."""
    return float(np.linalg.norm(np.diff(sample.midline_xy, axis=0), axis=1).sum())


def rendered_samples(seed: int, indices: Sequence[int]) -> Iterator[tuple[Sample, PreparedFrame]]:
    """The stream's pictures of these numbers, as they are and as labelled frames at the scales of a project's."""
    for index in indices:
        sample = draw(seed, index, size_wh=PICTURE_WH, families=TRAINING)
        fine = min(MAX_MAGNIFICATION, PATCH_SIDE / (PATCH_BODY_SHARE * body_px(sample)))
        region = RegionOfInterest(PICTURE_WH, 0, 0, *PICTURE_WH, LOCATOR_INPUT / PICTURE_SIDE, fine)
        yield sample, prepare(sample.image, sample.keypoints_xy, region, sample.visible)


def rendered_frames(
    seed: int, indices: Sequence[int], keypoints: Sequence[str], mapping: Mapping[str, str]
) -> list[PreparedFrame]:
    """`rendered_samples` as frames with a project's keypoints, of which those are labelled that are canonical ones.

    taken : the canonical keypoint of each that is one
    """
    rows = [KEYPOINTS.index(mapping[name]) if name in mapping else -1 for name in keypoints]
    known = np.array(rows) >= 0
    return [
        replace(frame, xy=np.where(known[:, None], frame.xy[rows], np.nan), in_sight=frame.in_sight[rows])
        for _, frame in rendered_samples(seed, indices)
    ]
