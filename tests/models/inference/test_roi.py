"""Region of interest, scales and reference keypoints from labels, whatever the camera's resolution."""

from __future__ import annotations

import numpy as np
import pytest

from bendtrack.models.inference.roi import (
    LOCATOR_BODY,
    LOCATOR_SIDE,
    MAX_MAGNIFICATION,
    RegionOfInterest,
    body_length_px,
    orientations,
    reference_distances,
    reference_keypoints,
    region_of_interest,
    regions_of_interest,
)


def sweep(scale: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Labels (12, 4, 2) of a 260 px body that bends from 0 to 200 degrees."""
    turn = np.deg2rad(np.linspace(0, 200, 12))
    directions = np.stack([0 * turn, turn / 2, turn], axis=1)
    steps = (
        np.stack([np.cos(directions), np.sin(directions)], axis=2) * np.array([60, 140, 60])[None, :, None]
    )
    start = np.broadcast_to([[150.0, 120.0]], (12, 1, 2))
    return (np.concatenate([start, start + np.cumsum(steps, axis=1)], axis=1) + shift) * scale


def test_the_region_holds_every_label_with_a_margin_inside_the_frame() -> None:
    xy = sweep()
    region = region_of_interest(xy, (640, 480))
    low, high = xy.reshape(-1, 2).min(axis=0), xy.reshape(-1, 2).max(axis=0)
    assert region.left < low[0] - 20
    assert region.top < low[1] - 20
    assert region.left + region.width > high[0] + 20
    assert region.left >= 0
    assert region.left + region.width <= 640
    assert region.top + region.height <= 480


def test_a_camera_of_four_times_the_resolution_gives_the_same_input() -> None:
    small, large = region_of_interest(sweep(1.5), (960, 720)), region_of_interest(sweep(6.0), (3840, 2880))
    assert large.locator_scale == pytest.approx(small.locator_scale / 4, rel=0.05)
    assert large.refiner_scale == pytest.approx(small.refiner_scale / 4, rel=0.05)
    assert max(large.locator_view(16).size_wh) <= LOCATOR_SIDE + 16


def test_a_small_body_in_a_large_region_keeps_its_least_input_size() -> None:
    rng = np.random.default_rng(0)
    body = np.array([[0, 0], [20, 8], [20, -8], [70, 0]], float)
    xy = rng.uniform(100, 400, (30, 1, 2)) + body
    region = region_of_interest(xy, (640, 480))
    assert body_length_px(xy) * region.locator_scale >= LOCATOR_BODY * 0.99
    assert region.refiner_scale <= MAX_MAGNIFICATION


def test_crops_are_never_cut_from_an_enlarged_frame() -> None:
    region = region_of_interest(sweep(0.3), (640, 480))
    assert region.fine_scale == 1.0
    assert region.magnification == pytest.approx(region.refiner_scale)
    assert region.magnification > 1


def test_frames_of_another_size_are_searched_whole_at_their_scale() -> None:
    region = region_of_interest(sweep(), (640, 480))
    other = region.for_frame((1280, 960))
    assert (other.left, other.top, other.width, other.height) == (0, 0, 1280, 960)
    assert other.locator_scale == pytest.approx(region.locator_scale / 2)
    assert region.for_frame((640, 480)) is region


def test_too_few_labels_give_no_region_of_their_own() -> None:
    large, few = sweep(), sweep(2.0)[:2]
    regions = regions_of_interest(np.concatenate([large, few]), [(640, 480)] * 12 + [(1280, 960)] * 2)
    assert [region.frame_wh for region in regions] == [(640, 480), (1280, 960)]
    assert (regions[0].width, regions[0].height) != (640, 480)
    assert (regions[1].left, regions[1].width, regions[1].height) == (0, 1280, 960)
    assert regions[1].locator_scale == pytest.approx(regions[0].locator_scale / 2)
    alone = regions_of_interest(sweep()[:3], [(640, 480)] * 3)
    assert (alone[0].width, alone[0].height) == (640, 480)


def test_round_trip_of_a_region() -> None:
    region = region_of_interest(sweep(), (640, 480))
    assert RegionOfInterest.from_dict(region.to_dict()) == region


def test_the_two_points_of_an_end_are_each_others_reference() -> None:
    xy = sweep()
    xy[3, 0] = np.nan
    assert list(reference_keypoints(xy)) == [1, 0, 3, 2]
    alone = np.full((5, 2, 2), np.nan)
    alone[:2, 0], alone[2:, 1] = 10.0, 20.0
    assert list(reference_keypoints(alone)) == [0, 1]


def test_reference_distances_are_in_crop_px() -> None:
    xy = np.array([[[0, 0], [3, 4], [90, 0]], [[0, 0], [6, 8], [np.nan, np.nan]]], float)
    lengths = reference_distances(xy, [1, 0, 2], np.array([2.0, 1.5]))
    assert lengths.tolist() == [[10, 15], [10, 15], [0, np.inf]]


def test_both_points_of_a_pair_have_one_orientation_and_nan_gives_zero() -> None:
    xy = np.array([[[0.0, 0.0], [0.0, 5.0], [3.0, 3.0], [np.nan, np.nan]]])
    np.testing.assert_allclose(orientations(xy, (1, 0, 3, 2)), [[np.pi / 2, np.pi / 2, 0, 0]])
