"""Random training batches for the locator and the refiner, from labelled frames, replayed ones and negatives.

Every batch depends only on (seed, step), so a resumed training sees the same data. Photometric augmentation is in
`data.augmentation`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..data import augmentation
from ..data.prepared import PreparedFrame
from ..inference.affine import View, centred_view, patch_view, stacked
from ..inference.coarse_to_fine import LOCATOR_MULTIPLE
from ..inference.roi import LOCATOR_SIDE, RegionOfInterest, orientations

Rng = np.random.Generator
Augmentation = Callable[[ImageArray, Rng], ImageArray]

MAX_ROTATION_DEG = 30.0
"""Locator crops are rotated by up to this much: labels leave gaps in orientation, and the clamp does not rotate."""

PATCH_ROTATION_SD_DEG = 10.0
"""Standard deviation of the rotation of training patches about their orientation: the locator's error in it."""

PATCH_SHIFT_SD_PX = 4.0
"""Standard deviation, patch px, of the keypoint's position in a training patch: the locator's error."""

MAX_PATCH_SHIFT_PX = 16.0
"""Largest such shift along x or y, patch px: beyond it the keypoint would leave the patch."""

REPLAY_PER_BATCH = 2
"""Frames of experience replay in each batch, where there are any."""

REFINER_BATCHES = 2
LOCATOR_SHARE = 0.75
"""Batches of the refiner in a step, and the share of a batch's frames that the locator sees. Both networks then take
the same time; the refiner gets more because it decides the precision."""

NEGATIVES_PER_BATCH = 2
"""Negative frames in each batch of the refiner, where there are any."""


@dataclass(frozen=True)
class Batch:
    """Training images and their ground truth, as arrays or, where they were made on the training device, as tensors.

    Attributes
    ----------
    images : (N, 3, H, W) array or tensor
        RGB, uint8, or float in [0, 255].
    xy : (N, K, 2) float32 array or tensor
        Positions, input px.
    known, present : (N, K) bool array or tensor
        As in `heatmaps.heatmap_loss`.
    """

    images: ImageArray | Tensor
    xy: FloatArray | Tensor
    known: BoolArray | Tensor
    present: BoolArray | Tensor


@dataclass(frozen=True)
class _Example:
    """One image of a batch and its ground truth, as `Batch`'s."""

    image: ImageArray
    xy: FloatArray
    known: BoolArray
    present: BoolArray


def locator_batch(
    frames: Mapping[int, PreparedFrame],
    chosen: Sequence[int],
    size_wh: tuple[int, int],
    rng: Rng,
    *,
    augment: Augmentation | None = None,
) -> Batch:
    """Random crops of frames at the locator's scale, one of each.

    Parameters
    ----------
    frames : mapping from int to PreparedFrame
    chosen : sequence of int
        Keys of the frames to cut.
    size_wh : tuple of int
        Width and height of the crops, px.
    rng : numpy Generator
    augment : callable, optional
        Photometric augmentation of each crop, `augmentation.change_image` by default.

    Returns
    -------
    Batch
    """
    examples = []
    for index in chosen:
        frame = frames[index]
        labelled: BoolArray = np.logical_not(np.isnan(frame.xy).any(axis=1))
        points = frame.coarse_view.to_input(frame.xy)
        box = frame.region
        corner = np.array([box.left, box.top]) * box.locator_scale
        extent = np.array([box.width, box.height]) * box.locator_scale
        # The crop shows the whole region where it fits, else a part of it: around the body four times in five.
        slack = np.maximum(extent - size_wh, 0)
        middle = corner + extent / 2
        if slack.any():
            anywhere = rng.random() < 0.2 or not labelled.any()
            body = corner + rng.random(2) * extent if anywhere else np.nanmean(points, axis=0)
            middle = np.where(slack > 0, np.clip(body, middle - slack / 2, middle + slack / 2), middle)
        middle = middle + rng.uniform(-0.1, 0.1, size=2) * size_wh
        turn = np.deg2rad(rng.uniform(-MAX_ROTATION_DEG, MAX_ROTATION_DEG)) if rng.random() < 0.7 else 0.0
        view = centred_view(middle, size_wh, np.exp(rng.uniform(-0.2, 0.2)), turn)
        examples.append(_example(frame, frame.coarse, view, points, rng, augment))
    return _stack(examples)


def refiner_batch(
    frames: Mapping[int, PreparedFrame],
    chosen: Sequence[int],
    reference: Sequence[int],
    rng: Rng,
    *,
    max_keypoints: int | None = None,
    elsewhere: int = 1,
    augment: Augmentation | None = None,
) -> Batch:
    """Random patches of frames: one around each labelled keypoint, and some anywhere.

    Parameters
    ----------
    frames : mapping from int to PreparedFrame
    chosen : sequence of int
        Keys of the frames to cut.
    reference : sequence of K int
        From `roi.reference_keypoints`.
    rng : numpy Generator
    max_keypoints : int, optional
        Keypoints of a frame to cut, drawn at random; all of them by default.
    elsewhere : int
        Patches of a frame cut anywhere, so that the network does not find a keypoint in every patch.
    augment : callable, optional
        As `locator_batch`'s.

    Returns
    -------
    Batch
    """
    examples = []
    for index in chosen:
        frame = frames[index]
        points = frame.fine_view.to_input(frame.xy)
        labelled: BoolArray = np.logical_not(np.isnan(points).any(axis=1))
        orientation, has_reference = orientations(points, reference), labelled[list(reference)]
        keypoints = np.flatnonzero(labelled)
        if max_keypoints is not None and max_keypoints < len(keypoints):
            keypoints = rng.choice(keypoints, max_keypoints, replace=False)
        poses = [
            _pose_near(frame, points[k], orientation[k], has_reference[k], rng) for k in keypoints.tolist()
        ]
        poses += [_pose_anywhere(frame, points[labelled], rng) for _ in range(elsewhere)]
        for middle, turn in poses:
            view = patch_view(middle, frame.region.magnification * np.exp(rng.normal(0, 0.06)), turn)
            examples.append(_example(frame, frame.fine, view, points, rng, augment))
    return _stack(examples)


def _example(
    frame: PreparedFrame,
    image: ImageArray,
    view: View,
    points: FloatArray,
    rng: Rng,
    augment: Augmentation | None,
) -> _Example:
    """A view of a frame's image, with an occluder at random and augmented; `points` (K, 2) are in the image's px."""
    crop, mask = augmentation.occlude(view.cut(image), rng)
    crop = (augment or augmentation.change_image)(crop, rng)
    xy = view.to_input(points)
    known: BoolArray = np.logical_not(np.isnan(points).any(axis=1))
    return _Example(crop, xy, known, _in_view(xy, view.size_wh) & ~_occluded(xy, mask) & frame.visible)


def _pose_near(
    frame: PreparedFrame, keypoint: FloatArray, orientation: float, has_reference: bool, rng: Rng
) -> tuple[FloatArray, float]:
    """Centre (2,) px and rotation (rad) of a patch around a keypoint (2,) px, with the errors that a locator makes."""
    turn = orientation + np.deg2rad(rng.normal(0, PATCH_ROTATION_SD_DEG))
    if not has_reference:
        # In a video the reference keypoint is always located somewhere: such a patch may have any rotation.
        turn = rng.uniform(-np.pi, np.pi)
    shift = np.clip(rng.normal(0, PATCH_SHIFT_SD_PX, size=2), -MAX_PATCH_SHIFT_PX, MAX_PATCH_SHIFT_PX)
    return keypoint + shift / frame.region.magnification, turn


def _pose_anywhere(frame: PreparedFrame, labelled: FloatArray, rng: Rng) -> tuple[FloatArray, float]:
    """Centre (2,) px and rotation (rad) of a patch: along the body or, as often, anywhere in the region."""
    turn = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.5 and len(labelled):
        first, second = labelled[rng.choice(len(labelled), 2)]
        step = second - first
        return first + rng.random() * step + rng.normal(0, 0.3, 2) * np.linalg.norm(step), turn
    box = frame.region
    corner, extent = np.array([box.left, box.top]), np.array([box.width, box.height])
    return (corner + rng.random(2) * extent) * box.fine_scale, turn


def _in_view(xy: FloatArray, size_wh: tuple[int, int]) -> BoolArray:
    """Which positions (K, 2) px lie within an image."""
    with np.errstate(invalid="ignore"):
        inside: BoolArray = np.all((xy >= -0.5) & (xy <= np.array(size_wh) - 0.5), axis=1)
    return inside


def _occluded(xy: FloatArray, mask: ImageArray) -> BoolArray:
    """Which positions (K, 2) px lie under an occlusion mask (H, W)."""
    h, w = mask.shape
    column, row = np.nan_to_num(np.round(xy), nan=-1).astype(int).T
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    return inside & (mask[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)] > 0)


def _stack(examples: Sequence[_Example]) -> Batch:
    return Batch(
        images=stacked([example.image for example in examples]),
        xy=np.nan_to_num(np.stack([example.xy for example in examples])).astype(np.float32),
        known=np.stack([example.known for example in examples]),
        present=np.stack([example.present for example in examples]),
    )


@dataclass(frozen=True)
class BatchSampler:
    """Draws the batches of a training.

    Attributes
    ----------
    replay : sequence of PreparedFrame
        Frames for experience replay: what the network knows of other actuators is kept by training on it again.
    crop_wh : tuple of int
        Width and height of the locator's crops, px.
    reference : sequence of K int
        From `roi.reference_keypoints`.
    batch_frames : int
        Frames of a batch, besides replayed ones and negatives.
    seed : int
        Every batch depends on it and on the step only.
    max_keypoints : int or None
        Keypoints of a frame in a refiner's batch, drawn at random; None takes all.
    refiner_batches : int
        Batches of the refiner in a step.
    negatives : sequence of PreparedFrame
        Negatives: keypoints marked as not visible, at positions whose surroundings look like them.
    """

    replay: Sequence[PreparedFrame]
    crop_wh: tuple[int, int]
    reference: Sequence[int]
    batch_frames: int
    seed: int
    max_keypoints: int | None = None
    refiner_batches: int = REFINER_BATCHES
    negatives: Sequence[PreparedFrame] = ()

    def batches(self, step: int, own: Mapping[int, PreparedFrame]) -> tuple[Batch, list[Batch]]:
        """The batches of a step.

        Parameters
        ----------
        step : int
            From 0.
        own : mapping from int to PreparedFrame
            The frames trained on, by their numbers.

        Returns
        -------
        locate : Batch
            The locator's.
        refine : list of Batch
            The refiner's.
        """
        refine: list[Batch] = []
        numbers, first_replayed = list(own), max(own) + 1
        for number in range(self.refiner_batches):
            rng = np.random.default_rng([self.seed, 2, step, number])
            # Every frame as often as any other: a permutation, and further ones where a batch needs more frames.
            times = math.ceil(self.batch_frames / len(numbers))
            order = np.concatenate([rng.permutation(len(numbers)) for _ in range(times)])[: self.batch_frames]
            chosen = [numbers[i] for i in order]
            frames = {i: own[i] for i in chosen}
            replayed: list[int] = []
            if self.replay:
                replayed = (first_replayed + rng.choice(len(self.replay), REPLAY_PER_BATCH)).tolist()
                frames |= {i: self.replay[i - first_replayed] for i in replayed}
            if number == 0:
                some = chosen[: math.ceil(LOCATOR_SHARE * self.batch_frames)]
                locate = locator_batch(frames, some + replayed, self.crop_wh, rng)
            refine.append(
                refiner_batch(
                    frames, chosen + replayed, self.reference, rng, max_keypoints=self.max_keypoints
                )
            )
            if self.negatives:
                some = rng.choice(len(self.negatives), NEGATIVES_PER_BATCH).tolist()
                negatives = dict(enumerate(self.negatives))
                batch = refiner_batch(negatives, some, self.reference, rng, elsewhere=0)
                refine[-1] = _concatenated(refine[-1], batch)
        return locate, refine


def _concatenated(first: Batch, second: Batch) -> Batch:
    """Two batches of arrays as one."""
    pairs = ((getattr(first, part.name), getattr(second, part.name)) for part in fields(Batch))
    return Batch(*(np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in pairs))


def crop_wh(regions: Sequence[RegionOfInterest]) -> tuple[int, int]:
    """Width and height, px, of the locator's crops of frames with these regions."""
    widest = [max(region.locator_view(LOCATOR_MULTIPLE).size_wh[i] for region in regions) for i in (0, 1)]
    return min(widest[0], LOCATOR_SIDE), min(widest[1], LOCATOR_SIDE)
