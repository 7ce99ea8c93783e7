"""The direction of an end from its edges, on crops drawn with known edges."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.localization.edge_orientation import orientation_from_edges

SIDE, LENGTH = 128, 60


def end(
    turn_deg: float, *, taper_deg: float = 0.0, seed: int = 0, covered: int = 0, scale: int = 8
) -> np.ndarray:
    """A noisy crop of an end with edges 50 px apart before a blotched background.

    Parameters
    ----------
    covered : int
        -1 hides the upper edge behind a board, +1 the lower one.
    """
    rng = np.random.default_rng(seed)
    blotches = rng.uniform(60, 140, (8, 8, 3)).astype(np.float32)
    image = cv2.resize(blotches, (SIDE * scale, SIDE * scale), interpolation=cv2.INTER_CUBIC)
    half, taper = 25.0, np.tan(np.radians(taper_deg))
    x = np.array([-80.0, 33.0])
    corners = np.array(
        [*zip(x, -half + x * taper, strict=True), *zip(x[::-1], half - x[::-1] * taper, strict=True)]
    )
    turn = np.radians(turn_deg)
    corners = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    at = np.rint((corners + (SIDE - 1) / 2 + 0.5) * scale - 0.5).astype(int)
    cv2.fillPoly(image, [at], (190, 200, 205))
    if covered:
        lean = 45 * np.tan(np.radians(30.0))
        board = np.array([[-64, -18 - lean], [64, -18 + lean], [64, -99], [-64, -99]]) * (1, -covered)
        at = np.rint((board + (SIDE - 1) / 2 + 0.5) * scale - 0.5).astype(int)
        cv2.fillPoly(image, [at], (40, 60, 90))
    small = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    return np.clip(small + rng.normal(0, 4, small.shape), 0, 255).astype(np.uint8)


def estimated_deg(turn_deg: float, frames: int = 12, **options) -> float:
    return float(
        np.degrees(
            orientation_from_edges([end(turn_deg, seed=seed, **options) for seed in range(frames)], LENGTH)
        )
    )


@pytest.mark.parametrize("turn_deg", [-4.0, -1.5, 0.0, 2.0, 5.0])
def test_the_direction_follows_parallel_edges(turn_deg):
    # The estimate is shrunk toward the network's direction.
    assert estimated_deg(turn_deg) == pytest.approx(turn_deg, abs=0.1 + 0.15 * abs(turn_deg))


def test_the_direction_of_a_tapering_end_is_the_bisector():
    assert estimated_deg(2.0, taper_deg=3.0) == pytest.approx(2.0, abs=0.5)


def test_one_edge_counts_less_than_two():
    both, upper, lower = estimated_deg(3.0), estimated_deg(3.0, covered=1), estimated_deg(3.0, covered=-1)
    assert 1.0 < upper < both - 0.2
    assert 1.0 < lower < both - 0.2


def test_one_edge_alone_is_corrected_by_the_usual_taper():
    upper, lower = (estimated_deg(3.0, taper_deg=0.8, covered=side) for side in (1, -1))
    assert upper == pytest.approx(lower, abs=0.3)


def test_an_edge_that_crosses_the_end_is_ignored():
    assert abs(estimated_deg(20.0)) < 0.7


@pytest.mark.parametrize("level", [0, 128])
def test_images_without_edges_give_no_turn(level):
    assert orientation_from_edges([np.full((SIDE, SIDE, 3), level, np.uint8)] * 3, LENGTH) == pytest.approx(
        0, abs=0.005
    )


@pytest.mark.parametrize("length_px", [0.5, 2.0, 4.0])
def test_an_end_of_a_few_px_gives_no_turn(length_px):
    assert orientation_from_edges([end(5.0)], length_px) == 0


@pytest.mark.parametrize("turn_deg", [5.0, 7.0])
def test_edges_that_disagree_count_less(turn_deg):
    """A board's edge below a level end, such as a clamp's jaw."""
    images = [end(0.0, seed=seed) for seed in range(12)]
    for image in images:
        lean = 64 * np.tan(np.radians(turn_deg))
        board = np.array([[-64, 40 - lean], [64, 40 + lean], [64, 99], [-64, 99]]) + (SIDE - 1) / 2
        cv2.fillPoly(image, [np.rint(board * 16).astype(int)], (250, 250, 250), cv2.LINE_AA, 4)
    assert abs(np.degrees(orientation_from_edges(images, LENGTH))) < 0.4 * turn_deg


@pytest.mark.parametrize("half_px", [56, 60, 61, 62, 64, 70])
def test_edges_at_the_crops_border_give_a_small_or_correct_turn(half_px):
    image = np.full((8 * SIDE, 8 * SIDE, 3), 90, np.uint8)
    lean = 64 * np.tan(np.radians(3.0))
    corners = np.array(
        [[-64, -half_px - lean], [64, -half_px + lean], [64, half_px + lean], [-64, half_px - lean]]
    )
    at = np.rint((corners + (SIDE - 1) / 2 + 0.5) * 8 - 0.5).astype(int)
    cv2.fillPoly(image, [at], (190, 200, 205))
    image = cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    assert -0.3 < np.degrees(orientation_from_edges([image], LENGTH)) < 3.3
