"""What lies between a hand's labels and what a network finds, told apart: the hand's noise from the network's errors.

The hand's noise is as large for every keypoint and in every direction, and new in every frame. The network's error is,
for each keypoint and direction by itself, partly the same everywhere, partly slow, as it turns with the keypoint's end
(light falls on another side of it), and partly new in every frame. Label less found is then a Gaussian process
(Rasmussen & Williams 2006, chapters 2 and 5); how large its parts are is weighed by the evidence for them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...tracker.types import BoolArray, FloatArray
from ..inference.bias import fourier_series

SLOW = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
"""Standard deviations tried for the slow part, in typical residuals."""

REACHES_DEG = (15.0, 30.0, 60.0)
"""Turns tried within which the slow part changes."""

SUDDEN = np.geomspace(0.05, 5.0, 32)
"""Standard deviations tried for what is new in every frame, in typical residuals."""

HARMONICS = 16
"""Of the slow part around a full turn: the shortest reach leaves nothing of a next one."""


class NetworkErrors(NamedTuple):
    """The network's part of residuals (C, N), with the sign of label less found.

    Attributes
    ----------
    slow : (C, 1 + 2 WAVES) what is the same everywhere and what is slow, of `waves`
    sudden : (C, N) what is new in every frame, 0 where no residual is known
    """

    slow: FloatArray
    sudden: FloatArray


def network_errors(residual: FloatArray, known: BoolArray, orientation_rad: FloatArray) -> NetworkErrors:
    """Tell the network's part of residuals from the hand's.

    Parameters
    ----------
    residual : (C, N) px, in C directions of keypoints
    known : (C, N), which residuals there are
    attitude_rad : (C, N) direction of the keypoint's end in the frame
    """
    pairs = zip(residual, known, strict=True)
    middle = np.array([np.median(own[k]) if k.any() else 0.0 for own, k in pairs])
    apart = np.where(known, residual - middle[:, None], 0.0)
    # The standard deviation that is typical; of residuals that are all the same, the network's error is all.
    typical_px = 1.4826 * float(np.median(np.abs(apart[known]))) if known.any() else 0.0
    if typical_px > 0:
        slow, sudden = _told_apart(apart / typical_px, known, fourier_series(orientation_rad, HARMONICS))
        slow, sudden = slow * typical_px, sudden * typical_px
    else:
        slow, sudden = np.zeros((len(residual), 1 + 2 * HARMONICS)), apart
    slow[:, 0] += middle
    return NetworkErrors(slow, sudden)


def _told_apart(residual: FloatArray, known: BoolArray, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slow and sudden part, as `NetworkErrors`, of residuals (C, N) in typical ones; wave (C, N, 1 + 2 WAVES)."""
    logs, slows = zip(
        *(_weigh(own[k], at[k]) for own, k, at in zip(residual, known, wave, strict=True)), strict=True
    )
    # Rows are the hand's noise, columns all that is sudden, as likely as not nothing besides the hand's.
    more = np.triu(np.ones((len(SUDDEN), len(SUDDEN))), 1)
    prior = 0.5 * np.eye(len(SUDDEN)) + 0.5 * more / np.maximum(more.sum(axis=1, keepdims=True), 1)
    joint = prior * np.exp([log - log.max() for log in logs])[:, None]
    log_hand = np.log(joint.sum(axis=2)).sum(axis=0)
    hand = np.exp(log_hand - log_hand.max())
    own_share = np.maximum(0.0, 1 - (SUDDEN[:, None] / SUDDEN) ** 2)
    slow, sudden = np.zeros((len(residual), wave.shape[2])), np.zeros_like(residual)
    for c in range(len(residual)):
        weight = hand[:, None] * joint[c] / joint[c].sum(axis=1, keepdims=True)
        weight /= weight.sum()
        slow[c] = weight.sum(axis=0) @ slows[c]
        rest = residual[c] - slows[c] @ wave[c].T  # (S, N), for each standard deviation of what is sudden
        sudden[c] = np.where(known[c], (weight * own_share).sum(axis=0) @ rest, 0.0)
    return slow, sudden


def _weigh(residual: FloatArray, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log evidence (S,) of residuals (N,) for each of `SUDDEN`, and all else that is to be expected of them then.

    The latter is (S, 1 + 2 WAVES), of waves (N, 1 + 2 WAVES).
    """
    if not len(residual):
        return np.zeros(len(SUDDEN)), np.zeros((len(SUDDEN), wave.shape[1]))
    logs, parts = zip(*(_weigh_reach(residual, wave, reach) for reach in REACHES_DEG), strict=True)
    log = np.array(logs)
    log[:, 0] += np.log(len(SLOW) - 1)  # as likely as not nothing is slow
    weight = np.exp(log - log.max())
    # However unlikely, not impossible: of thousands of labels a number cannot hold how much.
    total = np.maximum(weight.sum(axis=(0, 1)), np.finfo(float).tiny)
    expected = np.einsum("rts,rtsw->sw", weight, np.array(parts)) / total[:, None]
    return log.max() + np.log(total), expected


def _weigh_reach(residual: FloatArray, wave: FloatArray, reach_deg: float) -> tuple[FloatArray, FloatArray]:
    """Log evidence (T, S) and expectation (T, S, 1 + 2 WAVES) for `SLOW`, `SUDDEN` and one reach, the mean free."""
    # A Gaussian of the turn between two attitudes, as waves around the circle.
    number = np.arange(HARMONICS + 1)
    power = np.exp(-0.5 * (number * np.deg2rad(reach_deg)) ** 2)
    size = np.sqrt(power / power.sum())
    size = np.concatenate([size, size[1:]])
    vectors, root, back = np.linalg.svd(wave * size, full_matrices=False)
    y, one = vectors.T @ residual, vectors.sum(axis=0)
    sudden = SUDDEN**2
    variance = SLOW[:, None, None] ** 2 * root**2 + sudden[:, None]
    # What lies outside of all waves is sudden.
    out = len(residual) - len(root)
    weight = (one**2 / variance).sum(axis=2) + (len(residual) - one @ one) / sudden
    mean = ((one * y / variance).sum(axis=2) + (residual.sum() - one @ y) / sudden) / weight
    square = (y**2 / variance).sum(axis=2) + (residual @ residual - y @ y) / sudden
    log = np.log(variance).sum(axis=2) + out * np.log(sudden) + np.log(weight) + square - mean**2 * weight
    expected = (SLOW[:, None, None] ** 2 * root * (y - mean[..., None] * one) / variance) @ back * size
    expected[..., 0] += mean
    return -0.5 * log, expected
