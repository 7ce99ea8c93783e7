"""Motion evidence in drawn films whose truth is known: an arm that swings, and what else moves or changes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bendtrack.models.localization.motion import motion_evidence

SIZE_WH = (320, 240)
FRAMES = 32
BASE = np.array([90.0, 120.0])
LENGTH_PX = 90.0
TUBE = np.array([[210.0, 40.0], [240.0, 110.0], [225.0, 200.0]])
BODY = (190, 185, 175)


def bench() -> np.ndarray:
    """A bench with some texture and edges, RGB float (H, W, 3)."""
    rng = np.random.default_rng(5)
    noise = cv2.GaussianBlur(rng.normal(0, 1, (SIZE_WH[1], SIZE_WH[0], 3)).astype(np.float32), (0, 0), 3)
    image = 110 + 60 * noise
    cv2.rectangle(image, (150, 20), (300, 130), (60, 70, 90), -1)
    cv2.rectangle(image, (20, 150), (120, 230), (150, 140, 120), -1)
    return image


def tip(angle_deg: float) -> np.ndarray:
    """The arm's tip, px."""
    return BASE + LENGTH_PX * np.array([np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))])


def draw(image: np.ndarray, points: np.ndarray, colour: tuple[int, int, int] = BODY) -> None:
    """A body along points, in place."""
    cv2.polylines(image, [np.round(points * 16).astype(np.int32)], False, colour, 14, cv2.LINE_AA, 4)


def film(angles_deg: np.ndarray, tube_shift_px: np.ndarray | float = 0.0) -> np.ndarray:
    """Frames float (N, H, W, 3) of an arm at its angles, and of a tube of the same colour."""
    shift = np.broadcast_to(tube_shift_px, len(angles_deg))
    frames = []
    for angle, aside in zip(angles_deg, shift, strict=True):
        image = bench()
        draw(image, TUBE + np.array([aside, 0.0]))
        draw(image, np.stack([BASE, tip(angle)]))
        frames.append(image)
    return np.stack(frames)


def encoded(frames: np.ndarray) -> list[np.ndarray]:
    """Frames with sensor noise, uint8."""
    rng = np.random.default_rng(6)
    return list(np.clip(frames + rng.normal(0, 2.5, frames.shape), 0, 255).round().astype(np.uint8))


SWING = 70.0 * (1 - np.cos(np.linspace(0, 2 * np.pi, FRAMES))) / 2


def evidence_of(frames: np.ndarray, angles_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence at the arm's tip (N,), just behind its base (N,) and along the tube (N, 3) in each frame."""
    found = motion_evidence(encoded(frames))
    assert found.is_known
    tips = np.stack([tip(angle) - 0.04 * (tip(angle) - BASE) for angle in angles_deg])
    n = len(angles_deg)
    return (
        found.at(tips),
        found.at(np.broadcast_to(BASE - [16.0, 0.0], (n, 2))),
        found.at(np.broadcast_to(TUBE, (n, *TUBE.shape))),
    )


def test_the_arm_moves_and_a_tube_of_its_colour_does_not() -> None:
    moving, fixed, tube = evidence_of(film(SWING), SWING)
    assert moving.min() > 0.8
    assert tube.max() < 0.1
    assert fixed.max() < 0.5


def test_an_arm_that_mostly_rests_counts_where_it_rests() -> None:
    angles = np.where(np.arange(FRAMES) % 5 == 0, 50.0, 0.0)
    moving, _, tube = evidence_of(film(angles), angles)
    assert moving.min() > 0.3
    assert tube.max() < 0.1


def test_a_drift_of_the_exposure_and_a_lamp_do_not_move() -> None:
    gain = (1 + 0.3 * np.sin(np.linspace(0, 5, FRAMES)))[:, None, None, None]
    gain[20:] *= 0.7
    moving, _, tube = evidence_of(film(SWING) * gain, SWING)
    assert moving.min() > 0.8
    assert tube.max() < 0.2


def test_a_shadow_that_passes_does_not_move() -> None:
    frames = film(SWING)
    x = np.arange(SIZE_WH[0])
    for i in range(FRAMES):
        frames[i] *= (1 - 0.4 * np.exp(-(((x - 10 * i) / 40) ** 2)))[:, None]
    moving, _, tube = evidence_of(frames, SWING)
    assert moving.min() > 0.8
    assert tube.max() < 0.3


def test_a_hand_that_comes_in_once_says_nothing_about_other_frames() -> None:
    frames = film(SWING)
    for i in (11, 12):
        cv2.circle(frames[i], (235, 120), 60, (205, 160, 135), -1, cv2.LINE_AA)
    moving, _, tube = evidence_of(frames, SWING)
    others = np.delete(np.arange(FRAMES), [11, 12])
    assert moving.min() > 0.8
    assert tube[others].max() < 0.1


def test_a_rig_that_shakes_as_a_whole_does_not_move() -> None:
    rng = np.random.default_rng(7)
    shake = rng.uniform(-4, 4, (FRAMES, 2))
    shake[0] = 0.0
    frames = np.stack(
        [
            cv2.warpAffine(
                frame, np.array([[1, 0, dx], [0, 1, dy]]), SIZE_WH, borderMode=cv2.BORDER_REPLICATE
            )
            for frame, (dx, dy) in zip(film(SWING), shake, strict=True)
        ]
    )
    found = motion_evidence(encoded(frames))
    tips = np.stack([tip(angle) for angle in SWING]) + shake
    assert np.quantile(found.at(tips), 0.1) > 0.8
    assert found.at(TUBE[None] + shake[:, None]).max() < 0.3


@pytest.mark.parametrize("creep_px", [0.5, 1.0])
def test_a_tube_that_creeps_hardly_moves(creep_px: float) -> None:
    moving, _, tube = evidence_of(film(SWING, np.linspace(0, creep_px, FRAMES)), SWING)
    assert moving.min() > 0.8
    assert tube.max() < 0.5


def test_where_nothing_moves_nothing_is_said() -> None:
    still = film(np.zeros(FRAMES))
    still[4] *= 0.8
    found = motion_evidence(encoded(still))
    assert not found.is_known


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames_are_enough_not_to_fail(frames: int) -> None:
    found = motion_evidence(encoded(film(SWING[:frames])))
    assert found.at(np.zeros((frames, 2))).shape == (frames,)
