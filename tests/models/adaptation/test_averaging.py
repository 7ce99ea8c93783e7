"""What a network says that has learnt an actuator by itself, beside what it said before."""

from __future__ import annotations

import numpy as np

from bendtrack.models.adaptation.averaging import AveragedPredictor
from bendtrack.tracker.types import Detections


def said(xy: list[list[float]], likelihood: float) -> Detections:
    """One picture's keypoints (1, K)."""
    k = len(xy)
    return Detections(
        np.array([xy]), np.full((1, k), likelihood), np.tile(likelihood * np.eye(2), (1, k, 1, 1))
    )


def test_it_lies_halfway_where_both_see_the_same_and_else_where_the_taught_one_sees_it() -> None:
    taught, before = said([[20.0, 30.0], [50.0, 10.0]], 0.9), said([[22.0, 26.0], [10.0, 10.0]], 0.1)
    found = AveragedPredictor(lambda _: taught, lambda _: before)(np.zeros((1, 3, 64, 64), np.uint8))
    np.testing.assert_array_equal(found.xy, [[[21.0, 28.0], [50.0, 10.0]]])
    np.testing.assert_array_equal(found.likelihood, taught.likelihood)
    np.testing.assert_array_equal(found.covariance, taught.covariance)
