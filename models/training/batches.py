"""Random training batches for the locator and the refiner, drawn from labelled frames and from replayed rendered ones.

Every batch depends only on (seed, step): a training can be stopped and resumed at any step and sees the same data.
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
from ..inference.affine import PATCH_SIDE, centred_view, patch_view, stacked
from ..inference.coarse_to_fine import LOCATOR_MULTIPLE
from ..inference.roi import LOCATOR_SIDE, RegionOfInterest, orientations

Rng = np.random.Generator
PictureChange = Callable[[ImageArray, Rng], ImageArray]

MAX_TURN_DEG = 30.0
"""Locator crops are turned up to this much: labels leave gaps in orientation, the clamp does not turn."""

PATCH_TURN_DEG = 10.0
"""Patches are turned by the located direction; this standard deviation covers the locator's error in it."""

PATCH_SHIFT_PX = 4.0
"""Standard deviation, in patch px, of where the keypoint lies in a training patch: the locator's error."""


@dataclass(frozen=True)
class Batch:
    """Training pictures and their truth, in arrays or, where they were made on the training device, in tensors there.

    Attributes
    ----------
    images : (N, 3, H, W) uint8, or float in [0, 255]
    xy : (N, K, 2) float32 input px
    known, present : (N, K) bool, as in `heatmaps.heatmap_loss`
    """

    images: ImageArray | Tensor
    xy: FloatArray | Tensor
    known: BoolArray | Tensor
    present: BoolArray | Tensor


def locator_batch(
    frames: Mapping[int, PreparedFrame],
    chosen: Sequence[int],
    size_wh: tuple[int, int],
    rng: Rng,
    *,
    change: PictureChange | None = None,
) -> Batch:
    """Random crops at the locator's scale of the frames `chosen`, by their keys.

    change : what is done to each picture; None does what a webcam could have done
    """
    images, targets, known, present = [], [], [], []
    for index in chosen:
        frame = frames[index]
        labelled: BoolArray = np.logical_not(np.isnan(frame.xy).any(axis=1))
        points = frame.coarse_view.to_input(frame.xy)
        box = frame.region
        corner = np.array([box.left, box.top]) * box.locator_scale
        extent = np.array([box.width, box.height]) * box.locator_scale
        # The crop shows the region when it fits, else a part of it: around the body four times in five.
        slack = np.maximum(extent - size_wh, 0)
        middle = corner + extent / 2
        if slack.any():
            anywhere = rng.random() < 0.2 or not labelled.any()
            body = corner + rng.random(2) * extent if anywhere else np.nanmean(points, axis=0)
            middle = np.where(slack > 0, np.clip(body, middle - slack / 2, middle + slack / 2), middle)
        middle = middle + rng.uniform(-0.1, 0.1, size=2) * size_wh
        turn = np.deg2rad(rng.uniform(-MAX_TURN_DEG, MAX_TURN_DEG)) if rng.random() < 0.7 else 0.0
        view = centred_view(middle, size_wh, np.exp(rng.uniform(-0.2, 0.2)), turn)
        picture, mask = augmentation.occlude(view.cut(frame.coarse), rng)
        images.append((change or augmentation.change_picture)(picture, rng))
        xy = view.to_input(points)
        targets.append(xy)
        known.append(labelled)
        present.append(_in_view(xy, size_wh) & ~_hidden(xy, mask) & frame.in_sight)
    return _stack(images, targets, known, present)


def refiner_batch(
    frames: Mapping[int, PreparedFrame],
    chosen: Sequence[int],
    reference: Sequence[int],
    rng: Rng,
    *,
    most: int | None = None,
    elsewhere: int = 1,
    change: PictureChange | None = None,
) -> Batch:
    """One random patch around each labelled keypoint of the frames `chosen`, by their keys, and some of elsewhere.

    most : of the keypoints of a frame; None takes all
    elsewhere : patches of a frame cut anywhere, so that a keypoint is not seen wherever one looks for it
    change : as `locator_batch`'s
    """
    images, targets, known, present = [], [], [], []
    for index in chosen:
        frame = frames[index]
        points = frame.fine_view.to_input(frame.xy)
        labelled: BoolArray = np.logical_not(np.isnan(points).any(axis=1))
        directions, paired = orientations(points, reference), labelled[list(reference)]
        keypoints = np.flatnonzero(labelled)
        if most is not None and most < len(keypoints):
            keypoints = rng.choice(keypoints, most, replace=False)
        middles = [_near(frame, points[k], directions[k], paired[k], rng) for k in keypoints.tolist()]
        middles += [_anywhere(frame, points[labelled], rng) for _ in range(elsewhere)]
        for middle, turn in middles:
            view = patch_view(middle, frame.region.magnification * np.exp(rng.normal(0, 0.06)), turn)
            picture, mask = augmentation.occlude(view.cut(frame.fine), rng)
            images.append((change or augmentation.change_picture)(picture, rng))
            xy = view.to_input(points)
            targets.append(xy)
            known.append(labelled)
            present.append(_in_view(xy, (PATCH_SIDE, PATCH_SIDE)) & ~_hidden(xy, mask) & frame.in_sight)
    return _stack(images, targets, known, present)


def _near(
    frame: PreparedFrame, keypoint: FloatArray, direction: float, is_paired: bool, rng: Rng
) -> tuple[FloatArray, float]:
    """Middle (2,) and turn (rad) of a patch that shows a keypoint (2,) about as a locator would have it.

    direction : by which the patch is turned; is_paired : whether the keypoint's partner is labelled
    """
    turn = direction + np.deg2rad(rng.normal(0, PATCH_TURN_DEG))
    if not is_paired:
        # In a video the partner is always located somewhere: a patch without it may come in any attitude.
        turn = rng.uniform(-np.pi, np.pi)
    shift = np.clip(rng.normal(0, PATCH_SHIFT_PX, size=2), -16, 16) / frame.region.magnification
    return keypoint + shift, turn


def _anywhere(frame: PreparedFrame, labelled: FloatArray, rng: Rng) -> tuple[FloatArray, float]:
    """Middle (2,) and turn (rad) of a patch along the body or, as often, anywhere in the working region."""
    turn = rng.uniform(-np.pi, np.pi)
    if rng.random() < 0.5 and len(labelled):
        one, other = labelled[rng.choice(len(labelled), 2)]
        step = other - one
        return one + rng.random() * step + rng.normal(0, 0.3, 2) * np.linalg.norm(step), turn
    box = frame.region
    corner, extent = np.array([box.left, box.top]), np.array([box.width, box.height])
    return (corner + rng.random(2) * extent) * box.fine_scale, turn


def _in_view(xy: FloatArray, size_wh: tuple[int, int]) -> BoolArray:
    with np.errstate(invalid="ignore"):
        inside: BoolArray = np.all((xy >= -0.5) & (xy <= np.array(size_wh) - 0.5), axis=1)
    return inside


def _hidden(xy: FloatArray, mask: ImageArray) -> BoolArray:
    h, w = mask.shape
    column, row = np.nan_to_num(np.round(xy), nan=-1).astype(int).T
    inside = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    return inside & (mask[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)] > 0)


def _stack(
    images: list[ImageArray], xy: list[FloatArray], known: list[BoolArray], present: list[BoolArray]
) -> Batch:
    return Batch(
        images=stacked(images),
        xy=np.nan_to_num(np.stack(xy)).astype(np.float32),
        known=np.stack(known),
        present=np.stack(present),
    )


REPLAY_PER_BATCH = 2
"""Rendered frames that are shown again beside each batch's own, where there are any."""

REFINER_BATCHES = 2
LOCATOR_SHARE = 0.75
"""Batches that the refiner learns from in a step, and the part of one that the locator sees: both then take the same
time, and it is the refiner that decides how exact positions are."""

WRONG_AT_ONCE = 2
"""Frames in which something else is taken for a keypoint, beside each batch of the refiner's, where there are any."""


@dataclass(frozen=True)
class BatchSampler:
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

    replay: Sequence[PreparedFrame]
    crop_wh: tuple[int, int]
    reference: Sequence[int]
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
            if self.replay:
                again = (first + rng.choice(len(self.replay), REPLAY_PER_BATCH)).tolist()
                frames |= {i: self.replay[i - first] for i in again}
            if turn == 0:
                some = chosen[: math.ceil(LOCATOR_SHARE * self.batch_frames)]
                locate = locator_batch(frames, some + again, self.crop_wh, rng)
            drawn.append(refiner_batch(frames, chosen + again, self.reference, rng, most=self.most))
            if self.wrong:
                some = rng.choice(len(self.wrong), WRONG_AT_ONCE).tolist()
                others = dict(enumerate(self.wrong))
                drawn[-1] = _joined(drawn[-1], refiner_batch(others, some, self.reference, rng, elsewhere=0))
        return locate, drawn


def _joined(one: Batch, other: Batch) -> Batch:
    """Two batches in arrays as one."""
    pairs = ((getattr(one, part.name), getattr(other, part.name)) for part in fields(Batch))
    return Batch(*(np.concatenate([np.asarray(a), np.asarray(b)]) for a, b in pairs))


def crop_wh(regions: Sequence[RegionOfInterest]) -> tuple[int, int]:
    """Size of the locator's crops of frames with these working regions."""
    widest = [max(region.locator_view(LOCATOR_MULTIPLE).size_wh[i] for region in regions) for i in (0, 1)]
    return min(widest[0], LOCATOR_SIDE), min(widest[1], LOCATOR_SIDE)
