"""Calibration on simulated detections whose truth is known: covariances are about the truth, not about one label."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration, calibrate, typical_scale
from bendtrack.tracker.types import Detections


def simulated(
    n: int, network_sd: float, label_sd: float, own_sd: float, seed: int
) -> tuple[Detections, np.ndarray, np.ndarray]:
    """Detections of n frames with 4 keypoints, labels, and the truth."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(0, 400, (n, 4, 2))
    found = truth + rng.normal(0, network_sd, truth.shape)
    covariance = np.broadcast_to(np.eye(2) * own_sd**2, (n, 4, 2, 2))
    labels = truth + rng.normal(0, label_sd, truth.shape)
    return Detections(found, np.ones((n, 4)), covariance), labels, truth


def predicted_sd(calibration: Calibration, own_sd: float) -> float:
    """Standard deviation along x that is predicted for a position whose own spread is `own_sd`."""
    one = Detections(np.zeros((1, 1, 2)), np.ones((1, 1)), np.eye(2)[None, None] * own_sd**2)
    return float(np.sqrt(replace(calibration, reference_peak=()).apply(one).covariance[0, 0, 0, 0]))


def test_label_error_is_separated_from_the_networks_error() -> None:
    trained, labels, _ = simulated(27, 0.2, 1.0, 0.2, seed=1)
    held, held_labels, _ = simulated(3, 0.2, 1.0, 0.2, seed=2)
    found = calibrate(trained, labels, held, held_labels)
    assert found.label_sd_px == pytest.approx(1.0, rel=0.2)
    assert found.n_labels == 27
    # Not one label's error, but that of the mean of 27, and the network's.
    assert predicted_sd(found, 0.2) == pytest.approx(np.hypot(0.2, 1 / np.sqrt(27)), rel=0.15)


def test_too_small_a_spread_is_scaled_by_held_out_labels() -> None:
    trained, labels, _ = simulated(60, 0.3, 0.5, 0.1, seed=3)
    held, held_labels, _ = simulated(200, 4.0, 0.5, 0.1, seed=4)
    found = calibrate(trained, labels, held, held_labels)
    assert predicted_sd(found, 0.1) == pytest.approx(4.0, rel=0.15)


def test_few_held_out_labels_rarely_inflate_the_scale() -> None:
    inflated = 0
    for seed in range(60):
        trained, labels, _ = simulated(27, 0.2, 1.0, 0.2, seed)
        held, held_labels, _ = simulated(3, 0.2, 1.0, 0.2, seed + 1000)
        inflated += calibrate(trained, labels, held, held_labels).scale > 1
    assert inflated <= 6


def test_one_wrong_label_changes_little() -> None:
    trained, labels, _ = simulated(30, 0.2, 1.0, 0.2, seed=5)
    before = calibrate(trained, labels, None, None)
    labels[3, 1] += 200
    after = calibrate(trained, labels, None, None)
    assert after.label_sd_px == pytest.approx(before.label_sd_px, rel=0.05)


def test_missing_labels_are_ignored() -> None:
    trained, labels, _ = simulated(30, 0.2, 1.0, 0.2, seed=6)
    labels[:10, 2] = np.nan
    found = calibrate(trained, labels, None, None)
    assert np.isfinite(found.label_sd_px)


def test_likelihood_is_the_share_of_the_reference_peak() -> None:
    trained, labels, _ = simulated(20, 0.2, 1.0, 0.2, seed=7)
    peaks = np.broadcast_to([0.5, 0.9, 0.8, 0.05], (20, 4)).copy()
    peaks[0] = 0.01
    found = calibrate(replace(trained, likelihood=peaks), labels, None, None)
    seen = found.apply(replace(trained, likelihood=np.full((20, 4), 0.4))).likelihood[0]
    np.testing.assert_allclose(seen, [0.8, 0.4 / 0.9, 0.5, 1.0])
    unlearnt = found.apply(replace(trained, likelihood=peaks)).likelihood[1, 3]
    assert unlearnt == pytest.approx(0.25), "a keypoint that is never seen well is never likely"


def test_typical_scale_below_and_above_one() -> None:
    rng = np.random.default_rng(5)
    truth = rng.uniform(0, 100, (400, 3, 2))
    truth[::7, 1] = np.nan
    for sd in (0.5, 3.0):
        found = Detections(
            np.nan_to_num(truth) + rng.normal(0, sd, truth.shape),
            np.ones((400, 3)),
            np.tile(np.eye(2), (400, 3, 1, 1)),
        )
        found.xy[::10] += 500.0  # an outlier, not a spread
        assert typical_scale(found, truth) == pytest.approx(sd**2, rel=0.3)
