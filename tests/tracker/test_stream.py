"""The stream's truth agrees with its pictures, measured by means that know nothing of the renderer."""

import dataclasses as dc

import cv2
import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition, bending_angle
from bendtrack.tracker.synthetic.stream import (
    HELD_OUT,
    KEYPOINTS,
    TRAINING,
    Renderer,
    before_other_background,
    draw,
    drawn_look,
    in_other_light,
    inflation_deg,
)
from bendtrack.tracker.synthetic.stream.chain import Projection, opposite
from bendtrack.tracker.synthetic.stream.look import View

EVEN = dc.replace(
    TRAINING, shapes=("fibre tube", "flat strip", "PneuFlex"), materials=("white",), clamps=("clip",)
)
FAMILIES = ("material", "background", "shape", "clamp")


@pytest.fixture(scope="module")
def drawn():
    """The beginning of a stream."""
    return [draw(11, index) for index in range(90)]


def frontal(look, lens=0.0):
    return dc.replace(
        look, view=dc.replace(look.view, tilt_x_deg=0.0, tilt_y_deg=0.0, nearness=0.0, lens=lens)
    )


def stark(look):
    """The same body black under even light on white, everything else white too, sharp and without noise."""
    black, white = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    words = dc.replace(look.words, background="studio")
    body = dc.replace(look.body, swell=0.0, windings=0, layer=0.0, cap="none")
    surface = dc.replace(look.surface, colour=black, opacity=1.0, gloss=0.0, cavity=0.0)
    place = dc.replace(look.place, second_arm=None)
    scene = dc.replace(
        look.scene, colour=white, texture=0.0, distractors=0, occluders=0, tube_px=0.0, clamp_colour=white
    )
    light = dc.replace(
        look.light,
        ambient=1.0,
        tint=white,
        gradient=0.0,
        vignette=0.0,
        shadow=0.0,
        gain=1.0,
        gamma=1.0,
        drift=0.0,
    )
    return dc.replace(
        look,
        words=words,
        body=body,
        surface=surface,
        place=place,
        scene=scene,
        light=light,
        sensor=clear(look),
    )


def clear(look):
    """A camera that does nothing."""
    blur = {"blur_px": 0.0, "motion_px": 0.0, "sharpening": 0.0}
    return dc.replace(look.sensor, kind="colour", noise=0.0, jpeg_quality=0, h264_crf=0, shrink=1.0, **blur)


def darkness(sample):
    return 1 - sample.image.astype(np.float32).mean(axis=2) / sample.image.max()


def along_line(image, centre, direction, reach):
    """Values at steps of a tenth of a px from -reach to reach."""
    steps = np.arange(-reach, reach + 0.05, 0.1)
    points = (np.asarray(centre) + steps[:, None] * direction).astype(np.float32)
    return steps, cv2.remap(image, points[None, :, 0], points[None, :, 1], cv2.INTER_LINEAR)[0]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("bend", [-50.0, 20.0, 150.0])
def test_midline_is_the_middle_of_what_is_drawn(seed, bend):
    look = stark(drawn_look(seed, families=EVEN, bend_deg=(-50, 150), size_wh=(400, 300)))
    sample = Renderer(look).frame(bend)
    image = darkness(sample)
    reach = 2.2 * look.body.half_px
    for index in range(12, 80, 6):
        step = sample.midline_xy[index + 1] - sample.midline_xy[index - 1]
        normal = np.array([-step[1], step[0]]) / np.hypot(*step)
        steps, values = along_line(image, sample.midline_xy[index], normal, reach)
        assert values.max() > 0.6
        # Another part of a curled body may come within reach: what is joined to the middle counts.
        dark = values > 0.5
        middle = len(dark) // 2
        assert dark[middle]
        low = middle - np.argmin(dark[middle::-1])
        high = middle + np.argmin(dark[middle:])
        if dark[0] or dark[-1]:
            continue
        assert abs(steps[low] + steps[high]) / 2 < 0.25


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("bend", [-50.0, 20.0, 110.0])
def test_body_begins_at_base_1_and_ends_at_tip_2(seed, bend):
    look = stark(drawn_look(seed, families=EVEN, bend_deg=(-50, 110), size_wh=(400, 300)))
    sample = Renderer(look).frame(bend)
    image, points = darkness(sample), sample.keypoints_xy
    for end, inside in ((8, 7), (0, 1)):
        outward = points[end] - points[inside]
        steps, values = along_line(image, points[end], outward / np.hypot(*outward), 3.0)
        edge = steps[np.argmax(values < 0.5)]
        assert abs(edge) < 0.7, (end, edge)


def test_angle_is_that_of_the_two_vectors(drawn):
    definition = AngleDefinition("two-vector", KEYPOINTS)
    for sample in drawn + [draw(11, index, families=HELD_OUT) for index in range(20)]:
        angle = bending_angle(sample.keypoints_xy[None], KEYPOINTS, definition)[0]
        assert abs(sample.angle_deg - angle[0]) < 1e-6
    angles = [sample.angle_deg for sample in drawn]
    assert min(angles) < -180
    assert max(angles) > 180


@pytest.mark.parametrize("bend", [-60.0, 0.0, 33.0, 181.0, 270.0])
def test_seen_from_the_front_the_angle_is_the_bend(bend):
    look = frontal(drawn_look(3, bend_deg=(-60, 270), size_wh=(200, 160)))
    sample = Renderer(look).frame(bend)
    assert abs(sample.angle_deg - look.place.side * bend) < 1e-6
    first, last = (
        np.diff(sample.keypoints_xy[[0, 1]], axis=0)[0],
        np.diff(sample.keypoints_xy[[7, 8]], axis=0)[0],
    )
    heading = np.degrees(np.arctan2(first[1], first[0]))
    assert abs((heading - look.place.direction_deg + 180) % 360 - 180) < 1e-6
    turn = np.degrees(np.arctan2(last[1], last[0])) - heading - look.place.side * bend
    assert abs((turn + 180) % 360 - 180) < 1e-6


def test_keypoints_lie_on_the_midline_in_order(drawn):
    for sample in drawn:
        distance = np.hypot(*(sample.midline_xy[:, None] - sample.keypoints_xy[None]).transpose(2, 0, 1))
        nearest = distance.argmin(axis=0)
        assert (np.diff(nearest) > 0).all()
        assert distance.min(axis=0).max() < 0.02 * np.hypot(*np.diff(sample.midline_xy, axis=0).T).sum()
        np.testing.assert_allclose(sample.keypoints_xy[[0, 8]], sample.midline_xy[[0, -1]], atol=1e-9)


@pytest.mark.parametrize("lens", [-0.3, 0.0, 0.25])
def test_the_lens_and_the_tilt_have_an_inverse(lens):
    projection = Projection(View(15.0, -11.0, 0.7, lens), (256, 192))
    plane = np.random.default_rng(0).uniform((20, 20), (230, 170), (50, 2))
    seen = projection.to_image(plane)
    assert np.abs(seen - plane).max() > 1
    back = np.stack(projection.to_plane(*seen.T), axis=1)
    np.testing.assert_allclose(back, plane, atol=1e-8)


def test_a_sample_depends_on_seed_and_index_alone():
    first = draw(5, 3)
    draw(5, 4)
    again = draw(5, 3)
    assert first.look == again.look
    np.testing.assert_array_equal(first.image, again.image)
    np.testing.assert_array_equal(first.midline_xy, again.midline_xy)
    others = [draw(5, 4), draw(6, 3)]
    assert all(np.abs(first.keypoints_xy - other.keypoints_xy).max() > 3 for other in others)
    assert first.image.dtype == np.uint8
    assert first.image.shape == (256, 256, 3)


def test_families_never_mix():
    used = {}
    for families in (TRAINING, HELD_OUT):
        looks = [drawn_look(1, index, families=families, bend_deg=(30, 30)) for index in range(250)]
        looks += [before_other_background(look, 1) for look in looks[:50]]
        for name in FAMILIES:
            seen = {getattr(look.words, name) for look in looks}
            assert seen == set(getattr(families, f"{name}s"))
            used.setdefault(name, []).append(seen)
    for name in FAMILIES:
        assert not used[name][0] & used[name][1]
    # A word that is held out, and one that is not, draw what they say.
    assert draw(1, 0, families=HELD_OUT).look.families == HELD_OUT


def test_what_an_occluder_covers_is_not_visible():
    hidden = 0
    for index in range(20):
        look = drawn_look(8, index, bend_deg=(40, 40), size_wh=(256, 256))
        look = dc.replace(look, place=dc.replace(look.place, second_arm=None))
        look = dc.replace(look, sensor=clear(look))
        free, covered = (
            Renderer(dc.replace(look, scene=dc.replace(look.scene, occluders=count))).frame(40)
            for count in (0, 1)
        )
        if not free.visible.all():
            continue
        change = np.abs(free.image.astype(int) - covered.image).max(axis=2)
        for point, visible in zip(covered.keypoints_xy, covered.visible, strict=True):
            x, y = np.round(point).astype(int)
            around = change[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
            if not visible:
                assert around.max() > 0
                hidden += 1
            elif around.min() > 40:
                # A thrown shadow darkens, but leaves the body to be seen; nothing bright appears.
                before, after = free.image[y, x].astype(int), covered.image[y, x].astype(int)
                assert (after <= before + 12).all(), (index, point)
    assert hidden > 8


def test_what_lies_outside_is_not_visible(drawn):
    outside = 0
    for sample in drawn:
        x, y = sample.keypoints_xy.T
        out = (x < -0.5) | (y < -0.5) | (x > 255.5) | (y > 255.5)
        assert not sample.visible[out].any()
        outside += out.sum()
    assert outside > 10


def test_a_body_over_itself_hides_the_half_behind():
    changed = seen = 0
    for index in range(40):
        look = stark(drawn_look(10, index, families=EVEN, bend_deg=(268, 268), size_wh=(200, 200)))
        # The tip is of another colour than the rest.
        look = dc.replace(
            look,
            body=dc.replace(look.body, cap="cap", cap_share=0.1),
            surface=dc.replace(look.surface, cap_colour=(1.0, 0.1, 0.1)),
        )
        over, under = (
            Renderer(dc.replace(look, body=dc.replace(look.body, tip_over=tip_over))).frame(268)
            for tip_over in (True, False)
        )
        # Turned over, what lies before and what behind change places.
        assert over.visible[5:].sum() >= under.visible[5:].sum()
        assert over.visible[:4].sum() <= under.visible[:4].sum()
        changed += int((over.visible != under.visible).any())
        if over.visible[8] and not under.visible[8]:
            inside = over.keypoints_xy[8] + 0.1 * (over.keypoints_xy[7] - over.keypoints_xy[8])
            (x, y), (u, v) = np.round([inside, under.keypoints_xy[8]]).astype(int)
            assert over.image[y, x, 0] > 100
            assert under.image[v - 1 : v + 2, u - 1 : u + 2, 0].min() < 60
            seen += 1
    assert changed >= 3
    assert seen >= 1


def test_mirrored_and_enlarged_looks_keep_their_truth():
    look = frontal(drawn_look(4, families=EVEN, bend_deg=(90, 90), size_wh=(240, 200)))
    look = stark(dc.replace(look, body=dc.replace(look.body, base_share=0.1)))
    (x, y), place = look.place.base_xy, look.place
    sample = Renderer(look).frame(90)
    flipped = dc.replace(
        place, base_xy=(239 - x, y), direction_deg=180 - place.direction_deg, side=-place.side
    )
    mirrored = Renderer(dc.replace(look, place=flipped)).frame(90)
    np.testing.assert_allclose(mirrored.keypoints_xy, (239, 0) + sample.keypoints_xy * (-1, 1), atol=1e-9)
    assert abs(mirrored.angle_deg + sample.angle_deg) < 1e-9
    body_there = np.abs(darkness(mirrored)[:, ::-1] - darkness(sample))
    assert (body_there > 0.5).mean() < 0.002
    double = dc.replace(
        look,
        size_wh=(480, 400),
        body=dc.replace(look.body, length_px=2 * look.body.length_px, half_px=2 * look.body.half_px),
        place=dc.replace(place, base_xy=(2 * x + 0.5, 2 * y + 0.5)),
    )
    enlarged = Renderer(double).frame(90)
    np.testing.assert_allclose(enlarged.keypoints_xy, 2 * sample.keypoints_xy + 0.5, atol=1e-9)
    small = cv2.resize(darkness(enlarged), (240, 200), interpolation=cv2.INTER_AREA)
    assert (np.abs(small - darkness(sample)) > 0.5).mean() < 0.002


def test_a_video_moves_the_tip_and_leaves_the_base():
    look = drawn_look(2, families=HELD_OUT, bend_deg=(0, 200), size_wh=(160, 120))
    renderer, bends = Renderer(look), inflation_deg(look, 9)
    assert bends[0] == bends[-1] == 0
    assert bends[4] == 200
    samples = [renderer.frame(bend, noise_seed=index) for index, bend in enumerate(bends)]
    base = np.array([sample.keypoints_xy[:2] for sample in samples])
    assert np.ptp(base, axis=0).max() < 1e-9
    assert np.hypot(*(samples[4].keypoints_xy[8] - samples[0].keypoints_xy[8])) > 0.5 * look.body.length_px
    angles = [abs(sample.angle_deg) for sample in samples]
    assert (np.diff(angles[:5]) > 0).all()
    # Same angle, other noise.
    assert 0 < np.abs(samples[0].image.astype(int) - samples[-1].image).mean() < 25
    np.testing.assert_array_equal(Renderer(look).frame(bends[3], noise_seed=3).image, samples[3].image)


def test_exposure_drifts_during_a_film_up_and_down_and_moves_nothing():
    steady = stark(drawn_look(4, families=EVEN, bend_deg=(0, 90), size_wh=(200, 160)))
    grey = dc.replace(steady, scene=dc.replace(steady.scene, colour=(0.5, 0.5, 0.5)))
    drifting = dc.replace(grey, light=dc.replace(grey.light, drift=0.2))
    renderer, moments = Renderer(drifting), np.linspace(0, 1, 40)
    samples = [renderer.frame(30.0, moment=float(moment)) for moment in moments]
    bright = np.array([np.median(sample.image) for sample in samples])
    usual = float(np.median(Renderer(grey).frame(30.0, moment=0.7).image))
    assert bright.max() > 1.1 * usual
    assert bright.min() < 0.9 * usual
    assert 0.79 * usual < bright.min()
    assert bright.max() < 1.21 * usual
    assert np.abs(np.diff(bright)).max() < 0.1 * usual  # not from frame to frame
    assert np.median(renderer.frame(30.0).image) == usual  # a single picture is exposed as its look says
    for sample in samples:
        np.testing.assert_array_equal(sample.keypoints_xy, samples[0].keypoints_xy)


def test_a_gripper_shows_two_arms_and_that_with_the_tip_nearer_the_middle_is_meant():
    shown = 0
    for index in range(100):
        look = drawn_look(5, index, families=EVEN, bend_deg=(40, 40), size_wh=(400, 300))
        second = opposite(look.place)
        if second is None:
            continue
        alone = stark(look)
        one, both, other = (
            Renderer(dc.replace(alone, place=place)).frame(40.0)
            for place in (alone.place, look.place, second)
        )
        np.testing.assert_array_equal(both.keypoints_xy, one.keypoints_xy)
        dark = [darkness(sample) > 0.5 for sample in (one, both, other)]
        parts = cv2.connectedComponentsWithStats(dark[1].astype(np.uint8))[2][1:, cv2.CC_STAT_AREA]
        if len(parts) != 2 or parts.min() < 0.5 * parts.max():
            continue  # they touch, or the picture's edge cuts one
        # Each arm lies where it would lie alone, and nothing else does.
        assert (dark[1] != (dark[0] | dark[2])).mean() < 1e-3
        middle = (np.array(look.size_wh) - 1) / 2
        tips = [np.hypot(*(sample.keypoints_xy[8] - middle)) for sample in (both, other)]
        assert tips[0] < tips[1]
        shown += 1
    assert shown >= 5


def test_what_lies_over_the_body_does_not_move_with_it():
    look = drawn_look(8, 1, bend_deg=(0, 160), size_wh=(256, 256))
    look = dc.replace(look, sensor=clear(look), place=dc.replace(look.place, second_arm=None))
    changes = []
    for bend in (0, 160):
        free, covered = (
            Renderer(dc.replace(look, scene=dc.replace(look.scene, occluders=count))).frame(bend).image
            for count in (0, 1)
        )
        changes.append(np.abs(free.astype(int) - covered).max(axis=2) > 40)
    assert changes[0].sum() > 200
    # Where the body is before it, or behind it, less or more of it stands out.
    assert (changes[0] & changes[1]).sum() > 0.6 * (changes[0] | changes[1]).sum()


@pytest.mark.parametrize("change", [in_other_light, before_other_background])
def test_other_light_and_background_leave_the_body_where_it_is(change):
    look = drawn_look(6, bend_deg=(0, 150), size_wh=(160, 120))
    before, after = Renderer(look).frame(75), Renderer(change(look, 3)).frame(75)
    np.testing.assert_array_equal(before.keypoints_xy, after.keypoints_xy)
    assert after.look.body == look.body
    assert after.look.surface == look.surface
    assert np.abs(before.image.astype(int) - after.image).mean() > 5


def test_bodies_are_of_the_sizes_that_were_asked_for(drawn):
    share = []
    for sample in drawn:
        share.append(np.ptp(sample.midline_xy, axis=0).max() / 256)
        body = sample.look.body
        assert 2 <= body.length_px / (2 * body.half_px) <= 26
    assert min(share) > 0.12
    assert max(share) < 1.1
    assert np.percentile(share, 90) > 0.6


def middle_of_the_dark(sample):
    weight = np.clip((darkness(sample) - 0.3) / 0.4, 0, 1)
    y, x = np.indices(weight.shape)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.parametrize(
    "does",
    [
        {"blur_px": 1.5},
        {"motion_px": 5.0, "motion_deg": 30.0},
        {"sharpening": 0.8},
        {"noise": 3.0, "noise_cell": 1.0},
        {"jpeg_quality": 20},
        {"h264_crf": 40},
        {"shrink": 2.0},
    ],
    ids=lambda does: next(iter(does)),
)
def test_what_the_camera_does_leaves_everything_where_it_is(does):
    look = stark(drawn_look(7, families=EVEN, bend_deg=(0, 90), size_wh=(400, 300)))
    plain = Renderer(look).frame(60.0)
    worse = Renderer(dc.replace(look, sensor=dc.replace(look.sensor, **does))).frame(60.0)
    assert (plain.image != worse.image).any()
    assert np.linalg.norm(middle_of_the_dark(worse) - middle_of_the_dark(plain)) < 0.15
    np.testing.assert_array_equal(worse.keypoints_xy, plain.keypoints_xy)


@pytest.mark.parametrize("kind", ["grey", "infrared"])
def test_a_camera_without_colours_shows_none(kind):
    look = drawn_look(4, families=TRAINING)
    seen = Renderer(dc.replace(look, sensor=dc.replace(clear(look), kind=kind))).frame(60.0).image
    assert np.ptp(seen.astype(int), axis=2).max() == 0
    assert (
        np.ptp(Renderer(dc.replace(look, sensor=clear(look))).frame(60.0).image.astype(int), axis=2).max() > 0
    )


@pytest.mark.parametrize(
    ("part", "changed"),
    [
        ("body", {"layer": 0.25}),
        ("body", {"windings": 12, "slant": 0.4, "crossed": True}),
        ("body", {"cap": "cap", "cap_share": 0.15}),
        ("body", {"cap": "tape", "cap_share": 0.15}),
        ("surface", {"gloss": 0.8, "shininess": 8.0}),
        ("surface", {"opacity": 0.5}),
        ("surface", {"pattern": "weave", "grain": 0.2}),
        ("scene", {"tube_px": 9.0, "tube_colour": (0.8, 0.1, 0.1)}),
        ("light", {"shadow": 0.7, "shadow_px": 14.0, "softness_px": 1.0}),
        ("light", {"tint": (1.1, 1.0, 0.7)}),
        ("light", {"gain": 0.5}),
    ],
    ids=lambda value: value if isinstance(value, str) else next(iter(value)),
)
def test_what_a_body_is_made_of_and_how_it_is_lit_is_seen_and_moves_no_keypoint(part, changed):
    look = stark(drawn_look(4, families=EVEN, bend_deg=(0, 90), size_wh=(400, 300)))
    look = dc.replace(look, surface=dc.replace(look.surface, colour=(0.4, 0.4, 0.4)))
    other = dc.replace(look, **{part: dc.replace(getattr(look, part), **changed)})
    plain, seen = Renderer(look).frame(60.0), Renderer(other).frame(60.0)
    assert (np.abs(seen.image.astype(int) - plain.image).max(axis=2) > 8).mean() > 5e-4
    np.testing.assert_array_equal(seen.keypoints_xy, plain.keypoints_xy)


def test_a_stream_has_something_of_everything():
    looks = [draw(3, index).look for index in range(300)]

    def share(holds):
        return np.mean([holds(look) for look in looks])

    for often, holds in {
        "two arms": lambda look: look.place.second_arm is not None,
        "a strain layer": lambda look: look.body.layer > 0,
        "none": lambda look: look.body.layer == 0,
        "windings": lambda look: look.body.windings > 0,
        "uneven chambers": lambda look: look.body.swell > 0 and look.body.uneven > 0,
        "a cap": lambda look: look.body.cap == "cap",
        "tape": lambda look: look.body.cap == "tape",
        "an S": lambda look: abs(look.body.s_turn_deg) > 20,
        "curvature in one place": lambda look: look.body.focus > 1,
        "curvature nearly everywhere alike": lambda look: look.body.focus < 0.3,
        "a tube": lambda look: look.scene.tube_px > 0,
        "something in the way": lambda look: look.scene.occluders > 0,
        "much lying about": lambda look: look.scene.distractors > 3,
        "hard shadow": lambda look: look.light.shadow > 0.2 and look.light.softness_px < 3,
        "soft shadow": lambda look: look.light.shadow > 0.2 and look.light.softness_px > 6,
        "a colour cast": lambda look: np.ptp(look.light.tint) > 0.1,
        "too dark": lambda look: look.light.gain < 0.85,
        "motion": lambda look: look.sensor.motion_px > 1,
        "out of focus": lambda look: look.sensor.blur_px > 1,
        "coded": lambda look: 0 < look.sensor.jpeg_quality < 60,
        "of a film in H.264": lambda look: look.sensor.h264_crf > 0,
        "exposure that drifts": lambda look: look.light.drift > 0.05,
        "grey": lambda look: look.sensor.kind == "grey",
        "infrared": lambda look: look.sensor.kind == "infrared",
        "tilted": lambda look: abs(look.view.tilt_x_deg) > 10,
        "a bending lens": lambda look: abs(look.view.lens) > 0.02,
    }.items():
        assert share(holds) > 0.02, often
    directions = np.array([look.place.direction_deg for look in looks]) % 360
    assert (np.histogram(directions, 8, (0, 360))[0] > 20).all()
    thickness = np.array([look.body.length_px / look.body.half_px for look in looks]) / 2
    assert thickness.max() > 3 * thickness.min()
