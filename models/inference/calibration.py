"""Calibration: from a network's own spreads and peaks to covariances and likelihoods.

A position is uncertain for two reasons. The network finds a keypoint a little elsewhere in every frame: its spread head
has learnt how much. And all it knows comes from n labels with an error of `label_sd_px` each: however steady the
network is, the labelled point is known to label_sd_px / sqrt(n) only.

A heatmap's peak is no probability. One keypoint's stays at 0.5 where another's reaches 0.9, and both grow with
training. Divided by its median in labelled frames, the reference peak, it says how well the keypoint is seen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray

MEDIAN_CHI2 = float(np.log(4.0))
"""Median squared Mahalanobis distance of a two-dimensional Gaussian."""

MIN_REFERENCE_PEAK = 0.2
"""A network with a lower reference peak has not learnt the keypoint: its likelihoods are not raised further."""


@dataclass(frozen=True)
class Calibration:
    """Covariance = scale * spread + label_sd_px**2 / n_labels; likelihood = peak / reference peak, at most 1.

    Attributes
    ----------
    scale : float
        Factor on the network's own covariances. Above 1 where held-out labels lie further away than spread, label
        noise and chance explain. For a pretrained network also below 1, since its truth is exact and plentiful.
    label_sd_px : float
        Standard deviation of a label's error in x and in y, px, from the residuals of the training frames.
    n_labels : int
        Labels that a keypoint was learnt from.
    reference_peak : tuple of float
        For each of K keypoints the median peak in labelled frames; empty where none is known.
    """

    scale: float = 1.0
    label_sd_px: float = 0.0
    n_labels: int = 1
    reference_peak: tuple[float, ...] = ()

    def apply(self, found: Detections) -> Detections:
        """Detections (N, K) with calibrated likelihoods and covariances, from the network's own."""
        covariance = found.covariance * self.scale + np.eye(2) * (self.label_sd_px**2 / self.n_labels)
        return replace(found, covariance=covariance, likelihood=self.likelihood(found.likelihood))

    def likelihood(self, peak: FloatArray) -> FloatArray:
        """Likelihoods in [0, 1] from peaks (N, K, ...) of heatmaps."""
        reference = self.normalising_peak.reshape(-1, *(1,) * (peak.ndim - 2))
        return np.minimum(peak / reference, 1.0)

    @property
    def normalising_peak(self) -> FloatArray:
        """What peaks are divided by, (K,): `reference_peak`, at least `MIN_REFERENCE_PEAK`; 1 where none is known."""
        return np.asarray(np.maximum(self.reference_peak or 1.0, MIN_REFERENCE_PEAK))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, under the names of the checkpoint's format, and read back by `from_dict`."""
        return {
            "scale": self.scale,
            "label_sd_px": self.label_sd_px,
            "n_labels": self.n_labels,
            "usual_peak": list(self.reference_peak),
        }

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Calibration:
        """The calibration that `to_dict` wrote."""
        return cls(values["scale"], values["label_sd_px"], values["n_labels"], tuple(values["usual_peak"]))


def calibrate(
    trained: Detections, trained_labels: FloatArray, held: Detections | None, held_labels: FloatArray | None
) -> Calibration:
    """Calibrate on what the network finds in training frames and in held-out frames.

    Medians throughout: one label on the wrong spot must not make every frame uncertain.

    Parameters
    ----------
    trained : Detections
        (N, K), in the training frames.
    trained_labels : ndarray of float, shape (N, K, 2)
        Their labels, px; NaN where not labelled.
    held : Detections or None
        (M, K), in the held-out frames.
    held_labels : ndarray of float, shape (M, K, 2), or None
        Their labels.
    """
    residual = trained.xy - trained_labels
    known = np.logical_not(np.isnan(residual[..., 0]))
    n = int(max(1, np.median((~np.isnan(trained_labels).any(axis=2)).sum(axis=0))))
    label_sd = float(np.sqrt(np.median((residual[known] ** 2).sum(axis=1)) / MEDIAN_CHI2))
    scale = 1.0
    if held is not None and held_labels is not None:
        scale = spread_scale(held, held_labels, label_sd**2 * (1 + 1 / n))
    return Calibration(scale, label_sd, n, reference_peaks(trained.likelihood, known))


def typical_scale(found: Detections, truth: FloatArray) -> float:
    """The factor on the network's own covariances that explains its median distance from the exact truth.

    Parameters
    ----------
    found : Detections
        (N, K).
    truth : ndarray of float, shape (N, K, 2)
        px; NaN where a keypoint cannot be seen.
    """
    off = found.xy - truth
    seen = ~np.isnan(off).any(axis=2)
    distance2 = np.einsum("ni,nij,nj->n", off[seen], np.linalg.inv(found.covariance[seen]), off[seen])
    return float(np.median(distance2)) / MEDIAN_CHI2


def reference_peaks(likelihood: FloatArray, known: BoolArray) -> tuple[float, ...]:
    """For each keypoint the median peak of heatmaps (N, K) where it is known (N, K) to be there."""
    return tuple(
        float(np.median(own[seen])) if seen.any() else 1.0
        for own, seen in zip(likelihood.T, known.T, strict=True)
    )


def spread_scale(found: Detections, truth: FloatArray, truth_variance: float) -> float:
    """The factor on the network's own covariances that explains its distances from noisy positions.

    Parameters
    ----------
    found : Detections
        (N, K).
    truth : ndarray of float, shape (N, K, 2)
        Positions, px; NaN where unknown.
    truth_variance : float
        Variance of these positions in x and in y, px^2.

    Returns
    -------
    float
        1 where the spread is not clearly too small, or nothing is known.
    """
    off = found.xy - truth
    seen = ~np.isnan(off).any(axis=2)
    off, own = off[seen], found.covariance[seen]

    def distance2(scale: float) -> float:
        covariance = own * scale + np.eye(2) * truth_variance
        return float(np.median(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)))

    # Few points are held out, and half of all medians lie above their expectation: only what chance would not do
    # (two standard errors of the median, 2 / sqrt(n) each) says that the spread is too small.
    chance = MEDIAN_CHI2 + 2 * 2 / np.sqrt(max(len(off), 1))
    if not len(off) or distance2(1.0) <= chance:
        return 1.0
    low, high = 1.0, 1e4
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if distance2(middle) > MEDIAN_CHI2 else (low, middle)
    return high
