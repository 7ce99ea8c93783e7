"""The error model behind label denoising: labelling noise told apart from the network's own errors.

For channel c (one keypoint, along or across its orientation) and frame n, with theta the orientation,

    label - prediction = m_c + f_c(theta_cn) + e_cn + h_cn

The constant m_c and the Gaussian process f_c are the network's systematic part, the white e_cn its per-frame part. The
labelling noise h_cn is white too, and has one standard deviation for all channels: that is what separates it from e_cn.
Variances are marginalised over grids (Rasmussen & Williams 2006, sections 2.7 and 5.4).

Knows nothing of images; `robust_fit` brings positions into this form.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...tracker.types import BoolArray, FloatArray
from ..inference.bias import fourier_series

GP_SD_GRID = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
"""Standard deviations of the Gaussian process that are tried, in units of the typical residual (`network_errors`)."""

LENGTH_SCALES_DEG = (15.0, 30.0, 60.0)
"""Length scales of the Gaussian process that are tried, degrees of orientation."""

WHITE_SD_GRID = np.geomspace(0.05, 5.0, 32)
"""Standard deviations of white noise that are tried, in units of the typical residual."""

HARMONICS = 16
"""Harmonics of the Fourier series that represents the process: at the shortest length scale the variance of the
next one is below 1e-4 of the first one's."""


class NetworkErrors(NamedTuple):
    """The network's part of residuals in C channels and N frames, with the sign of label minus prediction.

    Attributes
    ----------
    systematic : (C, 1 + 2 HARMONICS) float array
        Coefficients of a Fourier series in orientation (`bias.fourier_series`), in px.
    per_frame : (C, N) float array
        What is new in every frame, in px; 0 where no residual is known.
    """

    systematic: FloatArray
    per_frame: FloatArray


def network_errors(residual: FloatArray, known: BoolArray, orientation_rad: FloatArray) -> NetworkErrors:
    """Expected network errors, given residuals that hold labelling noise too.

    Parameters
    ----------
    residual : (C, N) float array
        Label minus prediction, px, one row a channel.
    known : (C, N) bool array
        Where there is a residual; the others are ignored.
    orientation_rad : (C, N) float array
        Orientation of the channel's keypoint in the frame, rad.

    Returns
    -------
    NetworkErrors
        Posterior means.
    """
    channels = zip(residual, known, strict=True)
    median = np.array([np.median(own[k]) if k.any() else 0.0 for own, k in channels])
    centred = np.where(known, residual - median[:, None], 0.0)
    # A robust standard deviation (1.4826 times the median absolute deviation) is the unit of the grids.
    typical_px = 1.4826 * float(np.median(np.abs(centred[known]))) if known.any() else 0.0
    if typical_px > 0:
        series = fourier_series(orientation_rad, HARMONICS)
        systematic, per_frame = _decompose(centred / typical_px, known, series)
        systematic, per_frame = systematic * typical_px, per_frame * typical_px
    else:
        # Residuals without any spread hold no labelling noise: the network's error is all of them.
        systematic, per_frame = np.zeros((len(residual), 1 + 2 * HARMONICS)), centred
    systematic[:, 0] += median
    return NetworkErrors(systematic, per_frame)


def _decompose(residual: FloatArray, known: BoolArray, series: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Systematic and per-frame part of residuals in units of the typical one.

    Parameters
    ----------
    residual, known : (C, N) arrays
        As `network_errors`'s.
    series : (C, N, W) float array
        The Fourier basis at each frame's orientation, W = 1 + 2 HARMONICS.

    Returns
    -------
    systematic : (C, W) float array
    per_frame : (C, N) float array
    """
    log_likelihood, systematic_given_sd = zip(
        *(_posterior(own[k], at[k]) for own, k, at in zip(residual, known, series, strict=True)), strict=True
    )
    # P(total white sd | labelling sd): rows are the labelling noise, columns the sum of labelling noise and per-frame
    # part. Half of the mass says that the network adds nothing, the other half is spread over larger sums.
    larger = np.triu(np.ones((len(WHITE_SD_GRID), len(WHITE_SD_GRID))), 1)
    prior = 0.5 * np.eye(len(WHITE_SD_GRID)) + 0.5 * larger / np.maximum(larger.sum(axis=1, keepdims=True), 1)
    joint = prior * np.exp([log - log.max() for log in log_likelihood])[:, None]
    log_label_sd = np.log(joint.sum(axis=2)).sum(axis=0)
    label_sd = np.exp(log_label_sd - log_label_sd.max())
    network_share = np.maximum(0.0, 1 - (WHITE_SD_GRID[:, None] / WHITE_SD_GRID) ** 2)
    systematic, per_frame = np.zeros((len(residual), series.shape[2])), np.zeros_like(residual)
    for c in range(len(residual)):
        weight = label_sd[:, None] * joint[c] / joint[c].sum(axis=1, keepdims=True)
        weight /= weight.sum()
        systematic[c] = weight.sum(axis=0) @ systematic_given_sd[c]
        rest = residual[c] - systematic_given_sd[c] @ series[c].T  # (S, N), S the sizes of WHITE_SD_GRID
        per_frame[c] = np.where(known[c], (weight * network_share).sum(axis=0) @ rest, 0.0)
    return systematic, per_frame


def _posterior(residual: FloatArray, series: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Log marginal likelihood and posterior mean of one channel's systematic part, for each of `WHITE_SD_GRID`.

    The process's standard deviation and length scale are marginalised over their grids.

    Parameters
    ----------
    residual : (N,) float array
        In units of the typical residual.
    series : (N, W) float array
        The Fourier basis.

    Returns
    -------
    log_likelihood : (S,) float array
        Up to a constant.
    systematic : (S, W) float array
    """
    if not len(residual):
        return np.zeros(len(WHITE_SD_GRID)), np.zeros((len(WHITE_SD_GRID), series.shape[1]))
    logs, means = zip(
        *(_posterior_at_length_scale(residual, series, scale) for scale in LENGTH_SCALES_DEG), strict=True
    )
    log = np.array(logs)
    log[:, 0] += np.log(len(GP_SD_GRID) - 1)  # no process at all is as likely as all its other sizes together
    weight = np.exp(log - log.max())
    # With thousands of labels some of the sums underflow to 0.
    total = np.maximum(weight.sum(axis=(0, 1)), np.finfo(float).tiny)
    expected = np.einsum("rts,rtsw->sw", weight, np.array(means)) / total[:, None]
    return log.max() + np.log(total), expected


def _posterior_at_length_scale(
    residual: FloatArray, series: FloatArray, length_scale_deg: float
) -> tuple[FloatArray, FloatArray]:
    """As `_posterior`, for each of `GP_SD_GRID` (T) too, at one length scale: (T, S) and (T, S, W).

    The constant has a flat prior (Rasmussen & Williams 2006, section 2.7).
    """
    # The squared exponential covariance of two orientations' difference, as a Fourier series around the circle.
    harmonic = np.arange(HARMONICS + 1)
    power = np.exp(-0.5 * (harmonic * np.deg2rad(length_scale_deg)) ** 2)
    amplitude = np.sqrt(power / power.sum())
    amplitude = np.concatenate([amplitude, amplitude[1:]])
    # In the left singular vectors of the scaled basis the covariance is diagonal.
    left, singular, right = np.linalg.svd(series * amplitude, full_matrices=False)
    y, one = left.T @ residual, left.sum(axis=0)
    white = WHITE_SD_GRID**2
    variance = GP_SD_GRID[:, None, None] ** 2 * singular**2 + white[:, None]
    # Outside of the basis's span there is white noise only.
    outside = len(residual) - len(singular)
    weight = (one**2 / variance).sum(axis=2) + (len(residual) - one @ one) / white
    mean = ((one * y / variance).sum(axis=2) + (residual.sum() - one @ y) / white) / weight
    square = (y**2 / variance).sum(axis=2) + (residual @ residual - y @ y) / white
    log = np.log(variance).sum(axis=2) + outside * np.log(white) + np.log(weight) + square - mean**2 * weight
    expected = (GP_SD_GRID[:, None, None] ** 2 * singular * (y - mean[..., None] * one) / variance) @ right
    expected = expected * amplitude
    expected[..., 0] += mean
    return -0.5 * log, expected
