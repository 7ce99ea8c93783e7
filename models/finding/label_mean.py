"""The mean of the labels, restored: what the network finds must lie where the labels lie on average.

Training ends before the network has settled on that mean, and each tenth of a px it is off by is an error of every
frame. Along the keypoint's own axes, those of its upright patch, the remaining offset is the same in all frames; its
estimate has the error that n labels leave, the label-noise floor, and nothing else has to be learnt for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import FloatArray
from .regions import patch_directions, turned

FAR = 5.0
"""A residual beyond so many robust standard deviations is a label on the wrong spot, not part of a mean."""


def label_offset(
    found: FloatArray, labels: FloatArray, partner: Sequence[int], patch_scale: FloatArray
) -> FloatArray:
    """How far the labels lie from what was found, on average along each keypoint's own axes.

    Parameters
    ----------
    found, labels : (N, K, 2) px; NaN where not labelled
    partner : from `regions.partners`
    patch_scale : (N,) px of the refiner's patches for one px of the frame

    Returns
    -------
    (K, 2) px of the upright patch; 0 for a keypoint that was never labelled
    """
    residual = turned(labels - found, -patch_directions(found, partner)) * patch_scale[:, None, None]
    offset = np.zeros(found.shape[1:])
    for k in range(found.shape[1]):
        own = residual[~np.isnan(residual[:, k, 0]), k]
        if len(own):
            distance = np.linalg.norm(own - np.median(own, axis=0), axis=1)
            # The median distance of a round two-dimensional Gaussian is 1.18 standard deviations.
            near = distance <= FAR * np.median(distance) / 1.18
            offset[k] = own[near].mean(axis=0)
    return offset


def with_offset(
    xy: FloatArray, offset: FloatArray, partner: Sequence[int], patch_scale: FloatArray | float
) -> FloatArray:
    """Positions (N, K, 2) px moved by `label_offset`'s (K, 2); `patch_scale` (N,) or that of all frames."""
    steps = offset / np.broadcast_to(patch_scale, len(xy))[:, None, None]
    return xy + turned(steps, patch_directions(xy, partner))
