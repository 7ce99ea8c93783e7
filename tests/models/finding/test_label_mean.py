"""The labels' mean comes back whatever the bend, and one bad label does not move it."""

from __future__ import annotations

import numpy as np
import pytest

from bendtrack.models.finding.label_mean import label_offset, with_offset
from bendtrack.models.finding.regions import patch_directions

PARTNER = (1, 0, 3, 2)


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
    scale = np.where(np.arange(30) % 3, 1.2, 0.6)
    return arms(np.linspace(-20, 220, 30), scale), scale


def shifted(truth: np.ndarray, along_px: float, across_px: float, scale: np.ndarray) -> np.ndarray:
    """The tip's points moved in its own axes, by hand: along the end vector, and to its right on the screen."""
    moved = truth.copy()
    vector = truth[:, 3] - truth[:, 2]
    unit = vector / np.linalg.norm(vector, axis=1)[:, None]
    right = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    for k in (2, 3):
        moved[:, k] += (along_px * unit + across_px * right) / scale[:, None]
    return moved


def test_an_offset_that_turns_with_the_body_is_found_and_undone(bends) -> None:
    truth, scale = bends
    found = shifted(truth, 0.3, -0.5, scale)
    offset = label_offset(found, truth, PARTNER, scale)
    np.testing.assert_allclose(offset, [[0, 0], [0, 0], [-0.3, 0.5], [-0.3, 0.5]], atol=1e-9)
    np.testing.assert_allclose(with_offset(found, offset, PARTNER, scale), truth, atol=1e-9)
    for i in (0, 1, 17):
        one = with_offset(found[i : i + 1], offset, PARTNER, float(scale[i]))
        np.testing.assert_allclose(one, truth[i : i + 1], atol=1e-9)


def test_after_it_the_labels_mean_is_met_also_when_they_are_noisy(bends) -> None:
    truth, scale = bends
    labels = truth + np.random.default_rng(0).normal(0, 0.5, truth.shape)
    found = shifted(truth, 0.3, -0.5, scale)
    offset = label_offset(found, labels, PARTNER, scale)
    left = label_offset(with_offset(found, offset, PARTNER, scale), labels, PARTNER, scale)
    # Not exactly: the moved ends point a little elsewhere.
    np.testing.assert_allclose(left, 0, atol=0.01)


def test_a_label_on_the_wrong_spot_and_missing_ones_change_nothing(bends) -> None:
    truth, scale = bends
    labels = truth + np.random.default_rng(1).normal(0, 0.5, truth.shape)
    labels[:, 0] = np.nan
    labels[4, 3] = np.nan
    before = label_offset(truth, labels, PARTNER, scale)
    assert before[0].tolist() == [0, 0]
    labels[4, 3] = truth[4, 3] + 80
    np.testing.assert_allclose(label_offset(truth, labels, PARTNER, scale), before)


def test_directions_of_both_of_a_pair_are_the_same_and_nan_gives_none() -> None:
    xy = np.array([[[0.0, 0.0], [0.0, 5.0], [3.0, 3.0], [np.nan, np.nan]]])
    np.testing.assert_allclose(patch_directions(xy, PARTNER), [[np.pi / 2, np.pi / 2, 0, 0]])
