"""Noisy labels weighed together: positions to train on that follow the averaged network where it agrees.

Every label is off by a click's error, and a network can learn thirty such errors by heart. Its running average, though,
agrees with what the labels have in common before it agrees with each; moving the positions toward it and training on
keeps it there. Of a fixed end, which is at one place in all frames of a video, shadows tell the frames apart; there the
positions are put together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import FloatArray

REACH = 4.0
"""A prediction further than this from its label, in median distances, is not believed: perhaps another keypoint."""

LIMIT_PATCH_PX = 6.0
"""Nor is one further than this, in px of the refiner's patches: no label is so far off, the network is."""

LEAST_AT_REST = 5
"""Frames of a video from which it is believed that a keypoint rests in it."""


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
    distance = np.linalg.norm(found - labels, axis=2)
    with np.errstate(invalid="ignore"):
        reach = REACH * np.array([_median(distance[:, k]) for k in range(labels.shape[1])])
        near = distance <= np.minimum(reach, LIMIT_PATCH_PX / patch_scale[:, None])
    moved = np.where(near[..., None], labels + share * (found - labels), labels)
    for video in set(videos):
        of_video = np.array([own == video for own in videos])
        for k in range(labels.shape[1]):
            rows = of_video & near[:, k]
            if rows.sum() < LEAST_AT_REST:
                continue
            motion = np.linalg.norm(found[rows, k] - np.median(found[rows, k], axis=0), axis=1)
            if np.median(motion) <= np.median(distance[rows, k]):
                moved[rows, k] = np.median(moved[rows, k], axis=0)
    return moved


def _median(values: FloatArray) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
