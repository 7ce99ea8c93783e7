"""The static-patch test: which motion counts, and that noise and a change of light do not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.inference.static_patch import StaticPatchTest

SIDE = 64


@pytest.fixture
def edge() -> np.ndarray:
    """A grey body's end on a dark ground, sixteen times enlarged for sub-pixel motion: (1024, 1024, 3)."""
    fine = np.full((SIDE * 16, SIDE * 16, 3), 40, np.uint8)
    cv2.rectangle(fine, (300, 350), (620, 700), (190, 180, 170), -1)
    return cv2.GaussianBlur(fine, (0, 0), 14)


def moved(fine: np.ndarray, x_px: float, y_px: float) -> np.ndarray:
    shift = np.array([[1, 0, x_px * 16], [0, 1, y_px * 16]], dtype=float)
    shown = cv2.warpAffine(fine, shift, (SIDE * 16, SIDE * 16), borderMode=cv2.BORDER_REPLICATE)
    return cv2.resize(shown, (SIDE, SIDE), interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize(
    ("x_px", "y_px", "static"),
    [(0.02, 0.02, True), (0.0, 0.15, False), (-0.15, 0.0, False), (0.1, 0.1, False), (3.0, 0.0, False)],
)
def test_a_tenth_of_a_px_is_motion(edge: np.ndarray, x_px: float, y_px: float, static: bool) -> None:
    assert StaticPatchTest(moved(edge, 0, 0)).is_static(moved(edge, x_px, y_px)) is static


def test_noise_and_a_change_of_light_are_no_motion(edge: np.ndarray) -> None:
    rng = np.random.default_rng(5)

    def filmed(level: float) -> np.ndarray:
        return np.clip(moved(edge, 0, 0) + rng.normal(level, 1.5, (SIDE, SIDE, 3)), 0, 255).astype(np.uint8)

    first = StaticPatchTest(filmed(0))
    assert all(first.is_static(filmed(level)) for level in (0, 0, 4, -4))


def test_a_small_occluder_is_a_change(edge: np.ndarray) -> None:
    covered = moved(edge, 0, 0)
    covered[28:34, 30:36] = 230
    assert not StaticPatchTest(moved(edge, 0, 0)).is_static(covered)


def test_an_image_without_edges_can_be_static() -> None:
    flat = np.full((SIDE, SIDE, 3), 90, np.uint8)
    assert StaticPatchTest(flat).is_static(flat)
