"""Prediction averaging: the self-trained network next to its source network."""

from __future__ import annotations

import numpy as np

from bendtrack.models.adaptation.averaging import AveragedPredictor
from bendtrack.tracker.types import Detections


def predicted(xy: list[list[float]], likelihood: float) -> Detections:
    """Keypoints (1, K) of one crop."""
    k = len(xy)
    return Detections(
        np.array([xy]), np.full((1, k), likelihood), np.tile(likelihood * np.eye(2), (1, k, 1, 1))
    )


def test_the_mean_counts_where_both_agree_and_else_the_self_trained_network() -> None:
    self_trained, source = (
        predicted([[20.0, 30.0], [50.0, 10.0]], 0.9),
        predicted([[22.0, 26.0], [10.0, 10.0]], 0.1),
    )
    found = AveragedPredictor(lambda _: self_trained, lambda _: source)(np.zeros((1, 3, 64, 64), np.uint8))
    np.testing.assert_array_equal(found.xy, [[[21.0, 28.0], [50.0, 10.0]]])
    np.testing.assert_array_equal(found.likelihood, self_trained.likelihood)
    np.testing.assert_array_equal(found.covariance, self_trained.covariance)
