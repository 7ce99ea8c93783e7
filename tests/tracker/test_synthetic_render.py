"""A trial's images agree with their truth, measured in the image by means that know nothing of the renderer."""

import dataclasses as dc
import json

import cv2
import numpy as np
import pytest

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.synthetic.stream import TRAINING, Look, Renderer
from bendtrack.tracker.synthetic.stream import renderer as renderer_module
from bendtrack.tracker.synthetic.stream.body_texture import INNER
from bendtrack.tracker.synthetic.stream.chain import ENDS, Chain
from bendtrack.tracker.synthetic.trial_looks import trial_look

ANGLES = (-20.0, 3.0, 77.3, 140.0, 220.0)
STRIP = dc.replace(TRAINING, backgrounds=("plain paper",), shapes=("flat strip",), clamps=("block",))


def plain(look):
    """The same body in one grey under flat light on an even table, sharp and without noise."""
    grey = (0.8, 0.8, 0.8)
    return dc.replace(
        look,
        words=dc.replace(look.words, background="studio"),
        body=dc.replace(look.body, swell=0.0, windings=0, layer=0.0, cap="none", tip_round=0.0),
        surface=dc.replace(
            look.surface, colour=grey, layer_colour=grey, opacity=1.0, cavity=0.0, gloss=0.0, grain=0.0,
            roughness=0.0, pattern="none",
        ),
        scene=dc.replace(look.scene, texture=0.0, distractors=0, tube_px=0.0),
        light=dc.replace(
            look.light, ambient=1.0, gradient=0.0, vignette=0.0, shadow=0.0, tint=(1, 1, 1), gain=1.0, gamma=1.0
        ),
        sensor=dc.replace(
            look.sensor, kind="colour", blur_px=0.6, sharpening=0.0, noise=0.0, jpeg_quality=0
        ),
    )  # fmt: skip


def moved(look, shift=(0.0, 0.0), turn_deg=0.0):
    x, y = look.place.base_xy
    place = dc.replace(
        look.place, base_xy=(x + shift[0], y + shift[1]), direction_deg=look.place.direction_deg + turn_deg
    )
    return dc.replace(look, place=place)


def grey(look, angle, **how):
    return Renderer(look).frame(angle, **how).image[..., 1].astype(float)


def ends(look, angle):
    """The two points of each end, (4, 2) px."""
    return Renderer(look).frame(angle).keypoints_xy[ENDS]


@pytest.fixture
def pin_centres(monkeypatch):
    """Centroid of what dark pins, painted on the body's texture at the points of its ends, change in the image."""
    drawn = renderer_module.draw_texture

    def with_pins(body, surface, light, chain, pressure, supersampling, *finish):
        texture = drawn(body, surface, light, chain, pressure, supersampling, *finish)
        v, u = np.indices(texture.rgba.shape[:2])
        s, t = texture.s0 + u / texture.per_px, (v / texture.per_half - INNER) * body.half_px
        # Not at the clamp's face or the body's end, which would cut them.
        for place in chain.keypoint_s[ENDS] + (8, 0, 0, -8):
            pin = np.clip((3.5 - np.hypot(s - place, t)) / 1.5, 0, 1)[..., None]
            texture.rgba[..., :3] = np.round(texture.rgba[..., :3] * (1 - pin))
        return texture

    def centres(look, angle, **how):
        before = grey(look, angle, **how)
        with monkeypatch.context() as patched:
            patched.setattr(renderer_module, "draw_texture", with_pins)
            change = before - grey(look, angle, **how)
        found = []
        for x, y in np.round(pins(look, angle)).astype(int):
            rows, columns = np.mgrid[y - 7 : y + 8, x - 7 : x + 8]
            weight = change[y - 7 : y + 8, x - 7 : x + 8]
            found.append(((weight * columns).sum() / weight.sum(), (weight * rows).sum() / weight.sum()))
        return np.array(found)

    return centres


def pins(look, angle):
    """Where the pins are by the truth: 8 px inward of the outer points, (4, 2) px."""
    xy = ends(look, angle)
    inward = np.array([xy[1] - xy[0], [0, 0], [0, 0], xy[2] - xy[3]])
    length = np.maximum(np.hypot(*inward.T), 1)[:, None]
    return xy + 8 * inward / length


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("angle", ANGLES)
def test_keypoints_lie_on_the_pins(seed, angle, pin_centres):
    look = plain(trial_look(seed, families=STRIP))
    assert np.abs(pin_centres(look, angle) - pins(look, angle)).max() < 0.05


@pytest.mark.parametrize("shift", [(0.25, 0.0), (0.0, 0.5), (-0.4, 0.3)])
def test_image_follows_a_shift_below_a_pixel(shift, pin_centres):
    look = plain(trial_look(4, families=STRIP))
    before, after = pin_centres(look, 90.0), pin_centres(moved(look, shift), 90.0)
    np.testing.assert_allclose(after - before, np.broadcast_to(shift, before.shape), atol=0.03)


def test_image_follows_a_turn(pin_centres):
    look = plain(trial_look(4, families=STRIP))
    turned = moved(look, turn_deg=13.3)
    vectors = [np.diff(pin_centres(each, 90.0), axis=0)[[0, 2]] for each in (look, turned)]
    headings = [np.degrees(np.arctan2(v[:, 1], v[:, 0])) for v in vectors]
    np.testing.assert_allclose((headings[1] - headings[0] + 180) % 360 - 180, 13.3, atol=0.1)


def test_motion_blurs_around_the_truth(pin_centres):
    look = plain(trial_look(4, families=STRIP))
    assert (grey(look, 90.0) != grey(look, 90.0, sweep_deg=1.2)).any()
    sharp, blurred = pin_centres(look, 90.0), pin_centres(look, 90.0, sweep_deg=1.2)
    np.testing.assert_allclose(blurred[3], sharp[3], atol=0.05)


def coverage(look, angle):
    """What the body leaves of the background, from two images on white and on black."""
    white, black = (
        grey(dc.replace(look, scene=dc.replace(look.scene, colour=(c, c, c))), angle) for c in (0.95, 0.05)
    )
    # The table is not equally bright everywhere: what it is nearby counts.
    free = cv2.dilate(white - black, np.ones((61, 61)))
    return 1 - (white - black) / free


def half_way(image, start, direction, reach=3.0):
    """Where the image crosses one half on a short line, px from `start` along `direction`."""
    offset = np.arange(-reach, reach, 0.02)
    points = (start + offset[:, None] * direction).astype(np.float32)
    profile = cv2.remap(image.astype(np.float32), points[None, :, 0], points[None, :, 1], cv2.INTER_LINEAR)[0]
    return offset[np.argmin(np.abs(profile - 0.5))]


@pytest.mark.parametrize("angle", ANGLES)
def test_outline_lies_where_the_midline_says(angle):
    """The body's inner edge is half its thickness from the midline, all along the bend."""
    look = plain(trial_look(8, families=STRIP))
    cover = coverage(look, angle)
    chain = Chain(look.body, look.place, angle)
    errors = []
    for s in np.linspace(chain.keypoint_s[1], chain.length_px - 10, 25):
        half = float(chain.half_px_at(np.array(s)))
        on_edge = chain.point(s, -half)
        errors.append(half_way(cover, on_edge, chain.point(s, -half - 1) - on_edge))
    assert abs(np.mean(errors)) < 0.05
    assert np.std(errors) < 0.1


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("angle", [-20.0, 0.0, 45.0, 180.0, 220.0])
def test_angle_is_the_turn_of_the_midline(seed, angle):
    """Against numeric tangents of the dense midline, added up so that nothing wraps."""
    look = trial_look(seed)
    chain = Chain(look.body, look.place, angle)
    steps = np.diff(chain.point(np.linspace(0, chain.length_px, 4001)), axis=0)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    turn = look.place.side * np.degrees(heading[-1] - heading[0])
    assert turn == pytest.approx(angle, abs=1e-6)
    assert np.hypot(*steps.T).sum() == pytest.approx(chain.length_px, abs=1e-3)


@pytest.mark.parametrize("shape", ["fast chambers", "flat strip", "bellows"])
@pytest.mark.parametrize("length", [25.0, 40.0, 60.0])
def test_end_vectors_have_their_length_and_the_ends_direction(shape, length):
    look = trial_look(5, end_vector_px=length, families=dc.replace(TRAINING, shapes=(shape,)))
    renderer = Renderer(look)
    for angle in ANGLES:
        vectors = np.diff(renderer.frame(angle).keypoints_xy[ENDS], axis=0)[[0, 2]]
        np.testing.assert_allclose(np.hypot(*vectors.T), length, atol=1e-9)
        heading = np.degrees(np.arctan2(vectors[:, 1], vectors[:, 0]))
        turn = look.place.side * (heading[1] - heading[0])
        assert (turn - angle + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_body_coordinates_invert_point():
    look = trial_look(6)
    rng = np.random.default_rng(0)
    for angle in (-20.0, 0.0, 0.001, 100.0, 220.0):
        chain = Chain(look.body, look.place, angle)
        s = rng.uniform(-5, chain.length_px, 200)
        t = rng.uniform(-look.body.half_px, look.body.half_px, 200)
        xy = chain.point(s, t)
        piece = np.clip(np.searchsorted(chain.s, s, side="right") - 1, 0, None)
        back_s, back_t = chain.body_coordinates(xy[:, 0], xy[:, 1], piece)
        np.testing.assert_allclose(back_s, s, atol=1e-4)
        np.testing.assert_allclose(back_t, t, atol=1e-6)


@pytest.mark.parametrize("seed", range(30))
def test_keypoints_stay_in_the_image(seed):
    look = trial_look(seed, end_vector_px=[25.0, 40.0, 60.0][seed % 3])
    for angle in np.linspace(-20, 220, 13):
        chain = Chain(look.body, look.place, angle)
        xy = chain.point(chain.keypoint_s[ENDS])
        assert (xy > 5).all()
        assert (xy < np.array(look.size_wh) - 6).all()


@pytest.mark.parametrize("seed", range(12))
def test_nothing_lies_over_the_keypoints(seed):
    """Neither the clamp nor the body itself, by what the renderer says that it drew."""
    renderer = Renderer(trial_look(seed, end_vector_px=[25.0, 40.0, 60.0][seed % 3]))
    for angle in (-20.0, 100.0, 190.0, 220.0):
        assert renderer.frame(angle).visible[ENDS].all()


def test_bases_point_everywhere_and_bend_both_ways():
    places = [trial_look(seed).place for seed in range(60)]
    quadrants = {int(place.direction_deg // 90) for place in places}
    assert quadrants == {0, 1, 2, 3}
    assert {place.side for place in places} == {-1, 1}


def test_the_base_and_the_scene_stand_still():
    look = trial_look(9)
    look = dc.replace(look, sensor=dc.replace(look.sensor, jpeg_quality=0))
    renderer = Renderer(look)
    frames = [renderer.frame(angle) for angle in (0.0, 60.0, 150.0)]
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.keypoints_xy[:2], frames[0].keypoints_xy[:2])
    far = np.ones(look.size_wh[::-1], bool)
    for frame in frames:
        for x, y in frame.midline_xy:
            cv2.circle(canvas := far.astype(np.uint8), (round(x), round(y)), 120, 0, -1)
            far &= canvas.astype(bool)
    assert far.any()
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.image[far], frames[0].image[far])


def test_pressure_swells_the_chambers_and_leaves_the_keypoints():
    look = trial_look(2, families=dc.replace(TRAINING, shapes=("separated chambers",)))
    renderer = Renderer(dc.replace(look, body=dc.replace(look.body, swell=0.3)))
    low, high = renderer.frame(60.0, 0.0), renderer.frame(60.0, 1.0)
    np.testing.assert_array_equal(low.keypoints_xy, high.keypoints_xy)
    assert (low.image != high.image).mean() > 0.005


def test_a_seed_is_a_look():
    assert trial_look(7) == trial_look(7)
    assert trial_look(7) != trial_look(8)
    renderer = Renderer(trial_look(7))
    first, again, other = (renderer.frame(50.0, noise_seed=s).image for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_look_survives_json():
    look = trial_look(3)
    assert Look.from_dict(json.loads(json.dumps(dc.asdict(look)))) == look


def test_what_cannot_be_drawn_is_refused():
    with pytest.raises(BendtrackError, match="translucent white, white, pigmented"):
        trial_look(0, families=dc.replace(TRAINING, materials=("steel",)))
    with pytest.raises(BendtrackError, match="leave room"):
        trial_look(0, end_vector_px=300.0)
