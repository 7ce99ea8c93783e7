"""Systematic bias of predictions against labels, and denoised positions that are better than a click."""

from __future__ import annotations

import numpy as np
import pytest

from bendtrack.models.denoising.geometry import FrameGeometry
from bendtrack.models.denoising.robust_fit import denoised_positions

REFERENCE = (1, 0, 3, 2)
FRAMES = 30
SCALE = np.ones(FRAMES)


def geometry(
    scale: np.ndarray, reference: tuple[int, ...] = REFERENCE, videos: list[str] | None = None
) -> FrameGeometry:
    """Of frames with these scales, from one video unless `videos` says otherwise."""
    return FrameGeometry(reference, scale, tuple(videos or ["one"] * len(scale)))


def arms(angles_deg: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Four points (N, 4, 2) px of arms whose far end is turned, in frames of different sizes."""
    turn = np.deg2rad(angles_deg)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    base = np.broadcast_to([[100.0, 100.0], [160.0, 100.0]], (len(turn), 2, 2))
    tip = np.stack([base[:, 1] + 80 * along, base[:, 1] + 140 * along], axis=1)
    return np.concatenate([base, tip], axis=1) / scale[:, None, None]


@pytest.fixture
def bends() -> tuple[np.ndarray, np.ndarray]:
    """Arms at many angles, a third of them in frames of double the size."""
    scale = np.where(np.arange(FRAMES) % 3, 1.2, 0.6)
    return arms(np.linspace(-20, 220, FRAMES), scale), scale


def off_mean_px(moved: np.ndarray, truth: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Standard deviation (K, 2) px; what the labels' mean is off by is no business of a network."""
    return np.asarray((moved - truth - (labels - truth).mean(axis=0)).std(axis=0))


def test_thousands_of_labels_do_not_underflow() -> None:
    rng = np.random.default_rng(4)
    truth = arms(rng.uniform(0, 180, 3000), np.ones(3000))
    found = truth + rng.normal(0, 0.01, truth.shape)
    found[:, 3] += rng.normal(0, 3.0, (3000, 2))
    labels = truth + rng.normal(0, 1.0, truth.shape)
    moved, _ = denoised_positions(labels, found, geometry(np.ones(3000)))
    # Sure of the first three. Of the last the labels are nine times as sure as the network.
    error = off_mean_px(moved, truth, labels)
    assert error[:3].max() < 0.1
    assert 0.9 < error[3].max() < 1.0


def test_labelling_noise_is_removed_and_the_networks_noise_is_not_added() -> None:
    """Four keypoints on a moving body: the network knows two, is unsure of one along the body, and lost at the last."""
    rng = np.random.default_rng(2)
    along = np.array([[0.0, 0.0], [30.0, 0.0], [60.0, 0.0], [90.0, 0.0]])
    truth = along + rng.uniform(0, 200, (FRAMES, 1, 2))
    off = rng.normal(0, 0.2, truth.shape)
    off[:, 2, 0] = rng.normal(0, 2.0, FRAMES)
    off[:, 3] += rng.normal(0, 4.0, (FRAMES, 2))
    labels = truth + rng.normal(0, 1.0, truth.shape)
    # It puts every keypoint elsewhere than this hand, always in the same way.
    moved, _ = denoised_positions(labels, truth + off + [1.5, -1.0], geometry(SCALE))
    error = off_mean_px(moved, truth, labels)
    assert error[:2].max() < 0.35  # px, where each click is off by one
    assert error[2, 1] < 0.35 < error[2, 0] < 1.0
    assert (error[3] < off_mean_px(labels, truth, labels)[3] + 0.06).all()
    # From an exact hand nothing is to be gained, and little is lost: what the network is off by where it is surest.
    exact, _ = denoised_positions(truth, truth + off, geometry(SCALE))
    assert off_mean_px(exact, truth, truth).max() < 0.25
    # Four frames tell nothing of either's error.
    few, _ = denoised_positions(labels[:4], truth[:4], geometry(SCALE[:4]))
    np.testing.assert_array_equal(few, labels[:4])


def test_outliers_keep_their_label_and_so_do_all_labels_of_a_keypoint_that_is_not_found() -> None:
    rng = np.random.default_rng(0)
    labels = rng.uniform(0, 100, (20, 1, 2))
    found = labels + rng.normal(1.0, 0.3, labels.shape)
    found[7, 0] = labels[7, 0] + 40
    labels[3, 0] = np.nan
    moved, _ = denoised_positions(labels, found, geometry(SCALE[:20], (0,)))
    np.testing.assert_array_equal(moved[7], labels[7])
    assert np.isnan(moved[3]).all()
    assert np.abs(moved - labels)[[0, 1, 2, 4, 5, 6]].max() > 0.1
    lost = rng.uniform(0, 100, labels.shape)
    np.testing.assert_array_equal(denoised_positions(labels, lost, geometry(SCALE[:20], (0,)))[0], labels)
    # However much its errors agree.
    agreed, _ = denoised_positions(labels, labels + 30.0, geometry(SCALE[:20], (0,)))
    np.testing.assert_allclose(agreed, labels, atol=1e-9)


def test_a_keypoint_at_rest_in_a_video_has_one_position_there() -> None:
    rng = np.random.default_rng(2)
    place = np.array([[50.0, 40.0]])
    labels = place + rng.normal(0, 1, (20, 1, 2))
    found = place + 0.5 * (labels - place)  # half of each error is known by heart
    found[10:], labels[10:] = found[10:] + 7.0, labels[10:] + 7.0
    labels[3, 0] += 40.0
    two = ["first"] * 10 + ["second"] * 10
    moved, _ = denoised_positions(labels, found, geometry(SCALE[:20], (0,), two))
    np.testing.assert_allclose(moved[3], labels[3])
    for rows in ([0, 1, 2, 4, 5, 6, 7, 8, 9], range(10, 20)):
        assert np.ptp(moved[list(rows)], axis=0).max() == 0.0
    assert np.linalg.norm(moved[0] - place) < 0.7
    assert np.linalg.norm(moved[10] - place - 7.0) < 0.7
    # Taken for one video it moved by 7 px, and each position is its own.
    assert np.ptp(denoised_positions(labels, found, geometry(SCALE[:20], (0,)))[0][10:], axis=0).min() > 0.5
    # What moves is left at its places, and so is what is seen too seldom to tell.
    moving = labels + np.linspace(0, 30, 20)[:, None, None]
    for count in (20, 4):
        own, _ = denoised_positions(moving[:count], moving[:count] + 1.0, geometry(SCALE[:count], (0,)))
        assert len(np.unique(own[:, 0, 0])) == count


def test_no_function_writes_into_its_arguments(bends) -> None:
    truth, scale = bends
    labels = truth + np.random.default_rng(0).normal(0, 0.5, truth.shape)
    given = [truth.copy(), labels.copy(), scale.copy()]
    denoised_positions(labels, truth, geometry(scale))
    for before, after in zip(given, (truth, labels, scale), strict=True):
        np.testing.assert_array_equal(before, after)


def yielding_positions(yield_deg: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Arms (N, 4, 2) px whose clamp gives way as they bend, and their denoised positions.

    Labels have 1 px of noise, the network 0.2 px.
    """
    bend_deg = np.linspace(0, 150, FRAMES)
    truth = arms(bend_deg, SCALE)
    turn = np.radians(yield_deg * bend_deg / 150)
    rotation = np.stack([np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)], axis=1).reshape(-1, 2, 2)
    pivot = np.array([85.0, 100.0])
    truth = pivot + (truth - pivot) @ rotation
    rng = np.random.default_rng(seed)
    labels = truth + rng.normal(0, 1, truth.shape)
    return truth, denoised_positions(labels, truth + rng.normal(0, 0.2, truth.shape), geometry(SCALE))[0]


def base_deg(xy: np.ndarray) -> np.ndarray:
    """Direction (N,) of the fixed end, degrees."""
    return np.asarray(np.degrees(np.arctan2(*(xy[:, 1] - xy[:, 0]).T[::-1])))


@pytest.mark.parametrize("yield_deg", [8.0, -4.0])
def test_a_fixed_end_that_yields_is_not_put_at_its_median(yield_deg: float) -> None:
    """Its first point moves by less than a click is off, and goes with the second, which moves by more."""
    for seed in range(4):
        truth, positions = yielding_positions(yield_deg, seed)
        error_deg = base_deg(positions) - base_deg(truth)
        assert abs(np.polyfit(np.linspace(0, 1, FRAMES), error_deg, 1)[0]) < 0.15 * abs(yield_deg)
        assert len(np.unique(positions[:, 0], axis=0)) == FRAMES


def test_a_fixed_end_that_is_held_is_put_at_its_median_whatever_the_noise() -> None:
    for seed in range(30):
        _, positions = yielding_positions(0.0, seed)
        assert len(np.unique(positions[:, 0], axis=0)) == len(np.unique(positions[:, 1], axis=0)) == 1
