"""Joint registration of moving ends in rendered frames with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.data.prepared import PreparedFrame, prepare
from bendtrack.models.denoising.registration import MAX_FRAMES, MIN_FRAMES, register_ends
from bendtrack.models.inference.roi import orientations, regions_of_interest, turned
from bendtrack.tracker.synthetic.stream import KEYPOINTS, TRAINING, Renderer, drawn_look, inflation_deg

FRAMES = 16
REFERENCE = (1, 0, 3, 2)
ENDS = [KEYPOINTS.index(name) for name in ("base_1", "base_2", "tip_1", "tip_2")]
VIDEO = ["one"] * FRAMES


@pytest.fixture(scope="module")
def film() -> tuple[list[PreparedFrame], np.ndarray]:
    """Frames of one actuator while it bends, and where its ends are, (N, 4, 2) px."""
    look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
    renderer = Renderer(look)
    samples = [renderer.frame(bend) for bend in inflation_deg(look, FRAMES)]
    truth = np.stack([sample.keypoints_xy[ENDS] for sample in samples])
    (region,) = regions_of_interest(truth, [(400, 300)] * FRAMES)
    return [prepare(sample.image, xy, region) for sample, xy in zip(samples, truth, strict=True)], truth


def off(truth: np.ndarray, seed: int = 0) -> np.ndarray:
    """Positions whose tips are shifted and turned: more to one side as they turn, and by chance."""
    rng = np.random.default_rng(seed)
    direction = orientations(truth, REFERENCE)[:, 3]
    slow = np.stack([0 * direction, 1.2 * np.cos(direction)], axis=1)
    moved = truth.copy()
    for k, sign in ((2, 1), (3, -1)):
        moved[:, k] += turned(sign * slow, direction) + rng.normal(0, 0.8, (len(truth), 2))
    return moved


def tip_deg(xy: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How far the tip's direction is off, degrees."""
    apart = orientations(xy, REFERENCE)[:, 3] - orientations(truth, REFERENCE)[:, 3]
    return np.asarray(np.degrees((apart + np.pi) % (2 * np.pi) - np.pi))


def test_registration_removes_scatter_and_keeps_the_mean_pose(film, features) -> None:
    frames, truth = film
    start = off(truth)
    moved = register_ends(frames, start, np.ones(start.shape[:2], bool), REFERENCE, VIDEO, features)
    before, after = tip_deg(start, truth), tip_deg(moved, truth)
    assert before.std() > 1.5
    assert after.std() < 0.4 * before.std()
    assert after.mean() == pytest.approx(before.mean(), abs=1e-6)
    # Along and across the tip, and with the given distance of its points.
    middles = [
        turned((xy - truth)[:, 2:].mean(axis=1), -orientations(truth, REFERENCE)[:, 3])
        for xy in (start, moved)
    ]
    assert (middles[1].std(axis=0) < 0.8 * middles[0].std(axis=0)).all()
    lengths = [np.linalg.norm(xy[:, 3] - xy[:, 2], axis=1) for xy in (start, moved)]
    np.testing.assert_allclose(lengths[1], lengths[0], atol=1e-6)
    np.testing.assert_array_equal(moved[:, :2], start[:, :2])


def test_true_positions_hardly_move(film, features) -> None:
    frames, truth = film
    moved = register_ends(frames, truth, np.ones(truth.shape[:2], bool), REFERENCE, VIDEO, features)
    assert tip_deg(moved, truth).std() < 0.6


def test_positions_that_are_not_trusted_and_ends_at_rest_stay(film, features) -> None:
    frames, truth = film
    start = off(truth)
    known = np.ones(start.shape[:2], bool)
    known[3, 2] = False
    start[3, 2] = np.nan
    known[7, 3] = False
    start[7, 3] += 60
    moved = register_ends(frames, start, known, REFERENCE, VIDEO, features)
    np.testing.assert_array_equal(moved[[3, 7]], start[[3, 7]])
    sound = known.all(axis=1)
    assert tip_deg(moved, truth)[sound].std() < 0.4 * tip_deg(start, truth)[sound].std()
    # Nor does an end turn of which a point rests.
    one = start.copy()
    one[:, 2] = start[0, 2]
    np.testing.assert_array_equal(register_ends(frames, one, known, REFERENCE, VIDEO, features), one)
    # Keypoints that are not each other's reference are no end.
    np.testing.assert_array_equal(register_ends(frames, start, known, (1, 2, 3, 0), VIDEO, features), start)


def test_each_video_is_registered_by_itself(film, features) -> None:
    frames, truth = film
    start, known = off(truth), np.ones(truth.shape[:2], bool)
    few = MIN_FRAMES - 1
    videos = ["few"] * few + ["many"] * (FRAMES - few)
    moved = register_ends(frames, start, known, REFERENCE, videos, features)
    np.testing.assert_array_equal(moved[:few], start[:few])
    alone = register_ends(frames[few:], start[few:], known[few:], REFERENCE, videos[few:], features)
    np.testing.assert_allclose(moved[few:], alone, atol=1e-6)
    assert tip_deg(moved, truth)[few:].std() < 0.5 * tip_deg(start, truth)[few:].std()


def test_frames_smaller_than_others_are_moved_in_their_own_px(film, features) -> None:
    frames, truth = film
    start = off(truth)
    known = np.ones(start.shape[:2], bool)
    # The same pictures as if they had been made smaller before: a px of a frame is two px of what is looked at.
    half = [
        replace(
            frame,
            fine_view=replace(frame.fine_view, matrix=frame.fine_view.matrix @ np.diag([2.0, 2.0, 1.0])),
        )
        for frame in frames
    ]
    moved = register_ends(half, start / 2, known, REFERENCE, VIDEO, features)
    np.testing.assert_allclose(
        2 * moved, register_ends(frames, start, known, REFERENCE, VIDEO, features), atol=1e-6
    )


def test_more_frames_than_fit_are_registered_in_parts(film, features, monkeypatch) -> None:
    frames, truth = film
    assert FRAMES <= MAX_FRAMES
    monkeypatch.setattr("bendtrack.models.denoising.registration.MAX_FRAMES", FRAMES // 2)
    start, known = off(truth), np.ones(truth.shape[:2], bool)
    moved = register_ends(frames, start, known, REFERENCE, VIDEO, features)
    assert tip_deg(moved, truth).std() < 0.5 * tip_deg(start, truth).std()


def test_an_occluded_tip_stays_and_does_not_shift_the_others(film, features) -> None:
    frames, truth = film
    start, known = off(truth), np.ones(truth.shape[:2], bool)
    (x, y), side = frames[5].fine_view.to_input(truth[5, 2:]).mean(axis=0).round().astype(int), 45
    fine = frames[5].fine.copy()
    noise = np.random.default_rng(0).integers(0, 256, fine.shape, dtype=np.uint8)
    there = np.s_[max(y - side, 0) : y + side, max(x - side, 0) : x + side]
    fine[there] = noise[there]
    hidden = [replace(frame, fine=fine) if i == 5 else frame for i, frame in enumerate(frames)]
    moved = register_ends(hidden, start, known, REFERENCE, VIDEO, features)
    assert np.linalg.norm(moved[5] - start[5], axis=1).max() < 8
    others = np.arange(FRAMES) != 5
    assert tip_deg(moved, truth)[others].std() < 0.5 * tip_deg(start, truth)[others].std()


def test_blank_images_move_nothing(film, features) -> None:
    frames, truth = film
    blank = [replace(frame, fine=np.full_like(frame.fine, 90)) for frame in frames]
    start = off(truth)
    moved = register_ends(blank, start, np.ones(start.shape[:2], bool), REFERENCE, VIDEO, features)
    np.testing.assert_allclose(moved, start, atol=1e-3)


def test_an_end_that_is_carried_far_stays_where_it_was(film, features, monkeypatch) -> None:
    frames, truth = film
    start, known = off(truth), np.ones(truth.shape[:2], bool)
    free = register_ends(frames, start, known, REFERENCE, VIDEO, features)
    zoom = 2 * frames[0].region.refiner_scale
    carried = np.linalg.norm((free - start)[:, 2:].mean(axis=1), axis=1) * zoom
    limit = float(np.median(carried))
    monkeypatch.setattr("bendtrack.models.denoising.registration.MAX_STEP_PX", limit)
    moved = register_ends(frames, start, known, REFERENCE, VIDEO, features)
    far = carried > limit
    assert far.sum() == FRAMES // 2
    np.testing.assert_allclose(moved[far], start[far], atol=1e-9)
    np.testing.assert_allclose(moved[~far], free[~far], atol=1e-9)
