"""Which places make up one actuator: the chain that holds together, not the highest peaks."""

from __future__ import annotations

import numpy as np

from bendtrack.models.localization.chain_assembly import assemble_chain

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


def offers(*places: tuple[np.ndarray, float]) -> tuple[np.ndarray, np.ndarray]:
    """Places of all keypoints (N, 9, 2) with one likelihood each, as `assembled` takes them."""
    xy = np.stack([np.broadcast_to(place, TRUTH.shape) for place, _ in places], axis=2)
    likelihood = np.stack([np.full(TRUTH.shape[:2], value) for _, value in places], axis=2)
    return xy, likelihood


def test_a_body_whose_points_are_seen_is_left_as_it_is() -> None:
    xy, likelihood = assemble_chain(*offers((TRUTH, 0.9), (np.array([20.0, 20.0]), 0.4)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)
    np.testing.assert_array_equal(likelihood, 0.9)


def test_a_tip_seen_somewhere_else_is_taken_where_it_fits() -> None:
    wrong = TRUTH.copy()
    wrong[:, 7:] = (400.0, 40.0), (420.0, 40.0)
    xy, likelihood = assemble_chain(*offers((wrong, 0.9), (TRUTH, 0.2)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)
    np.testing.assert_array_equal(likelihood[:, 7:], 0.2)


def test_a_body_found_from_the_wrong_end_is_turned_round() -> None:
    xy, _ = assemble_chain(*offers((TRUTH[:, ::-1], 0.9), (TRUTH, 0.01)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_a_chain_does_not_turn_back_on_itself() -> None:
    """Heads that take both ends for the fixed one would otherwise make a chain that goes out and comes back."""
    back = TRUTH.copy()
    back[:, 5:] = TRUTH[:, 3::-1]
    xy, _ = assemble_chain(*offers((back, 0.9), (TRUTH, 0.3)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_what_is_not_held_at_the_fixed_end_is_somebody_else() -> None:
    other = TRUTH + np.array([0.0, -400.0])
    xy, _ = assemble_chain(*offers((other, 0.9), (TRUTH, 0.3)), FIXED_XY, BODY_PX)
    np.testing.assert_array_equal(xy, TRUTH)


def test_where_nothing_else_is_offered_it_is_taken_for_what_it_is_worth() -> None:
    anywhere = np.random.default_rng(0).uniform(0, 400, TRUTH.shape)
    xy, likelihood = assemble_chain(*offers((anywhere, 0.1)), FIXED_XY, BODY_PX)
    assert np.isfinite(xy).all()
    np.testing.assert_array_equal(likelihood, 0.1)
