"""Skeleton assembly: the candidates that form a plausible chain, not the highest peaks."""

from __future__ import annotations

import numpy as np
import pytest

from bendtrack.models.localization.chain_assembly import assemble_chain, likeliest_points

BODY_PX = 240.0
FIXED_XY = np.array([100.0, 300.0])


def arcs(turns_deg: np.ndarray) -> np.ndarray:
    """Nine points (N, 9, 2) px, evenly along arcs of 240 px from the fixed end."""
    s = np.linspace(0, 1, 2001)
    heading = np.radians(turns_deg)[:, None] * s
    step = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * BODY_PX / 2000
    xy = FIXED_XY + np.concatenate(
        [np.zeros((len(turns_deg), 1, 2)), np.cumsum(step, axis=1)[:, :-1]], axis=1
    )
    return xy[:, ::250]


TRUTH = arcs(np.linspace(-60, 270, 40))


def candidates(*hypotheses: tuple[np.ndarray, float]) -> tuple[np.ndarray, np.ndarray]:
    """Candidate positions (N, 9, M, 2) and likelihoods (N, 9, M) from M hypotheses."""
    xy = np.stack([np.broadcast_to(position, TRUTH.shape) for position, _ in hypotheses], axis=2)
    likelihood = np.stack([np.full(TRUTH.shape[:2], value) for _, value in hypotheses], axis=2)
    return xy, likelihood


def test_a_plausible_chain_of_high_peaks_is_kept() -> None:
    xy, likelihood = assemble_chain(
        *candidates((TRUTH, 0.9), (np.array([20.0, 20.0]), 0.4)), FIXED_XY, BODY_PX
    )
    np.testing.assert_array_equal(xy, TRUTH)
    np.testing.assert_array_equal(likelihood, 0.9)


def test_a_tip_far_away_is_replaced_by_the_candidate_that_fits() -> None:
    wrong = TRUTH.copy()
    wrong[:, 7:] = (400.0, 40.0), (420.0, 40.0)
    xy, likelihood = assemble_chain(*candidates((wrong, 0.9), (TRUTH, 0.2)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)
    np.testing.assert_array_equal(likelihood[:, 7:], 0.2)


def test_a_reversed_chain_is_reversed_back() -> None:
    xy, _ = assemble_chain(*candidates((TRUTH[:, ::-1], 0.9), (TRUTH, 0.01)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_a_chain_does_not_turn_back_on_itself() -> None:
    """A network that takes both ends for the fixed one proposes a chain that goes out and comes back."""
    back = TRUTH.copy()
    back[:, 5:] = TRUTH[:, 3::-1]
    xy, _ = assemble_chain(*candidates((back, 0.9), (TRUTH, 0.3)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_a_chain_away_from_the_fixed_end_is_not_taken() -> None:
    other = TRUTH + np.array([0.0, -400.0])
    xy, _ = assemble_chain(*candidates((other, 0.9), (TRUTH, 0.3)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_a_single_candidate_is_taken_with_its_likelihood() -> None:
    anywhere = np.random.default_rng(0).uniform(0, 400, TRUTH.shape)
    xy, likelihood = assemble_chain(*candidates((anywhere, 0.1)), FIXED_XY, BODY_PX)
    assert np.isfinite(xy).all()
    np.testing.assert_array_equal(likelihood, 0.1)


@pytest.mark.parametrize("is_reversed", [False, True])
def test_what_moves_is_the_actuator_and_not_what_looks_more_like_one(is_reversed: bool) -> None:
    """A tube with higher peaks that rests, and a body whose first third hardly moves."""
    body = TRUTH[:, ::-1] if is_reversed else TRUTH
    tube = np.broadcast_to(TRUTH[0] + np.array([30.0, 260.0]), TRUTH.shape)
    xy, likelihood = candidates((tube, 0.9), (body, 0.4))
    moves = np.linspace(0, 1, 9) > 0.3
    motion = np.zeros(likelihood.shape)
    motion[:, :, 1] = moves[::-1] if is_reversed else moves
    resting, _ = assemble_chain(xy, likelihood, None, BODY_PX)
    np.testing.assert_array_equal(resting, tube)
    found, peaks = assemble_chain(xy, likelihood, None, BODY_PX, motion)
    np.testing.assert_array_equal(found, TRUTH)
    np.testing.assert_allclose(peaks[:, 4:], 0.4)
    single, peaks = likeliest_points(xy, likelihood, motion)
    last = slice(0, 4) if is_reversed else slice(5, 9)
    np.testing.assert_array_equal(single[:, last], body[:, last])
