"""Calibration on simulated detections whose truth is known: covariances are about the truth, not about one label."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.inference.calibration import (
    MOST_CORRELATED,
    Calibration,
    calibrate,
    end_correlation,
    few_label_variance_px2,
    film_scale,
    resting_scale,
    turn_shrinkage,
    typical_scale,
)
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


def test_a_keypoint_that_rests_is_as_uncertain_as_it_is_found_there() -> None:
    found, _, truth = simulated(200, 0.7, 1.0, 1.0, seed=5)
    resting = truth.copy()
    resting[:, 2:] = np.nan  # they move
    resting[0, 0] = np.nan
    scales = resting_scale(found, resting)
    np.testing.assert_allclose(scales[:2], 0.7**2, rtol=0.3)
    assert scales[2:] == (1.0, 1.0)
    # Neither far more certain than the network says, nor less: that is what held-out labels tell.
    assert resting_scale(simulated(200, 0.01, 1.0, 1.0, seed=6)[0], truth)[0] >= 0.25
    assert (
        resting_scale(simulated(200, 3.0, 1.0, 1.0, seed=5)[0], simulated(200, 3.0, 1.0, 1.0, seed=5)[2])
        == (1.0,) * 4
    )
    calibration = Calibration(label_sd_px=0.0, resting_scale=(0.25, 1.0))
    two = Detections(np.zeros((1, 2, 2)), np.ones((1, 2)), np.broadcast_to(np.eye(2), (1, 2, 2, 2)))
    assert calibration.apply(two).covariance[0, :, 0, 0].tolist() == [0.25, 1.0]


def test_a_rigid_end_turns_less_than_two_points_that_err_by_themselves() -> None:
    """Both points of an end are 40 px apart and share most of their error."""
    rng = np.random.default_rng(0)
    frames, length, turn_sd, label_variance = 4000, 40.0, 0.005, 0.02
    xy = np.zeros((frames, 2, 2))
    xy[:, 1, 0] = length
    shared, turn = rng.normal(0, 0.6, frames), rng.normal(0, turn_sd, frames)
    noise = rng.normal(0, np.sqrt(label_variance), (frames, 2))
    xy[:, 0, 1] = shared - turn * length / 2 + noise[:, 0]
    xy[:, 1, 1] = shared + turn * length / 2 + noise[:, 1]
    variance = float(xy[:, :, 1].var(axis=0).mean())
    found = Detections(xy, np.ones((frames, 2)), np.broadcast_to(np.eye(2) * variance, (frames, 2, 2, 2)))
    correlation = end_correlation(found, (0, 1), turn_sd, label_variance)
    assert correlation == pytest.approx(np.corrcoef(xy[:, 0, 1], xy[:, 1, 1])[0, 1], abs=0.01)
    # An end that turns more than its points say has no correlation to take away.
    assert end_correlation(found, (0, 1), 1.0, label_variance) == 0.0
    assert end_correlation(found, (0, 1), 0.0, 0.0) == MOST_CORRELATED


def test_what_is_written_is_read_back() -> None:
    own = Calibration(1.5, 1.0, 27, (0.5, 0.6), (0.25, 1.0), ((0, 1, 0.9),))
    assert Calibration.from_dict(own.to_dict()) == own
    earlier = {key: own.to_dict()[key] for key in ("scale", "label_sd_px", "n_labels", "usual_peak")}
    assert Calibration.from_dict(earlier) == Calibration(1.5, 1.0, 27, (0.5, 0.6))


def test_few_clicks_leave_the_direction_of_an_end_as_unsure_as_both_say() -> None:
    """The network's direction and the clicks' are combined by their variances."""
    for n, length in ((1, 20.0), (1, 60.0), (4, 60.0)):
        clicks, prior = 2 / (n * length**2), np.deg2rad(2.0) ** 2
        together = 1 / (1 / clicks + 1 / prior)
        assert 2 * few_label_variance_px2(n, length) / length**2 == pytest.approx(together)
    assert turn_shrinkage(100_000, 60.0) == pytest.approx(1.0, abs=1e-3)


def test_a_film_in_other_light_has_its_own_peaks() -> None:
    rng = np.random.default_rng(0)
    bright, dim = rng.uniform(0.9, 1.0, (200, 2)), rng.uniform(0.4, 0.7, (200, 2))
    np.testing.assert_allclose(film_scale(bright), np.quantile(bright, 0.25, axis=0))
    scale = film_scale(np.hstack([bright, dim]))
    assert scale[:2].min() > 0.9
    assert scale[2:].tolist() == [0.5, 0.5]  # no lower than half
    # What failed a check, and what could not be decoded, says nothing of the light.
    failed = bright.copy()
    failed[:80, 1] = 0.0
    failed[80:90] = np.nan
    assert film_scale(failed).min() > 0.9
    failed[:130, 1] = 0.0
    assert film_scale(failed).tolist() == [1.0, 1.0]
    assert film_scale(np.full((3, 2), np.nan)).tolist() == [1.0, 1.0]


def test_the_labels_of_another_actuator_do_not_count() -> None:
    trained, labels, _ = simulated(54, 0.2, 1.0, 0.2, seed=1)
    one, two = (calibrate(trained, labels, None, None, actuators) for actuators in (1, 2))
    assert (one.n_labels, two.n_labels) == (54, 27)
    assert two.label_variance_px2 == pytest.approx(2 * one.label_variance_px2)
