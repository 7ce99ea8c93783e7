"""Bending angles against fingers drawn independently, by symmetry, and against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bendtrack.tracker.angle import (
    DEFINITIONS,
    AngleDefinition,
    bending_angle,
    default_points,
    end_vector_px,
    label_noise_floor_deg,
    sign_from_labels,
)
from bendtrack.tracker.errors import AngleError
from bendtrack.tracker.types import Correlation

BENDS_DEG = np.array(
    [-220.0, -180, -170, -90, -10, -0.01, 0, 1e-6, 0.01, 10, 45, 90, 135, 179, 180, 181, 208, 220]
)
FINGER = ("base_1", "base_2", "mid", "tip_1", "tip_2")


def finger(bend_deg: np.ndarray, heading_deg: float = 0.0) -> np.ndarray:
    """A clamped finger (T, 5, 2): straight clamp, arc of 200 px, straight tip. Made without the angle module.

    It leaves the clamp along `heading_deg`, bends towards +y for a positive bend. Integrated in small steps,
    so that no formula of a circle is shared with the code under test.
    """
    steps = 4000
    out = []
    for bend in np.radians(bend_deg):
        tangent = np.radians(heading_deg) + bend * (np.arange(steps) + 0.5) / steps
        path = 200 / steps * np.cumsum(np.stack([np.cos(tangent), np.sin(tangent)], axis=1), axis=0)
        base = np.array([np.cos(np.radians(heading_deg)), np.sin(np.radians(heading_deg))])
        end = np.radians(heading_deg) + bend
        tip = path[-1] + 40 * np.array([np.cos(end), np.sin(end)])
        out.append(
            np.array([-40 * base, [0.0, 0.0], path[steps // 2 - 1], path[-1], tip]) + np.array([320.0, 240.0])
        )
    return np.array(out)


def arc_points(bend_deg: np.ndarray, count: int) -> np.ndarray:
    """`count` points evenly along an arc of 200 px (T, count, 2), integrated in small steps."""
    every = 6000 // (count - 1)
    steps = every * (count - 1)
    tangent = np.radians(bend_deg)[:, None] * (np.arange(steps) + 0.5) / steps
    path = 200 / steps * np.cumsum(np.stack([np.cos(tangent), np.sin(tangent)], axis=-1), axis=1)
    start = np.zeros((len(bend_deg), 1, 2))
    return np.concatenate([start, path[:, every - 1 :: every]], axis=1) + np.array([100.0, 300.0])


def names(count: int) -> tuple[str, ...]:
    return tuple(f"p{i}" for i in range(count))


def angle_of(xy: np.ndarray, keypoints: tuple[str, ...], name: str, sign: int = 1) -> np.ndarray:
    return bending_angle(xy, keypoints, AngleDefinition(name, default_points(name, keypoints), sign))[0]


# --- stories ---------------------------------------------------------------------------------------------


def test_two_vector_follows_a_finger_past_180() -> None:
    np.testing.assert_allclose(angle_of(finger(BENDS_DEG), FINGER, "two-vector"), BENDS_DEG, atol=1e-6)


@pytest.mark.parametrize("heading_deg", [0.0, 37.0, 90.0, 180.0, -135.0])
def test_two_vector_does_not_care_where_the_base_points(heading_deg: float) -> None:
    xy = finger(BENDS_DEG, heading_deg)
    np.testing.assert_allclose(angle_of(xy, FINGER, "two-vector"), BENDS_DEG, atol=1e-6)


def test_two_vector_of_four_points_is_the_papers_angle() -> None:
    four = [0, 1, 3, 4]
    angle = angle_of(finger(BENDS_DEG)[:, four], tuple(FINGER[i] for i in four), "two-vector")
    np.testing.assert_allclose(angle, BENDS_DEG, atol=1e-6)


def test_a_finger_curling_down_on_the_screen_is_positive_and_the_sign_multiplies() -> None:
    xy = np.array([[[0.0, 0.0], [10.0, 0.0], [20.0, 10.0], [20.0, 20.0]]])
    assert angle_of(xy, names(4), "two-vector")[0] == pytest.approx(90.0)
    assert angle_of(xy, names(4), "two-vector", sign=-1)[0] == pytest.approx(-90.0)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_a_turn_of_exactly_180_is_positive(mirror: float) -> None:
    folded = np.array([[[0.0, 0.0], [10.0, 0.0], [5.0, mirror * 0.0]]])
    assert angle_of(folded, names(3), "three-point")[0] == 180.0
    folded_to_the_left = np.array([[[10.0, 0.0], [0.0, 0.0], [5.0, mirror * 0.0]]])
    assert angle_of(folded_to_the_left, names(3), "three-point")[0] == 180.0
    u_shape = np.array([[[0.0, 0.0], [10.0, 0.0], [10.0, 10.0 * mirror], [0.0, 10.0 * mirror]]])
    assert angle_of(u_shape, names(4), "two-vector")[0] == pytest.approx(180.0 * mirror)


def test_two_vector_is_continuous_through_180() -> None:
    bend = np.linspace(170, 190, 201)
    step = np.diff(angle_of(finger(bend), FINGER, "two-vector"))
    np.testing.assert_allclose(step, 0.1, atol=1e-6)


def test_three_point_is_the_turn_away_from_straight() -> None:
    turn = np.radians(np.array([0.0, 30.0, -120.0, 179.0]))
    xy = np.stack(
        [np.tile([-10.0, 0.0], (4, 1)), np.zeros((4, 2)), 7 * np.stack([np.cos(turn), np.sin(turn)], 1)], 1
    )
    np.testing.assert_allclose(angle_of(xy, names(3), "three-point"), np.degrees(turn), atol=1e-9)


def test_chord_is_exact_for_an_arc_that_leaves_the_clamp_smoothly() -> None:
    base_and_arc = finger(BENDS_DEG)[:, [0, 1, 3]]
    np.testing.assert_allclose(angle_of(base_and_arc, names(3), "chord"), BENDS_DEG, atol=1e-5)


@pytest.mark.parametrize("count", [3, 4, 6, 11])
def test_arc_fit_of_an_arc_is_its_whole_turn(count: int) -> None:
    np.testing.assert_allclose(
        angle_of(arc_points(BENDS_DEG, count), names(count), "arc-fit"), BENDS_DEG, atol=1e-4
    )


@pytest.mark.parametrize("places", [(0, 2, 38, 40), (0, 4, 40), (0, 36, 40)])
def test_arc_fit_knows_the_way_round_when_neighbours_are_half_a_circle_apart(places: tuple[int, ...]) -> None:
    xy = arc_points(BENDS_DEG, 41)[:, list(places)]
    np.testing.assert_allclose(angle_of(xy, names(len(places)), "arc-fit"), BENDS_DEG, atol=1e-3)


def test_arc_fit_of_a_straight_finger_is_zero_and_smooth_around_it() -> None:
    straight = np.stack([np.linspace(0, 200, 6), np.linspace(50, 80, 6)], axis=1)[None]
    angle, sd, _ = bending_angle(
        straight, names(6), AngleDefinition("arc-fit", names(6)), np.tile(np.eye(2), (1, 6, 1, 1))
    )
    assert abs(angle[0]) < 1e-9
    assert 0 < sd[0] < 5


def test_arc_fit_lets_one_misplaced_point_pull_less_than_least_squares_would() -> None:
    xy = arc_points(np.array([60.0]), 9)
    moved = xy.copy()
    moved[0, 2] += [25.0, -40.0]
    # Plain least squares, by brute force over centre and radius, independent of the code under test.
    from scipy.optimize import least_squares

    def distances(p: np.ndarray) -> np.ndarray:
        return np.hypot(*(moved[0] - p[:2]).T) - p[2]

    plain = least_squares(distances, [*(xy[0, 4] + [0, 190.0]), 190.0], x_scale="jac").x
    heading = np.unwrap(np.arctan2(*(moved[0, [0, 4, 8]] - plain[:2]).T[::-1]))
    plain_error = abs(np.degrees(heading[-1] - heading[0]) - 60.0)
    robust_error = abs(angle_of(moved, names(9), "arc-fit")[0] - 60.0)
    assert robust_error < 0.5 * plain_error


# --- symmetries ------------------------------------------------------------------------------------------

chains = st.builds(
    lambda turns, lengths: (np.array(turns), np.array(lengths)),
    st.lists(st.floats(-100, 100), min_size=3, max_size=3),
    st.lists(st.floats(15, 80), min_size=4, max_size=4),
)


def chain_xy(turns_deg: np.ndarray, lengths_px: np.ndarray) -> np.ndarray:
    heading = np.radians(np.array([0.0, *np.cumsum(turns_deg)]))
    steps = lengths_px[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[None]


def smooth_xy(bend_deg: float, wiggle: np.ndarray) -> np.ndarray:
    """An arc of five points, each off by up to a few px: what an arc is fitted to in practice."""
    return arc_points(np.array([bend_deg]), 5) + wiggle.reshape(1, 5, 2)


wiggles = st.lists(st.floats(-3, 3), min_size=10, max_size=10).map(np.array)


def similar(xy: np.ndarray, rotation_deg: float, scale: float, shift: tuple[float, float]) -> np.ndarray:
    c, s = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    return scale * xy @ np.array([[c, s], [-s, c]]) + np.array(shift)


@given(chain=chains)
def test_two_vector_is_the_sum_of_the_turns(chain: tuple[np.ndarray, np.ndarray]) -> None:
    assert angle_of(chain_xy(*chain), names(5), "two-vector")[0] == pytest.approx(chain[0].sum(), abs=1e-6)


@pytest.mark.parametrize("name", DEFINITIONS)
@given(
    bend_deg=st.floats(-220, 220),
    wiggle=wiggles,
    rotation_deg=st.floats(-180, 180),
    scale=st.floats(0.1, 20),
    shift=st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000)),
)
def test_translation_rotation_and_scale_change_nothing_and_a_mirror_flips_the_sign(
    name: str,
    bend_deg: float,
    wiggle: np.ndarray,
    rotation_deg: float,
    scale: float,
    shift: tuple[float, float],
) -> None:
    xy = smooth_xy(bend_deg, wiggle)
    angle = angle_of(xy, names(5), name)
    np.testing.assert_allclose(
        angle_of(similar(xy, rotation_deg, scale, shift), names(5), name), angle, atol=1e-4
    )
    np.testing.assert_allclose(angle_of(xy * [-1, 1], names(5), name), -angle, atol=1e-4)


@pytest.mark.parametrize("name", ["two-vector", "three-point", "arc-fit"])
@given(bend_deg=st.floats(-220, 220), wiggle=wiggles)
def test_reading_the_chain_from_tip_to_base_flips_the_sign(
    name: str, bend_deg: float, wiggle: np.ndarray
) -> None:
    xy = smooth_xy(bend_deg, wiggle)
    np.testing.assert_allclose(
        angle_of(xy[:, ::-1], names(5), name), -angle_of(xy, names(5), name), atol=1e-4
    )


@pytest.mark.parametrize("name", DEFINITIONS)
def test_frames_do_not_influence_each_other(name: str) -> None:
    xy = finger(BENDS_DEG)
    whole = angle_of(xy, FINGER, name)
    np.testing.assert_allclose(angle_of(xy[::-1], FINGER, name)[::-1], whole, atol=1e-9)
    np.testing.assert_allclose([angle_of(frame[None], FINGER, name)[0] for frame in xy], whole, atol=1e-9)


# --- missing and degenerate ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DEFINITIONS)
def test_nan_in_gives_nan_out_for_that_frame_only(name: str) -> None:
    xy = finger(np.array([10.0, 20.0, 30.0]))
    xy[1, 0, 1] = np.nan
    definition = AngleDefinition(name, default_points(name, FINGER))
    angle, sd, coincident = bending_angle(xy, FINGER, definition, np.tile(np.eye(2), (3, 5, 1, 1)))
    assert np.isfinite(angle).tolist() == [True, False, True]
    assert np.isfinite(sd).tolist() == [True, False, True]
    assert not coincident.any()


@pytest.mark.parametrize("name", DEFINITIONS)
def test_coincident_neighbours_give_nan_and_say_so(name: str) -> None:
    xy = finger(np.array([10.0, 20.0]))
    xy[0, :3] = xy[0, 0]  # whichever of the first three the definition uses
    angle, _, coincident = bending_angle(xy, FINGER, AngleDefinition(name, default_points(name, FINGER)))
    assert coincident.tolist() == [True, False]
    assert np.isnan(angle[0])
    assert np.isfinite(angle[1])


def test_a_point_outside_the_chain_may_be_missing() -> None:
    xy = finger(np.array([30.0]))
    xy[0, 2] = np.nan
    definition = AngleDefinition("two-vector", ("base_1", "base_2", "tip_1", "tip_2"))
    assert bending_angle(xy, FINGER, definition)[0][0] == pytest.approx(30.0)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_no_frames_no_angles(name: str) -> None:
    definition = AngleDefinition(name, default_points(name, FINGER))
    angle, sd, coincident = bending_angle(np.empty((0, 5, 2)), FINGER, definition, np.empty((0, 5, 2, 2)))
    assert angle.shape == sd.shape == coincident.shape == (0,)


# --- uncertainty -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DEFINITIONS)
def test_sd_agrees_with_monte_carlo(name: str) -> None:
    rng = np.random.default_rng(7)
    bends = np.array([-150.0, 0.0, 40.0, 120.0, 208.0])
    clean = finger(bends) if name != "arc-fit" else arc_points(bends, 5)
    # Correlated at the ends too: there a point moves the angle along its tangent and across it.
    tilted = np.array([[0.5, 0.35], [0.35, 0.4]])
    spread = np.stack([tilted, np.diag([0.1, 0.6]), tilted * [[1, -1], [-1, 1]], np.eye(2), tilted])
    covariance = np.tile(spread[:, :, :], (len(bends), 1, 1, 1)) * 0.3
    definition = AngleDefinition(name, default_points(name, FINGER))
    _, sd, _ = bending_angle(clean, FINGER, definition, covariance)

    draws = 4000
    noise = np.einsum(
        "kij,dtkj->dtki", np.linalg.cholesky(0.3 * spread), rng.normal(size=(draws, *clean.shape))
    )
    angles = bending_angle((clean + noise).reshape(-1, 5, 2), FINGER, definition)[0].reshape(draws, -1)
    np.testing.assert_allclose(sd, angles.std(axis=0), rtol=0.05)


def test_sd_of_the_papers_angle_is_the_floor_formula() -> None:
    xy = finger(np.array([0.0, 90.0, 200.0]))
    definition = AngleDefinition("two-vector", FINGER)
    _, sd, _ = bending_angle(xy, FINGER, definition, np.tile(np.eye(2), (3, 5, 1, 1)))
    np.testing.assert_allclose(sd, label_noise_floor_deg(1.0, 1, 40.0), rtol=1e-9)


@pytest.mark.parametrize("name", DEFINITIONS)
def test_sd_of_correlated_points_agrees_with_monte_carlo(name: str) -> None:
    """Both points of the tip err together: their common shift turns nothing."""
    rng = np.random.default_rng(2)
    xy = np.array([[[0.0, 0.0], [50.0, 3.0], [120.0, 60.0], [130.0, 110.0]]])
    keypoints = names(4)
    points = default_points(name, keypoints)
    definition = AngleDefinition(name, points)
    sd, coefficient = 0.5, 0.9
    covariance = np.broadcast_to(np.eye(2) * sd**2, (1, 4, 2, 2))
    correlations = [Correlation(keypoints[2], keypoints[3], coefficient)]
    stated = bending_angle(xy, keypoints, definition, covariance, correlations)[1][0]
    common, own = rng.normal(0, sd, (2, 40_000, 1, 2)), rng.normal(0, sd, (40_000, 4, 2))
    error = own.copy()
    error[:, 2:] = np.sqrt(coefficient) * common[0] + np.sqrt(1 - coefficient) * own[:, 2:]
    drawn = bending_angle(xy + error, keypoints, definition)[0]
    assert stated == pytest.approx(drawn.std(), rel=0.03)
    # A pair that is not in the chain changes nothing.
    other = [Correlation(keypoints[3], "elsewhere", 0.9)]
    alone = bending_angle(xy, keypoints, definition, covariance)[1]
    assert bending_angle(xy, keypoints, definition, covariance, other)[1] == alone


def test_no_covariance_no_sd() -> None:
    _, sd, _ = bending_angle(finger(np.array([5.0])), FINGER, AngleDefinition("two-vector", FINGER))
    assert np.isnan(sd).all()


# --- label noise floor -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("length_px", "floor_deg"), [(60, 0.35), (40, 0.52), (25, 0.84)])
def test_label_noise_floor_of_the_design(length_px: float, floor_deg: float) -> None:
    assert label_noise_floor_deg(1.0, 30, length_px) == pytest.approx(floor_deg, abs=0.005)


def test_end_vector_is_the_shorter_one_and_ignores_missing_frames() -> None:
    xy = finger(np.array([0.0, 30.0, 60.0]))
    xy[:, 4] = xy[:, 3] + 0.5 * (xy[:, 4] - xy[:, 3])
    xy[0, 4] = np.nan
    assert end_vector_px(xy, FINGER, AngleDefinition("two-vector", FINGER)) == pytest.approx(20.0)
    assert np.isnan(end_vector_px(xy * np.nan, FINGER, AngleDefinition("two-vector", FINGER)))


# --- sign and definitions --------------------------------------------------------------------------------


def test_sign_from_labels_makes_the_pressurised_direction_positive() -> None:
    definition = AngleDefinition("two-vector", FINGER)
    bends = np.array([12.0, 8, 5, -20, -60, -100, -150, -208])  # rests slightly bent the other way
    assert sign_from_labels(finger(bends), FINGER, definition) == -1
    assert sign_from_labels(finger(-bends), FINGER, definition) == 1


def test_sign_from_labels_is_not_decided_by_one_frame_labelled_backwards() -> None:
    bends = np.array([*np.linspace(0, 150, 29), -200.0])
    assert sign_from_labels(finger(bends), FINGER, AngleDefinition("two-vector", FINGER)) == 1


def test_sign_from_labels_needs_a_complete_frame() -> None:
    xy = finger(np.array([10.0]))
    xy[0, 4] = np.nan
    with pytest.raises(AngleError, match="got none among 1"):
        sign_from_labels(xy, FINGER, AngleDefinition("two-vector", FINGER))


@pytest.mark.parametrize(
    ("name", "points", "sign", "message"),
    [
        (
            "two-vectors",
            FINGER,
            1,
            "expected one of two-vector, three-point, chord, arc-fit, got 'two-vectors'",
        ),
        ("two-vector", ("a", "b", "c"), 1, "at least 4 points, got 3"),
        ("three-point", ("a", "b", "c", "d"), 1, "exactly 3 points, got 4"),
        ("chord", ("a", "b"), 1, "at least 3 points, got 2"),
        ("arc-fit", ("a", "b", "a"), 1, "distinct"),
        ("chord", ("a", "b", "c"), 0, r"\+1 or -1, got 0"),
    ],
)
def test_a_definition_that_cannot_be_says_why(
    name: str, points: tuple[str, ...], sign: int, message: str
) -> None:
    with pytest.raises(AngleError, match=message):
        AngleDefinition(name, points, sign)


def test_points_must_be_keypoints() -> None:
    with pytest.raises(AngleError, match=r"among the keypoints p0, p1, p2, got tip"):
        bending_angle(np.zeros((1, 3, 2)), names(3), AngleDefinition("chord", ("p0", "p1", "tip")))


def test_default_points() -> None:
    assert default_points("two-vector", FINGER) == FINGER
    assert default_points("arc-fit", FINGER[:3]) == FINGER[:3]
    assert default_points("three-point", FINGER) == ("base_1", "mid", "tip_2")
    assert default_points("chord", FINGER) == ("base_1", "base_2", "tip_2")
    with pytest.raises(AngleError, match="at least 4 keypoints, got 3"):
        default_points("two-vector", FINGER[:3])
