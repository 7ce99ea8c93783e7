"""Noisy labels against what a network finds: positions to train on, and where labels lie beside what it finds.

Every label is off by a click's error, and a network can learn thirty such errors by heart. What labels have in common
against it, as ends turn, is its own error (`residuals`); corrected by that it is far nearer to the truth than a click.
Positions to train on are such: first of a network that knows the keypoints before it has seen a label, later of the
running average of the one that learns. What is left of its error when training ends comes off whatever it finds.

Of a fixed end, which is at one place in all frames of a video, shadows tell the frames apart; there the positions are
put together.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...tracker.types import BoolArray, FloatArray
from ..inference.bias import correct_bias
from ..inference.roi import orientations, turned
from .noise_model import NetworkErrors, network_errors

REACH = 4.0
"""A label further from where what was found lets it expect, in median distances, counts nowhere: one of the two is of
another keypoint."""

LIMIT_PATCH_PX = 6.0
"""Nor does a target follow one further than this, in px of the refiner's patches: no label is so far off, the network
is."""

LEAST = 5
"""Frames from which it is believed that a keypoint rests in their video, or how far a network is off."""


def systematic_bias(
    found: FloatArray, labels: FloatArray, reference: Sequence[int], patch_scale: FloatArray
) -> FloatArray:
    """Where the labels lie beside what was found, for `finding.systematic_bias.correct_bias`.

    What is the same in all attitudes is known as exactly as the labels' mean, to the label-noise floor; nothing else
    has to be learnt for it. What changes with the attitude counts as far as there is evidence for it.

    Parameters
    ----------
    found, labels : (N, K, 2) px; NaN where not labelled
    partner : from `regions.partners`
    patch_scale : (N,) px of the refiner's patches for one px of the frame

    Returns
    -------
    (K, 1 + 2 WAVES, 2) px of the upright patch; 0 for a keypoint that was never labelled
    """
    direction = orientations(found, reference)
    residual, distance = _apart(found, labels, direction, patch_scale)
    return _by_keypoint(_errors(residual, _near(distance), direction).slow)


def denoised_positions(
    labels: FloatArray,
    found: FloatArray,
    reference: Sequence[int],
    patch_scale: FloatArray,
    videos: Sequence[str],
) -> tuple[FloatArray, BoolArray]:
    """What a network finds less its own errors, in frames with labels.

    A keypoint that is found to move by less, within a video, than labels are off is at rest there: its positions are
    the median of all.

    Parameters
    ----------
    labels, found : (N, K, 2) px; a label that counts nowhere stays as it is, and so do all of a keypoint with fewer
        than `LEAST` others
    partner : from `regions.partners`
    patch_scale : (N,) px of the refiner's patches for one px of the frame
    videos : which video each of the N frames is from

    Returns
    -------
    Positions (N, K, 2) px, and which of them are not just the label, (N, K).
    """
    direction = orientations(found, reference)
    residual, distance = _apart(found, labels, direction, patch_scale)
    near = _near(distance) & (np.nan_to_num(distance, nan=np.inf) <= LIMIT_PATCH_PX)
    near &= near.sum(axis=0) >= LEAST
    errors = _errors(residual, near, direction)
    expected = correct_bias(found, _by_keypoint(errors.slow), reference, patch_scale)
    sudden = _by_keypoint(errors.sudden).transpose(1, 0, 2) / patch_scale[:, None, None]
    moved = expected + turned(sudden, direction)
    better = _at_rest(np.where(near[..., None], moved, labels), expected, labels, near, videos)
    return better, near


def _apart(
    found: FloatArray, labels: FloatArray, direction: FloatArray, patch_scale: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Labels less found (N, K, 2) patch px in axes of a direction (N, K), and how far those are from usual, (N, K)."""
    residual = turned(labels - found, -direction) * patch_scale[:, None, None]
    usual = np.array([[_median(residual[:, k, i]) for i in (0, 1)] for k in range(labels.shape[1])])
    return residual, np.linalg.norm(residual - usual, axis=2)


def _near(distance: FloatArray) -> BoolArray:
    """Which labels are near enough to what was found to count, from how far they are from usual (N, K)."""
    reach = REACH * np.array([_median(distance[:, k]) for k in range(distance.shape[1])])
    with np.errstate(invalid="ignore"):
        near: BoolArray = distance <= reach
    return near


def _errors(residual: FloatArray, near: BoolArray, direction: FloatArray) -> NetworkErrors:
    """`network_errors` of residuals (N, K, 2), along and across, a keypoint after the other."""
    rows = np.nan_to_num(residual.transpose(1, 2, 0).reshape(-1, len(residual)))
    return network_errors(rows, np.repeat(near.T, 2, axis=0), np.repeat(direction.T, 2, axis=0))


def _by_keypoint(rows: FloatArray) -> FloatArray:
    """Rows (2 K, M) of `_errors` as (K, M, 2)."""
    return rows.reshape(len(rows) // 2, 2, -1).transpose(0, 2, 1)


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
