"""From what the network says of itself to covariances and likelihoods that can be believed.

A position is uncertain for two reasons. The network finds a keypoint a little elsewhere in every frame: that is what
its spread head has learnt. And all it knows comes from n labels that are each off by a person's error: however steady
it is, the mark it has learnt is known to label_sd / sqrt(n) only.

A heatmap's peak, too, means little by itself: one keypoint's stays at 0.5 where another's reaches 0.9, and both grow
with training. Compared with the peaks in the labelled frames, where the keypoint is known to be, it says how much of
the usual sight of it there is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray

MEDIAN_CHI2 = float(np.log(4.0))
"""Median squared Mahalanobis distance of a two-dimensional Gaussian."""

LEAST_PEAK = 0.2
"""A network whose peaks are usually lower has not learnt the keypoint: its likelihoods are not raised further."""


@dataclass(frozen=True)
class Calibration:
    """Covariance = scale * spread + label_sd_px**2 / n_labels; likelihood = peak / usual peak, at most 1.

    Attributes
    ----------
    scale : factor on the network's own covariances; above 1 when held-out labels lie further away than spread,
        labelling error and chance explain; of a pretrained network also below it, for its truth is exact and plenty
    label_sd_px : a label's own error, standard deviation of x and of y, from the trained frames' residuals
    n_labels : labels that a keypoint was learnt from
    usual_peak : for each keypoint, the median peak in labelled frames
    """

    scale: float = 1.0
    label_sd_px: float = 0.0
    n_labels: int = 1
    reference_peak: tuple[float, ...] = ()

    def apply(self, found: Detections) -> Detections:
        """Detections with calibrated likelihoods and covariances from the network's own."""
        covariance = found.covariance * self.scale + np.eye(2) * (self.label_sd_px**2 / self.n_labels)
        return replace(found, covariance=covariance, likelihood=self.likelihood(found.likelihood))

    def likelihood(self, peak: FloatArray) -> FloatArray:
        """Likelihoods in [0, 1] from peaks (N, K, ...) of heatmaps."""
        usual = self.usual.reshape(-1, *(1,) * (peak.ndim - 2))
        return np.minimum(peak / usual, 1.0)

    @property
    def usual(self) -> FloatArray:
        """`reference_peak` (K,), none under `LEAST_PEAK`; 1 for all where none is known."""
        return np.asarray(np.maximum(self.reference_peak or 1.0, LEAST_PEAK))

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
    """Calibrate on what the network finds in trained and in held-out frames, labels (N, K, 2) px.

    Medians throughout: one label on the wrong spot must not make every frame uncertain.
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
    """The factor on the network's own covariances that makes its typical distance from the exact truth likely.

    truth : (N, K, 2) px, NaN where nothing is to be found
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
    """The factor on the network's own covariances that makes its distances from positions (N, K, 2) px likely.

    1 where the spread is not clearly too small, or nothing is known. `truth_variance` is the positions' own, of x and
    of y.
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
