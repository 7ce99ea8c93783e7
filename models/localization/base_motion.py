"""Whether the fixed end of an actuator yields, decided from probe frames.

A clamp may give way by several degrees under load. What a network measures at a base that is held also varies with the
bend, on some bodies by several degrees, since the body next to the base looks different. So the images decide: crops of
a base that yields agree where they are cut as it was measured, crops of a held base where they are all cut alike.
What follows for an actuator is in `localize.py`. Imports no torch.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import FloatArray, ImageArray, IntArray
from ..inference.crops import END_MAGNIFICATION, crop_end
from ..inference.roi import RegionOfInterest

MIN_TURN_DEG = 1.5
"""Least difference between the directions of the two outer groups of frames, degrees. Holding a base that turns by less
costs half of it at most, and a network's direction in a single frame is about as uncertain."""

GROUP_SHARE, MIN_GROUP = 0.25, 4
"""Frames in each of the two outer groups, as a share of all, and at least. A median over a group stands wrong frames
in less than half of it: one frame in eight of the film."""

ALONG, ACROSS = 0.35, 0.5
"""Standard deviations of the window in which crops are compared, in lengths of the base: body and clamp without most of
the background, which does not turn with them."""

CLEARLY_BETTER, BETTER = 0.7, 0.97
"""A base yields where the groups' crops, each in its own direction, differ by less than the first share of what they do
as crops of a held base, and less than the second share of what they do in one direction as in a film that shakes.
14 looks of the training families: where a base is held but found to turn, the first is 1.6 to 5 and the second 1.0 to
1.9; where it turns by 8 degrees, they are 0.03 to 0.45 and 0.15 to 0.87 in 13 of them; where it turns by 4, below both
limits in 12."""


def base_yields(images: Sequence[ImageArray], ends: FloatArray, region: RegionOfInterest) -> bool:
    """Decide whether a fixed end turns during a film.

    The frames in which its measured direction is furthest to one side, and those furthest to the other, make two
    groups. Their median crops are compared three times: all cut at one pose, as a base that is held; all in one
    direction but where the base lies in each frame, as in a film that shakes; and there in each group's own direction.

    Parameters
    ----------
    images : sequence of ndarray of uint8, shape (H, W, 3)
        N frames spread over the video, RGB, in which the fixed end is seen.
    ends : ndarray of float, shape (N, 2, 2)
        Its two points as they were measured in each, px.
    region : RegionOfInterest
        Of frames of this size.

    Returns
    -------
    bool
        False with fewer than twice `MIN_GROUP` frames, and where nothing is seen that could tell.
    """
    size = max(MIN_GROUP, round(GROUP_SHARE * len(ends)))
    if len(ends) < 2 * size:
        return False
    turn_deg = _turns_deg(ends)
    order = np.argsort(turn_deg, kind="stable")
    groups = order[:size], order[-size:]
    low_deg, high_deg = (float(np.median(turn_deg[group])) for group in groups)
    if high_deg - low_deg < MIN_TURN_DEG:
        return False
    common = np.median(ends, axis=0)
    length_px = END_MAGNIFICATION * region.refiner_scale * float(np.linalg.norm(common[1] - common[0]))

    def difference(poses: Sequence[FloatArray]) -> float:
        low, high = (
            _median_crop(images, group, own, region) for group, own in zip(groups, poses, strict=True)
        )
        return _difference(low, high, length_px)

    held = difference([np.broadcast_to(common, ends[group].shape) for group in groups])
    shaken = difference([_moved_to(common, ends[group]) for group in groups])
    yielding = difference([_moved_to(np.median(ends[group], axis=0), ends[group]) for group in groups])
    return yielding < CLEARLY_BETTER * held and yielding < BETTER * shaken


def _turns_deg(ends: FloatArray) -> FloatArray:
    """Directions (N,) of ends (N, 2, 2) px relative to their mean direction, degrees."""
    along = ends[:, 1] - ends[:, 0]
    mean = along.mean(axis=0)
    across = mean[0] * along[:, 1] - mean[1] * along[:, 0]
    return np.asarray(np.degrees(np.arctan2(across, along @ mean)))


def _moved_to(pose: FloatArray, ends: FloatArray) -> FloatArray:
    """A pose (2, 2) px moved to the centres of ends (N, 2, 2) px."""
    return pose - pose.mean(axis=0) + ends.mean(axis=1, keepdims=True)


def _median_crop(
    images: Sequence[ImageArray], group: IntArray, poses: FloatArray, region: RegionOfInterest
) -> FloatArray:
    """Median over a group of frames of their crops (side, side, 3) at poses (N, 2, 2) px."""
    crops = [crop_end(images[i], own, region).image for i, own in zip(group.tolist(), poses, strict=True)]
    return np.asarray(np.median(crops, axis=0))


def _difference(first: FloatArray, second: FloatArray, length_px: float) -> float:
    """One minus the correlation of two crops (side, side, 3) in a window: 0 where they differ by light only, at most 2.

    0 also where a crop shows nothing.
    """
    place = np.arange(len(first)) - (len(first) - 1) / 2
    along, across = (np.exp(-0.5 * (place / (sd * max(length_px, 1.0))) ** 2) for sd in (ALONG, ACROSS))
    weight = np.outer(across, along)[..., None] / (3 * across.sum() * along.sum())
    a, b = (crop - 3 * (weight * crop).sum(axis=(0, 1)) for crop in (first, second))
    power = float(np.sqrt((weight * a * a).sum() * (weight * b * b).sum()))
    return 1.0 - float((weight * a * b).sum()) / power if power > 0 else 0.0
