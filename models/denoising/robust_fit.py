"""A robust fit of predictions to noisy labels: denoised positions to train on.

Every label carries a click's error, and a network can learn thirty such errors by heart. What labels and predictions
differ by systematically, as the ends turn, is the network's own error (`noise_model`); without it a prediction is far
nearer to the truth than a click. Training positions are such predictions: at first of a network that knew the keypoints
before it saw a label, later of the running average of the one in training.

A fixed end rests at one position in all frames of a video, where a network can tell frames apart by their shadows;
there the positions are replaced by their median. One that yields as the body bends does not rest: the labels say so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import f as f_distribution

from ...tracker.types import BoolArray, FloatArray
from ..inference.bias import correct_bias
from ..inference.roi import turned
from .geometry import FrameGeometry
from .noise_model import NetworkErrors, network_errors

OUTLIER_FACTOR = 4.0
"""A label whose residual is further from the median residual than so many median distances is an outlier, and is not
used: label and prediction are of different keypoints."""

MAX_RESIDUAL_PATCH_PX = 6.0
"""A label further from the median residual than this, in px of the refiner's patches, is not denoised: no click is so
far off, so the network is."""

MIN_FRAMES = 5
"""Fewest inlier labels from which a keypoint's error model, or its rest in a video, is estimated."""

YIELDING_CHANCE = 1e-4
"""A keypoint yields where chance makes its labels follow the body's bend as closely with less than this probability. A
video has four such tests of its fixed end, so one video in 2500 is mistaken."""


def denoised_positions(
    labels: FloatArray, found: FloatArray, geometry: FrameGeometry
) -> tuple[FloatArray, BoolArray]:
    """Predictions minus the network's expected error, in frames with labels.

    A keypoint whose predictions move by less within a video than the labels scatter is at rest there: its positions
    are their median.

    Parameters
    ----------
    labels : (N, K, 2) float array
        px; NaN where not labelled.
    found : (N, K, 2) float array
        Predictions, px.
    geometry : FrameGeometry
        Of the N frames.

    Returns
    -------
    positions : (N, K, 2) float array
        px. An outlier keeps its label, and so do all labels of a keypoint with fewer than `MIN_FRAMES` inliers.
    denoised : (N, K) bool array
        Which positions are more than the label.
    """
    orientation = geometry.orientations(found)
    residual, distance = _residuals(found, labels, orientation, geometry)
    inlier = _inliers(distance) & (np.nan_to_num(distance, nan=np.inf) <= MAX_RESIDUAL_PATCH_PX)
    inlier &= inlier.sum(axis=0) >= MIN_FRAMES
    errors = _network_errors(residual, inlier, orientation)
    unbiased = correct_bias(found, _by_keypoint(errors.systematic), geometry.reference, geometry.patch_scale)
    per_frame = _by_keypoint(errors.per_frame).transpose(1, 0, 2) / geometry.patch_scale[:, None, None]
    corrected = unbiased + turned(per_frame, orientation)
    positions = np.where(inlier[..., None], corrected, labels)
    return _resting_at_their_median(positions, unbiased, labels, inlier, geometry), inlier


def _residuals(
    found: FloatArray, labels: FloatArray, orientation: FloatArray, geometry: FrameGeometry
) -> tuple[FloatArray, FloatArray]:
    """Label minus prediction (N, K, 2) patch px along and across an orientation (N, K) rad, and its distance (N, K)
    from the keypoint's median residual."""
    residual = turned(labels - found, -orientation) * geometry.patch_scale[:, None, None]
    median = np.array([[_nanmedian(residual[:, k, i]) for i in (0, 1)] for k in range(labels.shape[1])])
    return residual, np.linalg.norm(residual - median, axis=2)


def _inliers(distance: FloatArray) -> BoolArray:
    """Inlier mask (N, K) from the distances (N, K) of residuals from their median; False where not labelled."""
    limit = OUTLIER_FACTOR * np.array([_nanmedian(distance[:, k]) for k in range(distance.shape[1])])
    with np.errstate(invalid="ignore"):
        inlier: BoolArray = distance <= limit
    return inlier


def _network_errors(residual: FloatArray, inlier: BoolArray, orientation: FloatArray) -> NetworkErrors:
    """`network_errors` of residuals (N, K, 2): two channels a keypoint, along and across its orientation (N, K)."""
    channels = np.nan_to_num(residual.transpose(1, 2, 0).reshape(-1, len(residual)))
    return network_errors(channels, np.repeat(inlier.T, 2, axis=0), np.repeat(orientation.T, 2, axis=0))


def _by_keypoint(channels: FloatArray) -> FloatArray:
    """Channels (2 K, M) of `_network_errors` as (K, M, 2)."""
    return channels.reshape(len(channels) // 2, 2, -1).transpose(0, 2, 1)


def _resting_at_their_median(
    positions: FloatArray,
    unbiased: FloatArray,
    labels: FloatArray,
    inlier: BoolArray,
    geometry: FrameGeometry,
) -> FloatArray:
    """Positions (N, K, 2) px, those of a keypoint at rest in a video replaced by their median.

    A keypoint is at rest where the predictions without bias, `unbiased` (N, K, 2) px, move by no more than they
    differ from the labels, in the median over the inliers (N, K), and the labels do not follow the bend (`_yielding`).
    """
    positions = positions.copy()
    distance = np.linalg.norm(unbiased - labels, axis=2)
    for _, of_video in geometry.frames_by_video():
        yielding = _yielding(unbiased, labels, inlier & of_video[:, None], geometry.reference)
        for k in range(labels.shape[1]):
            rows = of_video & inlier[:, k]
            if rows.sum() < MIN_FRAMES or yielding[k]:
                continue
            motion = np.linalg.norm(unbiased[rows, k] - np.median(unbiased[rows, k], axis=0), axis=1)
            if np.median(motion) <= np.median(distance[rows, k]):
                positions[rows, k] = np.median(positions[rows, k], axis=0)
    return positions


def _yielding(
    unbiased: FloatArray, labels: FloatArray, inlier: BoolArray, reference: Sequence[int]
) -> BoolArray:
    """Keypoints (K,) whose labels (N, K, 2) px in one video follow the keypoint that moves most.

    A clamp gives way in proportion to the load, so that its keypoints go along with the bend, by less than a single
    label is uncertain. Labels are used, not predictions: a network in training follows the labels' noise. An end is
    rigid: both its keypoints yield or neither does.
    """
    k = labels.shape[1]
    extent = np.array([_nanmedian(_distances(unbiased[inlier[:, j], j])) for j in range(k)])
    leader = int(extent.argmax())
    follows = np.zeros(k, bool)
    for j in range(k):
        rows = inlier[:, j] & inlier[:, leader]
        if j != leader:
            follows[j] = _chance(labels[rows, j], unbiased[rows, leader]) < YIELDING_CHANCE
    return np.array(
        [follows[j] or (reference[reference[j]] == j and follows[reference[j]]) for j in range(k)]
    )


def _distances(xy: FloatArray) -> FloatArray:
    """Distances (N,) of positions (N, 2) from their median."""
    return np.asarray(np.linalg.norm(xy - np.median(xy, axis=0), axis=1)) if len(xy) else np.zeros(0)


def _chance(followers: FloatArray, leaders: FloatArray) -> float:
    """Probability that positions (N, 2) are as close to a linear function of others (N, 2) by chance (F test).

    The less likely one of both axes; 1 with too few of them.
    """
    n, terms = len(followers), 3
    if n <= terms:
        return 1.0
    design = np.column_stack([np.ones(n), leaders])
    coefficients, *_ = np.linalg.lstsq(design, followers, rcond=None)
    rest = ((followers - design @ coefficients) ** 2).sum(axis=0)
    explained = ((followers - followers.mean(axis=0)) ** 2).sum(axis=0) - rest
    ratio = (explained / (terms - 1)) / np.maximum(rest / (n - terms), 1e-12)
    return float(f_distribution.sf(ratio.max(), terms - 1, n - terms))


def _nanmedian(values: FloatArray) -> float:
    """Median of the values that are known, 0 where none is."""
    known = values[~np.isnan(values)]
    return float(np.median(known)) if known.size else 0.0
