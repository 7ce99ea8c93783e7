"""Views map positions and pixels alike: a mark that is cropped, resized or turned lies where the view maps it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.inference.affine import centred_view, resize, resized_view


def blob(xy: tuple[float, float], size_wh: tuple[int, int] = (200, 150), sd: float = 3.0) -> np.ndarray:
    """A bright Gaussian spot at a sub-pixel position, RGB uint8."""
    x, y = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    spot = 200 * np.exp(-((x - xy[0]) ** 2 + (y - xy[1]) ** 2) / (2 * sd**2)) + 20
    return np.repeat(spot[..., None], 3, axis=2).round().astype(np.uint8)


def centroid(image: np.ndarray) -> np.ndarray:
    """Centre of the brightness above the ground."""
    weight = np.clip(image[..., 0].astype(float) - 25, 0, None)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize("scale", [0.4, 0.5, 0.73, 1.0])
def test_resize_moves_a_spot_as_the_view_maps_it(scale: float) -> None:
    image = blob((83.3, 61.8), sd=4.0)
    expected = resized_view(scale, (0, 0), (1, 1)).to_input(np.array([83.3, 61.8]))
    np.testing.assert_allclose(centroid(resize(image, scale)), expected, atol=0.06)


def test_resize_of_a_box_includes_its_offset() -> None:
    image = blob((83.3, 61.8), sd=4.0)
    expected = resized_view(0.5, (40, 30), (1, 1)).to_input(np.array([83.3, 61.8]))
    np.testing.assert_allclose(centroid(resize(image[30:, 40:], 0.5)), expected, atol=0.06)


@pytest.mark.parametrize("angle_deg", [0, 37, 180, -110])
def test_cut_centres_the_point_and_turns_the_direction_to_the_right(angle_deg: float) -> None:
    turn = np.deg2rad(angle_deg)
    centre = np.array([90.4, 70.7])
    ahead = centre + 12 * np.array([np.cos(turn), np.sin(turn)])
    view = centred_view(centre, (64, 64), 1.5, turn)
    np.testing.assert_allclose(view.to_input(centre), [31.5, 31.5], atol=1e-9)
    np.testing.assert_allclose(view.to_input(ahead), [31.5 + 18, 31.5], atol=1e-9)
    np.testing.assert_allclose(centroid(view.cut(blob(tuple(ahead)))), [49.5, 31.5], atol=0.08)


def test_round_trip_of_positions() -> None:
    view = centred_view(np.array([50.0, 60.0]), (64, 48), 0.7, 0.4)
    points = np.random.default_rng(0).uniform(0, 100, (5, 3, 2))
    np.testing.assert_allclose(view.to_source(view.to_input(points)), points, atol=1e-9)


def test_composition_of_two_views() -> None:
    first = resized_view(0.5, (10, 20), (80, 60))
    second = centred_view(np.array([30.0, 20.0]), (32, 32), 1.3, 1.1)
    point = np.array([71.0, 55.0])
    np.testing.assert_allclose(second.after(first).to_input(point), second.to_input(first.to_input(point)))


def test_opencv_resizes_about_pixel_areas() -> None:
    # The convention that everything above rests on: areas, not corners.
    image = np.zeros((4, 4, 3), np.uint8)
    image[0, 0] = image[0, 1] = image[1, 0] = image[1, 1] = 200
    assert cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)[0, 0, 0] == 200
