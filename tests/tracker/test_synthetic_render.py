"""The picture agrees with its truth, measured in the picture by means that know nothing of the renderer."""

import dataclasses as dc

import cv2
import numpy as np
import pytest

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.synthetic.geometry import Midline
from bendtrack.tracker.synthetic.looks import Look
from bendtrack.tracker.synthetic.render import Renderer, render_frame
from bendtrack.tracker.synthetic.sampling import MARKS, random_look

ANGLES = (-20.0, 3.0, 77.3, 140.0, 220.0)


def plain(look, mark=(0.0, 0.0, 0.0)):
    """The same body under flat light, sharp and without noise, with marks of one colour."""
    grey = (0.8, 0.8, 0.8)
    return dc.replace(
        look,
        body=dc.replace(look.body, mark_radius_px=3.0),
        material=dc.replace(
            look.material, kind="pigmented", colour=grey, layer_colour=grey, mark_colour=mark,
            gloss=0.0, roughness=0.0, bubbles=0, opacity=1.0,
        ),
        light=dc.replace(look.light, ambient=1.0, gradient=0.0, vignette=0.0, shadow=0.0, tint=(1, 1, 1)),
        camera=dc.replace(look.camera, blur_px=0.6, sharpening=0.0, jpeg_quality=0),
    )  # fmt: skip


def moved(look, shift=(0.0, 0.0), turn_deg=0.0):
    x, y = look.pose.base_xy
    pose = dc.replace(
        look.pose, base_xy=(x + shift[0], y + shift[1]), direction_deg=look.pose.direction_deg + turn_deg
    )
    return dc.replace(look, pose=pose)


def grey(look, angle):
    return Renderer(look).frame(angle).image[..., 1].astype(float)


def pin_centres(look, angle, near):
    """Centroid of what the dark pins change in the picture, around each rough position."""
    change = grey(plain(look, mark=(0.8, 0.8, 0.8)), angle) - grey(plain(look), angle)
    centres = []
    for x, y in np.round(near).astype(int):
        rows, columns = np.mgrid[y - 8 : y + 9, x - 8 : x + 9]
        weight = change[y - 8 : y + 9, x - 8 : x + 9]
        centres.append(((weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()))
    return np.array(centres)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("angle", ANGLES)
def test_keypoints_lie_on_the_pins(seed, angle):
    look = random_look(seed, marks="pins", background="paper")
    frame = render_frame(plain(look), angle)
    error = pin_centres(look, angle, frame.xy) - frame.xy
    assert np.abs(error).max() < 0.05


@pytest.mark.parametrize("shift", [(0.25, 0.0), (0.0, 0.5), (-0.4, 0.3)])
def test_picture_follows_a_shift_below_a_pixel(shift):
    look = random_look(4, marks="pins", background="paper")
    near = render_frame(plain(look), 90.0).xy
    before, after = pin_centres(look, 90.0, near), pin_centres(moved(look, shift), 90.0, near)
    np.testing.assert_allclose(after - before, np.broadcast_to(shift, before.shape), atol=0.03)


def test_picture_follows_a_turn():
    look = random_look(4, marks="pins", background="paper")
    turned = moved(look, turn_deg=33.3)
    near = render_frame(plain(turned), 90.0).xy
    vectors = [np.diff(pin_centres(*args), axis=0)[[0, 2]] for args in (
        (look, 90.0, render_frame(plain(look), 90.0).xy), (turned, 90.0, near),
    )]  # fmt: skip
    headings = [np.degrees(np.arctan2(v[:, 1], v[:, 0])) for v in vectors]
    np.testing.assert_allclose((headings[1] - headings[0] + 180) % 360 - 180, 33.3, atol=0.1)


def coverage(look, angle):
    """What the body leaves of the background, from two pictures on white and on black."""
    white, black = (
        grey(dc.replace(look, scene=dc.replace(look.scene, colour=(c, c, c), contrast=0.0)), angle)
        for c in (0.95, 0.05)
    )
    return 1 - (white - black) / np.max(white - black)


def half_way(image, start, direction, reach=3.0):
    """Where the image crosses one half on a short line, px from `start` along `direction`."""
    offset = np.arange(-reach, reach, 0.02)
    points = (start + offset[:, None] * direction).astype(np.float32)
    profile = cv2.remap(image.astype(np.float32), points[None, :, 0], points[None, :, 1], cv2.INTER_LINEAR)[0]
    return offset[np.argmin(np.abs(profile - 0.5))]


@pytest.mark.parametrize("angle", ANGLES)
def test_outline_lies_where_the_midline_says(angle):
    """The body's lower edge is the layer's height under the strain line, all along the bend."""
    look = plain(random_look(8, marks="seams", background="paper"))
    cover = coverage(look, angle)
    line = Midline(look.body, look.pose, angle)
    errors = []
    for s in np.linspace(look.body.bend_s[0], look.body.keypoint_s[3] - 10, 25):
        on_edge = line.point(s, -look.body.layer_px)
        errors.append(half_way(cover, on_edge, line.point(s, -look.body.layer_px - 1) - on_edge))
    assert abs(np.mean(errors)) < 0.05
    assert np.std(errors) < 0.1


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("angle", [-20.0, 0.0, 45.0, 180.0, 220.0])
def test_angle_is_the_turn_of_the_midline(seed, angle):
    """Against numeric tangents of the dense midline, added up so that nothing wraps."""
    look = random_look(seed)
    line = Midline(look.body, look.pose, angle)
    steps = np.diff(line.point(np.linspace(0, look.body.end_s, 4001)), axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    turn = look.pose.side * np.degrees(heading[-1] - heading[0])
    assert turn == pytest.approx(angle, abs=1e-6)
    assert np.hypot(*steps.T).sum() == pytest.approx(look.body.end_s, abs=1e-3)


@pytest.mark.parametrize("marks", MARKS)
@pytest.mark.parametrize("length", [25.0, 40.0, 60.0])
def test_end_vectors_have_their_length_and_the_ends_direction(marks, length):
    look = random_look(5, end_vector_px=length, marks=marks)
    for angle in ANGLES:
        xy = render_frame(look, angle, seed=None).xy
        ends = np.diff(xy, axis=0)[[0, 2]]
        np.testing.assert_allclose(np.hypot(*ends.T), length, atol=1e-9)
        heading = np.degrees(np.arctan2(ends[:, 1], ends[:, 0]))
        turn = look.pose.side * (heading[1] - heading[0])
        assert (turn - angle + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_body_coordinates_invert_point():
    look = random_look(6)
    rng = np.random.default_rng(0)
    for angle in (-20.0, 0.0, 0.001, 100.0, 220.0):
        line = Midline(look.body, look.pose, angle)
        s = rng.uniform(-5, look.body.end_s, 200)
        t = rng.uniform(-look.body.layer_px, look.body.height_px, 200)
        xy = line.point(s, t)
        piece = np.clip(np.searchsorted(line.s, s, side="right") - 1, 0, None)
        back_s, back_t = line.body_coordinates(xy[:, 0], xy[:, 1], piece)
        np.testing.assert_allclose(back_s, s, atol=1e-4)
        np.testing.assert_allclose(back_t, t, atol=1e-6)


@pytest.mark.parametrize("seed", range(30))
def test_keypoints_stay_in_the_picture(seed):
    look = random_look(seed, end_vector_px=[25.0, 40.0, 60.0][seed % 3])
    for angle in np.linspace(-20, 220, 13):
        xy = Midline(look.body, look.pose, angle).point(np.array(look.body.keypoint_s), look.body.keypoint_t)
        assert (xy > 5).all()
        assert (xy < np.array(look.size_wh) - 6).all()


def test_bases_point_everywhere_and_bend_both_ways():
    poses = [random_look(seed).pose for seed in range(60)]
    quadrants = {int(pose.direction_deg // 90) for pose in poses}
    assert quadrants == {0, 1, 2, 3}
    assert {pose.side for pose in poses} == {-1, 1}


def test_the_base_and_the_scene_stand_still():
    look = dc.replace(random_look(9), camera=dc.replace(random_look(9).camera, jpeg_quality=0))
    renderer = Renderer(look)
    frames = [renderer.frame(angle) for angle in (0.0, 60.0, 150.0)]
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.xy[:2], frames[0].xy[:2])
    far = np.ones(look.size_wh[::-1], bool)
    for frame in frames:
        for x, y in frame.midline:
            cv2.circle(canvas := far.astype(np.uint8), (round(x), round(y)), 120, 0, -1)
            far &= canvas.astype(bool)
    assert far.any()
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.image[far], frames[0].image[far])


def test_pressure_swells_the_chambers_and_leaves_the_keypoints():
    renderer = Renderer(plain(random_look(2)))
    low, high = renderer.frame(60.0, 0.0), renderer.frame(60.0, 1.0)
    np.testing.assert_array_equal(low.xy, high.xy)
    assert (low.image != high.image).mean() > 0.005


def test_a_seed_is_a_look():
    assert random_look(7) == random_look(7)
    assert random_look(7) != random_look(8)
    first, again, other = (render_frame(random_look(7), 50.0, seed=s).image for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_look_survives_json():
    import json

    look = random_look(3)
    assert Look.from_dict(json.loads(json.dumps(dc.asdict(look)))) == look


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(BendtrackError, match="translucent, pigmented, rubber"):
        random_look(0, material="steel")
    with pytest.raises(BendtrackError, match="leave room"):
        random_look(0, end_vector_px=300.0)


def test_motion_blurs_around_the_truth():
    look = random_look(4, marks="pins", background="paper")
    near = render_frame(plain(look), 90.0).xy
    sharp = pin_centres(look, 90.0, near)
    renderers = [Renderer(plain(look, mark)) for mark in ((0.8, 0.8, 0.8), (0.0, 0.0, 0.0))]
    white, black = (r.frame(90.0, sweep_deg=1.2).image[..., 1].astype(float) for r in renderers)
    x, y = np.round(near[3]).astype(int)
    rows, columns = np.mgrid[y - 9 : y + 10, x - 9 : x + 10]
    weight = (white - black)[y - 9 : y + 10, x - 9 : x + 10]
    centre = (weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()
    np.testing.assert_allclose(centre, sharp[3], atol=0.05)
