"""From what the network says of its spread to a covariance of the position that can be believed.

A position is uncertain for two reasons. The network finds a keypoint a little elsewhere in every frame: that is what
its spread head has learnt. And all it knows comes from n labels that are each off by a person's error: however steady
it is, the mark it has learnt is known to label_sd / sqrt(n) only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..tracker.types import Detections, FloatArray

MEDIAN_CHI2 = float(np.log(4.0))
"""Median squared Mahalanobis distance of a two-dimensional Gaussian."""


@dataclass(frozen=True)
class Calibration:
    """Covariance = scale * spread + label_sd_px**2 / n_labels.

    Attributes
    ----------
    scale : factor on the network's own covariances, at least 1; above it when held-out labels lie further away
        than spread, labelling error and chance explain
    label_sd_px : a label's own error, standard deviation of x and of y, from the trained frames' residuals
    n_labels : labels that a keypoint was learnt from
    """

    scale: float = 1.0
    label_sd_px: float = 0.0
    n_labels: int = 1

    def apply(self, covariance: FloatArray) -> FloatArray:
        """Covariances (..., 2, 2) px^2 of positions from the network's own."""
        return covariance * self.scale + np.eye(2) * (self.label_sd_px**2 / self.n_labels)


def calibrate(
    trained: Detections, trained_labels: FloatArray, held: Detections | None, held_labels: FloatArray | None
) -> Calibration:
    """Calibrate on what the network finds in trained and in held-out frames, labels (N, K, 2) px.

    Medians throughout: one label on the wrong spot must not make every frame uncertain.
    """
    residual = trained.xy - trained_labels
    residual = residual[~np.isnan(residual).any(axis=2)]
    n = int(max(1, np.median((~np.isnan(trained_labels).any(axis=2)).sum(axis=0))))
    label_sd = float(np.sqrt(np.median((residual**2).sum(axis=1)) / MEDIAN_CHI2))
    if held is None or held_labels is None:
        return Calibration(1.0, label_sd, n)
    off = held.xy - held_labels
    seen = ~np.isnan(off).any(axis=2)
    off, own = off[seen], held.covariance[seen]

    def distance2(scale: float) -> float:
        covariance = own * scale + np.eye(2) * label_sd**2 * (1 + 1 / n)
        return float(np.median(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)))

    # Few points are held out, and half of all medians lie above their expectation: only what chance would not do
    # (two standard errors of the median, 2 / sqrt(n) each) says that the spread is too small.
    chance = MEDIAN_CHI2 + 2 * 2 / np.sqrt(max(len(off), 1))
    if not len(off) or distance2(1.0) <= chance:
        return Calibration(1.0, label_sd, n)
    low, high = 1.0, 1e4
    for _ in range(60):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if distance2(middle) > MEDIAN_CHI2 else (low, middle)
    return Calibration(high, label_sd, n)
