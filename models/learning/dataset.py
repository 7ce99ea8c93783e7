"""Labelled frames in memory, at the two scales the networks look at, and random training batches from them.

Every batch depends only on (seed, step): training can be stopped and resumed at any step and sees the same data.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from torch import Tensor

from ...tracker.errors import LabelError
from ...tracker.types import BoolArray, FloatArray, ImageArray, LabelledFrame
from ..finding.regions import WorkingRegion, patch_directions
from ..finding.views import PATCH_SIDE, View, centred_view, patch_view, resize, resized_view, stacked
from . import augment

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


@dataclass(frozen=True)
class PreparedFrame:
    """A labelled frame at the two scales. Positions stay in frame px; the views carry them over.

    Attributes
    ----------
    coarse : the frame at the locator's scale
    fine : the frame at the refiner's scale, or as it is where the refiner magnifies
    coarse_view, fine_view : from frame px to px of those
    xy : (K, 2) frame px, NaN where not labelled
    region : the working region of frames of this size
    in_sight : (K,) bool, False where the keypoint is known to lie behind something
    """

    coarse: ImageArray
    fine: ImageArray
    coarse_view: View
    fine_view: View
    xy: FloatArray
    region: WorkingRegion
    in_sight: BoolArray


def read_image(frame: LabelledFrame) -> ImageArray:
    """The frame's picture, RGB uint8 (H, W, 3).

    Raises
    ------
    LabelError
        If the file is missing or not a picture.
    """
    return read_picture(frame.image_path)


def read_picture(path: Path) -> ImageArray:
    """A picture file as RGB uint8 (H, W, 3); errors as `read_image`."""
    # Bytes first: OpenCV opens no path beyond the Latin ones on Windows, and prints warnings of its own.
    # A camera's orientation tag is ignored, as the labelling tools and the label store ignore it.
    raw = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    data = cv2.imdecode(raw, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if raw.size else None
    if data is None:
        raise LabelError(f"expected a picture at {path}, got a missing or unreadable file")
    return cv2.cvtColor(data, cv2.COLOR_BGR2RGB)


def prepare(
    image: ImageArray, xy: FloatArray, region: WorkingRegion, in_sight: BoolArray | None = None
) -> PreparedFrame:
    """Resize a frame once to both scales, so that a training step only cuts and turns.

    in_sight : as `PreparedFrame`'s; None where nobody says that something lies in the way
    """
    coarse, fine = resize(image, region.locator_scale), resize(image, region.fine_scale)
    return PreparedFrame(
        coarse=coarse,
        fine=fine,
        coarse_view=resized_view(region.locator_scale, (0, 0), (coarse.shape[1], coarse.shape[0])),
        fine_view=resized_view(region.fine_scale, (0, 0), (fine.shape[1], fine.shape[0])),
        xy=np.asarray(xy, dtype=np.float64),
        region=region,
        in_sight=np.ones(len(xy), bool) if in_sight is None else in_sight,
    )


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
        picture, mask = augment.occlude(view.cut(frame.coarse), rng)
        images.append((change or augment.change_picture)(picture, rng))
        xy = view.to_input(points)
        targets.append(xy)
        known.append(labelled)
        present.append(_in_view(xy, size_wh) & ~_hidden(xy, mask) & frame.in_sight)
    return _stack(images, targets, known, present)


def refiner_batch(
    frames: Mapping[int, PreparedFrame],
    chosen: Sequence[int],
    partner: Sequence[int],
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
        directions, paired = patch_directions(points, partner), labelled[list(partner)]
        keypoints = np.flatnonzero(labelled)
        if most is not None and most < len(keypoints):
            keypoints = rng.choice(keypoints, most, replace=False)
        middles = [_near(frame, points[k], directions[k], paired[k], rng) for k in keypoints.tolist()]
        middles += [_anywhere(frame, points[labelled], rng) for _ in range(elsewhere)]
        for middle, turn in middles:
            view = patch_view(middle, frame.region.magnification * np.exp(rng.normal(0, 0.06)), turn)
            picture, mask = augment.occlude(view.cut(frame.fine), rng)
            images.append((change or augment.change_picture)(picture, rng))
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
