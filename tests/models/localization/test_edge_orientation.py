"""Which way an end points, from pictures drawn with known sides."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.localization.edge_orientation import orientation_from_edges

SIDE, LENGTH = 128, 60


def end(
    turn_deg: float, *, taper_deg: float = 0.0, seed: int = 0, covered: int = 0, scale: int = 8
) -> np.ndarray:
    """An end with sides 50 px apart, as its picture shows it: before blotches, noisy, drawn without steps.

    covered : -1 hides the side above behind a board that lies across, +1 that below
    """
    rng = np.random.default_rng(seed)
    blotches = rng.uniform(60, 140, (8, 8, 3)).astype(np.float32)
    picture = cv2.resize(blotches, (SIDE * scale, SIDE * scale), interpolation=cv2.INTER_CUBIC)
    half, taper = 25.0, np.tan(np.radians(taper_deg))
    x = np.array([-80.0, 33.0])
    corners = np.array(
        [*zip(x, -half + x * taper, strict=True), *zip(x[::-1], half - x[::-1] * taper, strict=True)]
    )
    turn = np.radians(turn_deg)
    corners = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    at = np.rint((corners + (SIDE - 1) / 2 + 0.5) * scale - 0.5).astype(int)
    cv2.fillPoly(picture, [at], (190, 200, 205))
    if covered:
        lean = 45 * np.tan(np.radians(30.0))
        board = np.array([[-64, -18 - lean], [64, -18 + lean], [64, -99], [-64, -99]]) * (1, -covered)
        at = np.rint((board + (SIDE - 1) / 2 + 0.5) * scale - 0.5).astype(int)
        cv2.fillPoly(picture, [at], (40, 60, 90))
    small = cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.clip(small + rng.normal(0, 4, small.shape), 0, 255).astype(np.uint8)


def seen_deg(turn_deg: float, frames: int = 12, **looks) -> float:
    return float(
        np.degrees(
            orientation_from_edges([end(turn_deg, seed=seed, **looks) for seed in range(frames)], LENGTH)
        )
    )


@pytest.mark.parametrize("turn_deg", [-4.0, -1.5, 0.0, 2.0, 5.0])
def test_an_end_points_along_its_sides(turn_deg):
    # A part of the network's direction is always believed.
    assert seen_deg(turn_deg) == pytest.approx(turn_deg, abs=0.1 + 0.15 * abs(turn_deg))


def test_an_end_that_tapers_points_along_the_line_halfway_between_its_sides():
    assert seen_deg(2.0, taper_deg=3.0) == pytest.approx(2.0, abs=0.5)


def test_one_side_is_believed_less_than_two():
    both, above, below = seen_deg(3.0), seen_deg(3.0, covered=1), seen_deg(3.0, covered=-1)
    assert 1.0 < above < both - 0.2
    assert 1.0 < below < both - 0.2


def test_one_side_alone_is_taken_to_taper_as_ends_usually_do():
    above, below = (seen_deg(3.0, taper_deg=0.8, covered=side) for side in (1, -1))
    assert above == pytest.approx(below, abs=0.3)


def test_the_edge_of_something_else_that_crosses_an_end_says_nothing():
    assert abs(seen_deg(20.0)) < 0.7


@pytest.mark.parametrize("level", [0, 128])
def test_pictures_without_sides_say_nothing(level):
    assert orientation_from_edges([np.full((SIDE, SIDE, 3), level, np.uint8)] * 3, LENGTH) == pytest.approx(
        0, abs=0.005
    )


@pytest.mark.parametrize("length_px", [0.5, 2.0, 4.0])
def test_an_end_of_a_few_px_has_no_sides(length_px):
    assert orientation_from_edges([end(5.0)], length_px) == 0


@pytest.mark.parametrize("turn_deg", [5.0, 7.0])
def test_sides_that_do_not_fit_each_other_are_believed_less(turn_deg):
    """A board's edge below a level end, such as the jaw that holds it."""
    pictures = [end(0.0, seed=seed) for seed in range(12)]
    for picture in pictures:
        lean = 64 * np.tan(np.radians(turn_deg))
        board = np.array([[-64, 40 - lean], [64, 40 + lean], [64, 99], [-64, 99]]) + (SIDE - 1) / 2
        cv2.fillPoly(picture, [np.rint(board * 16).astype(int)], (250, 250, 250), cv2.LINE_AA, 4)
    assert abs(np.degrees(orientation_from_edges(pictures, LENGTH))) < 0.4 * turn_deg


@pytest.mark.parametrize("half_px", [56, 60, 61, 62, 64, 70])
def test_sides_at_the_pictures_border_say_little_or_the_truth(half_px):
    picture = np.full((8 * SIDE, 8 * SIDE, 3), 90, np.uint8)
    lean = 64 * np.tan(np.radians(3.0))
    corners = np.array(
        [[-64, -half_px - lean], [64, -half_px + lean], [64, half_px + lean], [-64, half_px - lean]]
    )
    at = np.rint((corners + (SIDE - 1) / 2 + 0.5) * 8 - 0.5).astype(int)
    cv2.fillPoly(picture, [at], (190, 200, 205))
    picture = cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    assert -0.3 < np.degrees(orientation_from_edges([picture], LENGTH)) < 3.3
