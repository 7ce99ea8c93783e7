"""Noisy labels weighed together: positions to train on that follow the averaged network where it agrees.

Every label is off by a click's error, and a network can learn thirty such errors by heart. Its running average, though,
agrees with what the labels have in common before it agrees with each; moving the positions toward it and training on
keeps it there.
"""

from __future__ import annotations

import numpy as np

from ...tracker.types import FloatArray

REACH = 4.0
"""A prediction further than this from its label, in median distances, is not believed: perhaps another keypoint."""

LIMIT_PATCH_PX = 6.0
"""Nor is one further than this, in px of the refiner's patches: no label is so far off, the network is."""


def consensus(labels: FloatArray, found: FloatArray, share: float, patch_scale: FloatArray) -> FloatArray:
    """Labels moved by `share` toward what a network finds, where it agrees with them.

    Parameters
    ----------
    labels, found : (N, K, 2) px; a label that `found` is too far from stays as it is
    share : 0 leaves all labels, 1 replaces them
    patch_scale : (N,) px of the refiner's patches for one px of the frame
    """
    distance = np.linalg.norm(found - labels, axis=2)
    with np.errstate(invalid="ignore"):
        reach = REACH * np.array([_median(distance[:, k]) for k in range(labels.shape[1])])
        near = distance <= np.minimum(reach, LIMIT_PATCH_PX / patch_scale[:, None])
    return np.where(near[..., None], labels + share * (found - labels), labels)


def _median(values: FloatArray) -> float:
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
