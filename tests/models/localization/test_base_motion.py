"""Whether a base yields, in drawn films whose truth is known: what a network measures there may be wrong."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.localization.base_motion import base_yields

SIZE_WH = (240, 180)
FRAMES = 32
REGION = RegionOfInterest(SIZE_WH, 0, 0, *SIZE_WH, 0.5, 1.0)
PIVOT = np.array([80.0, 90.0])
LOAD = (1 - np.cos(np.linspace(0, 2 * np.pi, FRAMES))) / 2


def bases(turns_deg: np.ndarray, shake_px: np.ndarray | float = 0.0) -> np.ndarray:
    """Both points (N, 2, 2) px of a base that is turned about a point in its clamp."""
    turn = np.radians(turns_deg)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ends = PIVOT + np.stack([12 * along, 44 * along], axis=1)
    return np.asarray(ends + np.reshape(np.broadcast_to(shake_px, (FRAMES, 2)), (FRAMES, 1, 2)))


def film(truth: np.ndarray, seed: int = 0) -> list[np.ndarray]:
    """A clamp and a body that begins to bend behind its base, before a mottled wall that does not turn."""
    rng = np.random.default_rng(seed)
    mottled = rng.uniform(70, 130, (12, 16, 3)).astype(np.float32)
    wall = cv2.resize(mottled, SIZE_WH, interpolation=cv2.INTER_CUBIC)
    images = []
    for (first, second), load in zip(truth, LOAD, strict=True):
        image = wall.copy()
        along = (second - first) / np.linalg.norm(second - first)
        across = np.array([-along[1], along[0]])
        arc = np.radians(90 * load) * np.linspace(0, 1, 20)[:, None]
        heading = np.cos(arc) * along + np.sin(arc) * across
        body = np.concatenate([[first - 5 * along, second], second + np.cumsum(3 * heading, axis=0)])
        cv2.polylines(
            image, [np.rint(body * 16).astype(np.int32)], False, (200, 205, 190), 18, cv2.LINE_AA, 4
        )
        block = first + np.array(
            [-20 * along - 16 * across, -16 * across, 16 * across, 16 * across - 20 * along]
        )
        cv2.fillPoly(image, [np.rint(block * 16).astype(np.int32)], (60, 50, 90), cv2.LINE_AA, 4)
        images.append(np.clip(image + rng.normal(0, 3, image.shape), 0, 255).astype(np.uint8))
    return images


def measured(truth: np.ndarray, error_deg: np.ndarray | float = 0.0, noise_px: float = 0.3) -> np.ndarray:
    """What a network finds: turned about the first point by its error, and with noise."""
    turn = np.radians(np.broadcast_to(error_deg, FRAMES))
    along = truth[:, 1] - truth[:, 0]
    turned = np.stack(
        [
            along[:, 0] * np.cos(turn) - along[:, 1] * np.sin(turn),
            along[:, 0] * np.sin(turn) + along[:, 1] * np.cos(turn),
        ],
        axis=1,
    )
    ends = np.stack([truth[:, 0], truth[:, 0] + turned], axis=1)
    return np.asarray(ends + np.random.default_rng(1).normal(0, noise_px, ends.shape))


HELD = bases(np.zeros(FRAMES))


@pytest.mark.parametrize("yield_deg", [8.0, -8.0, 5.0, -4.0])
def test_a_base_that_turns_with_the_bend_yields(yield_deg: float) -> None:
    truth = bases(yield_deg * LOAD)
    assert base_yields(film(truth), measured(truth), REGION)


def test_a_base_that_creeps_yields() -> None:
    truth = bases(np.linspace(0, 5, FRAMES))
    assert base_yields(film(truth), measured(truth), REGION)


@pytest.mark.parametrize("error_deg", [0.0, 3.0, -6.0, 10.0])
def test_a_held_base_whose_direction_is_mistaken_with_the_bend_does_not_yield(error_deg: float) -> None:
    """A network takes the beginning of the bend for the base."""
    assert not base_yields(film(HELD), measured(HELD, error_deg * LOAD), REGION)


@pytest.mark.parametrize("noise_px", [1.0, 2.0, 4.0])
def test_noise_is_no_yielding(noise_px: float) -> None:
    assert not base_yields(film(HELD), measured(HELD, noise_px=noise_px), REGION)


@pytest.mark.parametrize("wrong", [1, 3])
def test_a_few_wrong_frames_are_no_yielding(wrong: int) -> None:
    ends = measured(HELD)
    ends[5 : 5 + wrong, 1] += 25.0
    assert not base_yields(film(HELD), ends, REGION)


def test_a_hand_over_the_base_for_a_while_is_no_yielding() -> None:
    images, ends = film(HELD), measured(HELD)
    for i in range(10, 13):
        cv2.circle(images[i], (110, 95), 40, (190, 150, 130), -1)
        ends[i] += np.random.default_rng(i).normal(0, 12, (2, 2))
    assert not base_yields(images, ends, REGION)


@pytest.mark.parametrize("drifts", [False, True])
def test_a_rig_that_shakes_or_drifts_is_no_yielding(drifts: bool) -> None:
    if drifts:
        shake_px = np.linspace(0, 1, FRAMES)[:, None] * [6.0, -4.0]
    else:
        shake_px = np.random.default_rng(3).normal(0, 3, (FRAMES, 2))
    truth = bases(np.zeros(FRAMES), shake_px)
    for error_deg in (0.0, 4.0):
        assert not base_yields(film(truth), measured(truth, error_deg * LOAD), REGION)


def test_light_that_changes_is_no_yielding() -> None:
    images = [
        np.clip(image * (0.6 + 0.5 * load), 0, 255).astype(np.uint8)
        for image, load in zip(film(HELD), LOAD, strict=True)
    ]
    assert not base_yields(images, measured(HELD, 3.0 * LOAD), REGION)
    truth = bases(8.0 * LOAD)
    images = [
        np.clip(image * (0.6 + 0.5 * load), 0, 255).astype(np.uint8)
        for image, load in zip(film(truth), LOAD, strict=True)
    ]
    assert base_yields(images, measured(truth), REGION)


@pytest.mark.parametrize("frames", [0, 1, 7])
def test_too_few_frames_say_nothing(frames: int) -> None:
    truth = bases(8.0 * LOAD)
    assert not base_yields(film(truth)[:frames], measured(truth)[:frames], REGION)


def test_pictures_that_show_nothing_say_nothing() -> None:
    blank = [np.zeros((SIZE_WH[1], SIZE_WH[0], 3), np.uint8)] * FRAMES
    assert not base_yields(blank, measured(bases(8.0 * LOAD)), REGION)
