"""Noisy labels weighed together: positions to train on that follow the averaged network where it agrees.

Every label is off by a click's error, and a network can learn thirty such errors by heart. One that knows the keypoints
before it has seen a label says where the labels are off; its word counts as far as it is right (`weighed`). While it
learns, its running average agrees with what the labels have in common before it agrees with each; moving the positions
toward it and training on keeps it there (`consensus`). Of a fixed end, which is at one place in all frames of a video,
shadows tell the frames apart; there the positions are put together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import BoolArray, FloatArray
from ..finding.label_mean import label_offset, with_offset
from ..finding.regions import patch_directions, turned

REACH = 4.0
"""A prediction further than this from its label, in median distances, is not believed: perhaps another keypoint."""

LIMIT_PATCH_PX = 6.0
"""Nor is one further than this, in px of the refiner's patches: no label is so far off, the network is."""

LEAST = 5
"""Frames from which it is believed that a keypoint rests in their video, or how far a network is off."""


def weighed(
    labels: FloatArray,
    found: FloatArray,
    partner: Sequence[int],
    patch_scale: FloatArray,
    videos: Sequence[str],
) -> FloatArray:
    """Labels moved toward what a network finds that knows the keypoints and has not seen the labels.

    It need not put a keypoint where this hand does, so it is moved to the labels' mean first (`label_mean`). What then
    lies between the two is both their errors. The hand's are as large for every keypoint and in every direction: at
    most as large as what lies between where that is least. What is more elsewhere is the network's error, and either
    counts there by the other's variance.

    Parameters
    ----------
    labels, found : (N, K, 2) px; a label that `found` is too far from stays as it is, and so do all of a keypoint with
        fewer than `LEAST`
    partner : from `regions.partners`
    patch_scale : (N,) px of the refiner's patches for one px of the frame
    videos : which video each of the N frames is from
    """
    offset = label_offset(found, labels, partner, patch_scale)
    expected = with_offset(found, offset, partner, patch_scale)
    direction = patch_directions(expected, partner)
    apart = turned(expected - labels, -direction)
    near = _near(np.linalg.norm(apart, axis=2), patch_scale)
    known = near.sum(axis=0) >= LEAST
    if not known.any():
        return labels.copy()
    square = np.where(near[..., None], apart**2, 0.0).sum(axis=0)[known]
    variance = np.maximum(square / near.sum(axis=0)[known, None], np.finfo(float).tiny)
    share = np.zeros((len(known), 2))
    # Of eight and more such numbers, the least is so by chance too.
    share[known] = np.minimum(1.0, np.sort(variance, axis=None)[1] / variance)
    moved = np.where(near[..., None], labels + turned(share * apart, direction), labels)
    return _at_rest(moved, expected, labels, near & known, videos)


def consensus(
    labels: FloatArray, found: FloatArray, share: float, patch_scale: FloatArray, videos: Sequence[str]
) -> FloatArray:
    """Labels moved by `share` toward what a network finds, where it agrees with them.

    A keypoint that the network finds to move by less, within a video, than labels are off is at rest there: its
    positions are the median of all.

    Parameters
    ----------
    labels, found : (N, K, 2) px; a label that `found` is too far from stays as it is
    share : 0 leaves all labels, 1 replaces them
    patch_scale : (N,) px of the refiner's patches for one px of the frame
    videos : which video each of the N frames is from
    """
    near = _near(np.linalg.norm(found - labels, axis=2), patch_scale)
    moved = np.where(near[..., None], labels + share * (found - labels), labels)
    return _at_rest(moved, found, labels, near, videos)


def _near(distance: FloatArray, patch_scale: FloatArray) -> BoolArray:
    """Which predictions (N, K) are near enough to their labels to be believed."""
    reach = REACH * np.array([_median(distance[:, k]) for k in range(distance.shape[1])])
    with np.errstate(invalid="ignore"):
        near: BoolArray = distance <= np.minimum(reach, LIMIT_PATCH_PX / patch_scale[:, None])
    return near


def _at_rest(
    moved: FloatArray, found: FloatArray, labels: FloatArray, near: BoolArray, videos: Sequence[str]
) -> FloatArray:
    """Positions, those of a keypoint that rests in a video put together."""
    distance = np.linalg.norm(found - labels, axis=2)
    for video in set(videos):
        of_video = np.array([own == video for own in videos])
        for k in range(labels.shape[1]):
            rows = of_video & near[:, k]
            if rows.sum() < LEAST:
                continue
            motion = np.linalg.norm(found[rows, k] - np.median(found[rows, k], axis=0), axis=1)
            if np.median(motion) <= np.median(distance[rows, k]):
                moved[rows, k] = np.median(moved[rows, k], axis=0)
    return moved


def _median(values: FloatArray) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
