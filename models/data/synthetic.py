"""Rendered actuators as training data: image batches with exact keypoints, and prepared frames like a project's.

What is rendered, and how, is in `tracker.synthetic.stream`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...tracker.synthetic.stream import KEYPOINTS, TRAINING, Sample, draw
from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..inference.affine import PATCH_SIDE, stacked
from ..inference.roi import MAX_MAGNIFICATION, PATCH_BODY_SHARE, RegionOfInterest
from .prepared import PreparedFrame, prepare

IMAGE_SIDE = 320
"""Side of a rendered image, px. Bodies in it are 60 to 300 px long, as in a webcam's, so their patches are as sharp."""

IMAGE_WH = (IMAGE_SIDE, IMAGE_SIDE)

LOCATOR_INPUT = 96
"""Side of the locator's input in pretraining, px. Far cheaper than a project's, and a convolutional network can be
applied at another size later."""

REFERENCE = tuple(KEYPOINTS.index(name) for name in (
    "base_2", "base_1", "mid_2", "mid_1", "mid_4", "mid_3", "mid_4", "tip_2", "tip_1",
))  # fmt: skip
"""Reference keypoint of each canonical keypoint: the neighbour that gives its patch a direction."""


class RenderedBatch(NamedTuple):
    """N rendered images and their ground truth.

    Attributes
    ----------
    images : (N, 3, IMAGE_SIDE, IMAGE_SIDE) uint8 array
        RGB.
    xy : (N, K, 2) float array
        px.
    visible : (N, K) bool array
        False where a keypoint is occluded.
    body_px : (N,) float array
        Length of the midline, px.
    """

    images: ImageArray
    xy: FloatArray
    visible: BoolArray
    body_px: FloatArray


def render_batch(seed: int, indices: Sequence[int], kinds: Collection[str] = ()) -> RenderedBatch:
    """Render the stream's samples with these indices; each depends on its seed and index and on the kinds only.

    Parameters
    ----------
    seed : int
        Of the stream.
    indices : sequence of int
        Of the samples.
    kinds : collection of str, optional
        Kinds of extras that may be drawn on top of the looks, of `stream.KINDS`.

    Returns
    -------
    RenderedBatch
    """
    samples = [draw(seed, index, size_wh=IMAGE_WH, families=TRAINING, kinds=kinds) for index in indices]
    return RenderedBatch(
        stacked([sample.image for sample in samples]),
        np.stack([sample.keypoints_xy for sample in samples]),
        np.stack([sample.visible for sample in samples]),
        np.array([body_px(sample) for sample in samples]),
    )


def body_px(sample: Sample) -> float:
    """Length of a sample's midline, px."""
    return float(np.linalg.norm(np.diff(sample.midline_xy, axis=0), axis=1).sum())


def rendered_samples(seed: int, indices: Sequence[int]) -> Iterator[tuple[Sample, PreparedFrame]]:
    """Render the stream's samples with these indices, each with its labelled frame at a project's scales.

    Yields
    ------
    sample : Sample
        As it was rendered.
    frame : PreparedFrame
        With the canonical keypoints as labels.
    """
    for index in indices:
        sample = draw(seed, index, size_wh=IMAGE_WH, families=TRAINING)
        refiner_scale = min(MAX_MAGNIFICATION, PATCH_SIDE / (PATCH_BODY_SHARE * body_px(sample)))
        region = RegionOfInterest(IMAGE_WH, 0, 0, *IMAGE_WH, LOCATOR_INPUT / IMAGE_SIDE, refiner_scale)
        yield sample, prepare(sample.image, sample.keypoints_xy, region, sample.visible)


def rendered_frames(
    seed: int, indices: Sequence[int], keypoints: Sequence[str], mapping: Mapping[str, str]
) -> list[PreparedFrame]:
    """`rendered_samples` as frames with a project's keypoints.

    Parameters
    ----------
    seed : int
        Of the stream.
    indices : sequence of int
        Of the samples.
    keypoints : sequence of K str
        Names of the project's keypoints.
    mapping : mapping from str to str
        The canonical keypoint of each project keypoint that has one; the others are not labelled.

    Returns
    -------
    list of PreparedFrame
    """
    rows = [KEYPOINTS.index(mapping[name]) if name in mapping else -1 for name in keypoints]
    mapped = np.array(rows) >= 0
    return [
        replace(frame, xy=np.where(mapped[:, None], frame.xy[rows], np.nan), visible=frame.visible[rows])
        for _, frame in rendered_samples(seed, indices)
    ]
