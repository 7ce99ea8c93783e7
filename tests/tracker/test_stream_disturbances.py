"""Disturbances of a film: the truth follows a clamp that yields and a camera that shakes; others are as asked."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bendtrack.tracker.synthetic.stream import (
    TRAINING,
    Cable,
    Disturbances,
    Hand,
    Look,
    Renderer,
    Tube,
    drawn_look,
)

SIZE_WH = (320, 240)
PLAIN = replace(TRAINING, backgrounds=("plain paper",), clamps=("block",))


@pytest.fixture(scope="module")
def look() -> Look:
    """A body seen from the front by a camera that adds no noise, alone in the picture."""
    own = drawn_look(21, 4, size_wh=SIZE_WH, families=PLAIN, bend_deg=(0.0, 120.0))
    return replace(
        own,
        place=replace(own.place, second_arm=None),
        view=replace(own.view, tilt_x_deg=0.0, tilt_y_deg=0.0, nearness=0.0, lens=0.0),
        scene=replace(own.scene, distractors=0, occluders=0, tube_px=0.0),
        sensor=replace(
            own.sensor, kind="colour", noise=0.0, jpeg_quality=0, blur_px=0.5, motion_px=0.0, shrink=1.0
        ),
    )


def other_body(look: Look) -> Look:
    """A body next to the look's own."""
    x, y = SIZE_WH[0] - look.place.base_xy[0], SIZE_WH[1] - look.place.base_xy[1]
    return replace(
        look, place=replace(look.place, base_xy=(x, y), direction_deg=look.place.direction_deg + 180)
    )


def test_without_disturbances_nothing_changes(look: Look) -> None:
    usual = Renderer(look).frame(50.0, noise_seed=3, moment=0.4, sweep_deg=20.0)
    calm = Renderer(look, (), Disturbances()).frame(50.0, noise_seed=3, moment=0.4, sweep_deg=20.0)
    np.testing.assert_array_equal(calm.image, usual.image)
    np.testing.assert_array_equal(calm.keypoints_xy, usual.keypoints_xy)


@pytest.mark.parametrize("yield_deg", [8.0, -5.0])
def test_a_clamp_that_yields_turns_body_and_truth_about_a_point_in_the_clamp(
    look: Look, yield_deg: float
) -> None:
    """At half the largest bend it has turned by half, and what is seen is the body that begins there."""
    sample = Renderer(look, (), Disturbances(yield_deg=yield_deg)).frame(60.0)
    along = np.array(
        [np.cos(np.radians(look.place.direction_deg)), np.sin(np.radians(look.place.direction_deg))]
    )
    pivot = np.array(look.place.base_xy) - 1.6 * look.body.half_px * along
    turn = np.radians(yield_deg / 2)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    rest = Renderer(look).frame(60.0)
    np.testing.assert_allclose(
        sample.keypoints_xy, pivot + (rest.keypoints_xy - pivot) @ rotation.T, atol=1e-6
    )
    assert sample.angle_deg == pytest.approx(rest.angle_deg)
    x, y = (pivot + rotation @ (np.array(look.place.base_xy) - pivot)).tolist()
    moved = replace(look.place, base_xy=(x, y), direction_deg=look.place.direction_deg + yield_deg / 2)
    difference = sample.image.astype(int) - Renderer(replace(look, place=moved)).frame(60.0).image
    assert np.abs(difference).max() <= 2
    np.testing.assert_array_equal(
        Renderer(look, (), Disturbances(yield_deg=yield_deg)).frame(0.0).image,
        Renderer(look).frame(0.0).image,
    )


def test_a_camera_that_shakes_moves_picture_and_truth_alike(look: Look) -> None:
    renderer = Renderer(look, (), Disturbances(shake_px=6.0))
    rest = renderer.frame(40.0)
    np.testing.assert_array_equal(rest.image, Renderer(look).frame(40.0).image)
    shifts = []
    for moment in (0.13, 0.44, 0.71):
        sample = renderer.frame(40.0, moment=moment)
        moved = sample.keypoints_xy - rest.keypoints_xy
        np.testing.assert_allclose(moved, np.broadcast_to(moved[0], moved.shape), atol=1e-9)
        np.testing.assert_allclose(sample.midline_xy - rest.midline_xy, moved[0] + 0 * rest.midline_xy)
        grey, before = (
            cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) for image in (sample.image, rest.image)
        )
        seen, _ = cv2.phaseCorrelate(before, grey, cv2.createHanningWindow(SIZE_WH, cv2.CV_32F))
        np.testing.assert_allclose(seen, moved[0], atol=0.3)
        shifts.append(moved[0])
    assert np.ptp(shifts, axis=0).max() > 2
    assert np.abs(shifts).max() <= 6


def test_a_hand_comes_once_and_hides_what_it_covers(look: Look) -> None:
    rest = Renderer(look).frame(40.0, moment=0.2)
    assert rest.visible.all()
    x, y = rest.keypoints_xy[-1].tolist()
    renderer = Renderer(look, (), Disturbances(hand=Hand((x, y), 30.0, (0.4, 0.5))))
    for moment, is_there in ((None, False), (0.39, False), (0.4, True), (0.49, True), (0.5, False)):
        sample = renderer.frame(40.0, moment=moment)
        same = np.array_equal(sample.image, Renderer(look).frame(40.0, moment=moment).image)
        assert same != is_there
        assert sample.visible[-1] != is_there


def test_a_shadow_passes_over_all_of_the_picture(look: Look) -> None:
    renderer = Renderer(look, (), Disturbances(shadow=0.5))
    np.testing.assert_array_equal(renderer.frame(0.0).image, Renderer(look).frame(0.0).image)
    for moment, column in ((0.3, 58), (0.5, 160), (0.8, 313)):
        shadowed, lit = (
            own.frame(0.0, moment=moment).image[:20].astype(float).mean(axis=(0, 2))
            for own in (renderer, Renderer(look))
        )
        ratio = cv2.blur((shadowed / lit)[None], (15, 1))[0]
        assert abs(int(ratio.argmin()) - column) < 60
        assert ratio.min() < 0.8


def test_a_tube_bends_a_little_in_step_with_the_body(look: Look) -> None:
    tube = Tube(other_body(look), (30.0, 36.0))
    renderer = Renderer(look, (), Disturbances(tubes=(tube,)))
    for bend, own in ((0.0, 30.0), (120.0, 36.0)):
        expected = Renderer(look, [(tube.look, own)]).frame(bend).image
        np.testing.assert_array_equal(renderer.frame(bend).image, expected)


def test_a_cable_sways_at_its_middle(look: Look) -> None:
    place = other_body(look).place.base_xy
    knots = tuple((place[0], place[1] + 6.0 * k) for k in range(-4, 5))
    renderer = Renderer(look, (), Disturbances(cable=Cable(knots, (0.9, 0.1, 0.1), 4.0)))
    lit, swayed = (renderer.frame(0.0, moment=moment).image.astype(int) for moment in (0.0, 1 / (4 * 2.7)))
    alone = Renderer(look).frame(0.0, moment=0.0).image
    assert np.abs(lit - alone).max() > 60
    changed = np.argwhere(np.abs(swayed - lit).max(axis=2) > 60)
    assert len(changed)
    assert np.linalg.norm(changed[:, ::-1] - place, axis=1).max() < 40
