"""What networks are shown of a frame: patches around keypoints, and closer pictures of ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...tracker.types import FloatArray, ImageArray, IntArray
from .affine import PATCH_SIDE, View, centred_view, resize, resized_view
from .roi import RegionOfInterest, orientations, turned

POSE_PX = 4.0
POSE_TURN_DEG = 3.0
"""What places (`places`) are counted in: patch px from the frame's corner, and degrees of the patch's turn."""

CLOSER = 2.0
END_SIDE = round(CLOSER * PATCH_SIDE)
"""A closer picture of an end shows as much as a patch, so many times as large."""

FAR_PX, FAR_RAD = 8.0, 0.25
"""An end that would be moved or turned further, in px of its closer picture, does not look like the others: it is
left to what else is known of it."""


@dataclass(frozen=True)
class Crop:
    """A square that a network is shown of a frame.

    Attributes
    ----------
    picture : (side, side, 3) uint8
    view : from frame px to the picture's px
    """

    picture: ImageArray
    view: View


def places(near: FloatArray, region: RegionOfInterest, reference: Sequence[int]) -> FloatArray:
    """Where patches are cut for keypoints thought to be at `near` (..., K, 2) px: middle x, middle y and turn.

    (..., K, 3), counted in `POSE_PX` and `POSE_TURN_DEG`; upright by each keypoint's partner
    """
    middle = near * (region.refiner_scale / POSE_PX)
    turn = orientations(near, reference) / np.deg2rad(POSE_TURN_DEG)
    return np.concatenate([middle, turn[..., None]], axis=-1)


def crop_patch(frame: ImageArray, place: FloatArray | IntArray, region: RegionOfInterest) -> Crop:
    """What the refiner is shown of a frame at a place (3,), PATCH_SIDE px wide."""
    middle = place[:2] * (POSE_PX / region.refiner_scale)
    return _cut(frame, middle, float(place[2] * np.deg2rad(POSE_TURN_DEG)), region, PATCH_SIDE)


def crop_end(frame: ImageArray, end: FloatArray, region: RegionOfInterest) -> Crop:
    """A closer picture of an end (2, 2) px, its first point to the left and its second to the right of the middle."""
    along = end[1] - end[0]
    closer = replace(region, refiner_scale=CLOSER * region.refiner_scale)
    return _cut(frame, end.mean(axis=0), float(np.arctan2(along[1], along[0])), closer, END_SIDE)


def move_ends(ends: FloatArray, steps: FloatArray, patch_scale: FloatArray | float) -> FloatArray:
    """Ends (N, 2, 2) px, moved and turned as they are.

    Parameters
    ----------
    steps : (N, 3), along each end and across it in px of its closer picture, and radians about its middle
    patch_scale : px of the refiner's patches for one px of each frame, (N,), or of all
    """
    middle = ends.mean(axis=1)
    half: FloatArray = (ends[:, 1] - ends[:, 0]) / 2
    scale = CLOSER * np.broadcast_to(patch_scale, len(ends))
    middle = middle + turned(steps[:, :2] / scale[:, None], np.arctan2(half[:, 1], half[:, 0]))
    half = turned(half, steps[:, 2])
    return np.stack([middle - half, middle + half], axis=1)


def _cut(frame: ImageArray, middle: FloatArray, turn_rad: float, region: RegionOfInterest, side: int) -> Crop:
    """A square around a position of a frame (2,) px at the refiner's scale, direction `turn_rad` to the right."""
    size = side, side
    if region.fine_scale == 1.0:
        view = centred_view(middle, size, region.magnification, turn_rad)
        return Crop(view.cut(frame), view)
    source, source_view = _around(frame, middle, region, side)
    view = centred_view(source_view.to_input(middle), size, region.magnification, turn_rad)
    return Crop(view.cut(source), view.after(source_view))


def _around(
    frame: ImageArray, middle: FloatArray, region: RegionOfInterest, side: int
) -> tuple[ImageArray, View]:
    """A part of a frame around a square's middle, made as small as the refiner looks at it, and how."""
    scale = region.fine_scale
    h, w = frame.shape[:2]
    # Half of a turned square's diagonal, and a little for the interpolation.
    reach = (side * 0.71 + 2) / scale
    left, top = (int(v) for v in np.clip(middle - reach, 0, (w - 2, h - 2)))
    right, bottom = (int(v) for v in np.clip(middle + reach + 1, (left + 2, top + 2), (w, h)))
    part = resize(frame[top:bottom, left:right], scale)
    return part, resized_view(scale, (left, top), (part.shape[1], part.shape[0]))
