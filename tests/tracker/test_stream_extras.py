"""Extras of the stream: each kind in its share, its truth right by pixels; looks without extras as they ever were."""

from __future__ import annotations

import dataclasses as dc
from collections import Counter
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.synthetic.stream import (
    HELD_OUT,
    KINDS,
    TRAINING,
    Extras,
    Look,
    Renderer,
    Sample,
    draw,
    drawn_look,
)
from bendtrack.tracker.synthetic.stream import renderer as renderer_module
from bendtrack.tracker.synthetic.stream.chain import Chain, Projection
from bendtrack.tracker.synthetic.stream.drawing import BEND_DEG as BEND_RANGE_DEG
from bendtrack.tracker.synthetic.stream.extras_sampling import SHARES, drawn_extras
from bendtrack.tracker.synthetic.stream.families import Families
from bendtrack.tracker.synthetic.stream.look_alike import TUBE_THICKNESS
from bendtrack.tracker.synthetic.stream.rng import Rng

SIZE_WH = (320, 240)
EVEN = dc.replace(
    TRAINING,
    shapes=("fibre tube", "flat strip", "PneuFlex"),
    materials=("white",),
    clamps=("clip", "block"),
    backgrounds=("plain paper",),
)
ON_THE_BODY = ("wrinkled silicone", "rounded tip", "frayed tip", "taped tip", "zip ties")
BEHIND = ("thick tube", "bare metal", "ruled paper", "tape glare")
BEND_DEG = 70.0
BLACK, WHITE = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)


def with_extras(
    kinds: tuple[str, ...], count: int, families: Families = EVEN
) -> Iterator[tuple[Look, Extras]]:
    """The first looks of a stream that have one of these kinds: bodies that are not thin, with one arm unless the kind
    adds another, seen from the front by a camera that does nothing.
    """
    index = -1
    while count:
        index += 1
        look = drawn_look(31, index, size_wh=SIZE_WH, families=families, bend_deg=(BEND_DEG, BEND_DEG))
        if look.body.half_px < 5:
            continue
        look = dc.replace(
            look,
            place=dc.replace(look.place, second_arm=None),
            view=dc.replace(look.view, tilt_x_deg=0.0, tilt_y_deg=0.0, nearness=0.0, lens=0.0),
            scene=dc.replace(look.scene, occluders=0, distractors=0),
            sensor=dc.replace(
                look.sensor, kind="colour", blur_px=0.0, motion_px=0.0, sharpening=0.0, noise=0.0,
                jpeg_quality=0, h264_crf=0, shrink=1.0,
            ),
        )  # fmt: skip
        own, extras = drawn_extras(look, BEND_DEG, kinds, Rng(31, index, 16))
        if extras.kinds:
            count -= 1
            yield own, extras


def stark(look: Look, extras: Extras) -> Sample:
    """Body, ties and tape in black under even light, everything else white."""
    finish = extras.finish
    finish = dc.replace(
        finish,
        streak=0.0,
        ties=tuple(dc.replace(tie, colour=BLACK, tail=0.0) for tie in finish.ties),
        tape=None if finish.tape is None else dc.replace(finish.tape, colour=BLACK, opacity=1.0, glare=0.0),
    )
    body = dc.replace(look.body, swell=0.0, windings=0, layer=0.0, cap="none")
    surface = dc.replace(look.surface, colour=BLACK, opacity=1.0, gloss=0.0, cavity=0.0)
    scene = dc.replace(look.scene, colour=WHITE, texture=0.0, tube_px=0.0, clamp_colour=WHITE)
    light = dc.replace(
        look.light, ambient=1.0, tint=WHITE, gradient=0.0, vignette=0.0, shadow=0.0, gain=1.0, gamma=1.0
    )
    look = dc.replace(
        look,
        words=dc.replace(look.words, background="studio"),
        body=body,
        surface=surface,
        scene=scene,
        light=light,
    )
    return Renderer(look, extras=dc.replace(extras, finish=finish)).frame(BEND_DEG, 0.0)


def darkness_along(
    sample: Sample, centre: np.ndarray, direction: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Steps of a tenth of a px from -reach to reach, and how dark the image is there, 0 to 1."""
    image = 1 - sample.image.astype(np.float32).mean(axis=2) / sample.image.max()
    steps = np.arange(-reach, reach + 0.05, 0.1)
    points = (centre + steps[:, None] * direction / np.hypot(*direction)).astype(np.float32)
    return steps, cv2.remap(image, points[None, :, 0], points[None, :, 1], cv2.INTER_LINEAR)[0]


def at_midline(sample: Sample) -> np.ndarray:
    """The image along the midline, without its ends and what is not in the image, (N, 3)."""
    x, y = np.round(sample.midline_xy[12:-4]).astype(int).T
    width, height = SIZE_WH
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    return sample.image[y[inside], x[inside]].astype(int)


def changed(one: Sample, other: Sample, least: int = 12) -> np.ndarray:
    """Which pixels of two images differ, (H, W)."""
    return np.abs(one.image.astype(int) - other.image).max(axis=2) > least


@pytest.fixture(scope="module")
def sampled() -> list[tuple[Look, Look, Extras]]:
    """Looks like those of the stream, without extras and with them."""
    found = []
    for index in range(500):
        bend = Rng(index, 1).uniform(*BEND_RANGE_DEG)
        look = drawn_look(32, index, size_wh=(256, 256), bend_deg=(bend, bend), partly_out=0.15)
        found.append((look, *drawn_extras(look, bend, KINDS, Rng(32, index, 16))))
    return found


def test_each_kind_occurs_in_about_its_share(sampled: list[tuple[Look, Look, Extras]]) -> None:
    counts = Counter(kind for _, _, extras in sampled for kind in extras.kinds)
    assert set(SHARES) == set(KINDS) == set(counts)
    fits = {"thick tube": 0.8, "cut two-armed body": 0.7}
    for kind, share in SHARES.items():
        assert 0.03 < counts[kind] / len(sampled) < 0.25, kind
        expected = share * fits.get(kind, 1.0)
        assert abs(counts[kind] / len(sampled) - expected) < 3.5 * np.sqrt(expected / len(sampled)), kind
    none = sum(not extras.kinds for _, _, extras in sampled) / len(sampled)
    assert 0.2 < none < 0.4
    assert {extras.base for _, _, extras in sampled} == {"clamp", "bracket", "hub"}


def test_a_kind_that_is_left_out_changes_no_other() -> None:
    same = 0
    for index in range(40):
        look = drawn_look(32, index, size_wh=(256, 256), bend_deg=(50, 50))
        whole = drawn_extras(look, 50.0, KINDS, Rng(32, index, 16))
        for kind in KINDS:
            others = [other for other in KINDS if other != kind]
            if kind not in whole[1].kinds:
                assert drawn_extras(look, 50.0, others, Rng(32, index, 16)) == whole
                same += 1
    assert same > 200
    # And without any, the look is as it was.
    assert drawn_extras(look, 50.0, (), Rng(32, 3, 16))[0] == look


def test_a_body_lies_where_it_lies_without_extras() -> None:
    shown = 0
    for index in range(40):
        plain, rich = draw(33, index), draw(33, index, kinds=KINDS)
        np.testing.assert_array_equal(rich.keypoints_xy, plain.keypoints_xy)
        np.testing.assert_array_equal(rich.midline_xy, plain.midline_xy)
        assert rich.angle_deg == plain.angle_deg
        assert plain.kinds == ()
        assert (rich.image != plain.image).any() == bool(rich.kinds)
        shown += bool(rich.kinds)
    assert shown > 20


@pytest.mark.parametrize("kind", ON_THE_BODY)
def test_with_something_on_it_a_body_ends_where_its_truth_says(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Threads that stick out are no part of the body.
    monkeypatch.setattr(renderer_module, "draw_loose_ends", lambda *_: None)
    seen = 0
    for look, extras in with_extras((kind,), 8):
        sample, thick = stark(look, extras), 2 * look.body.half_px
        if not sample.visible.all():
            continue
        seen += 1
        tip, base = sample.keypoints_xy[8], sample.keypoints_xy[0]
        steps, values = darkness_along(sample, tip, tip - sample.midline_xy[-3], 4.0)
        edge = steps[np.argmax(values < 0.5)]
        assert -1.1 < edge < 0.8
        steps, values = darkness_along(sample, base, base - sample.midline_xy[2], 3.0)
        assert abs(steps[np.argmax(values < 0.5)]) < 0.8
        # The midline is the middle, but for heads of ties and loose ends of tape.
        ties = [tie.at for tie in extras.finish.ties]
        stop = 1 - max(extras.finish.fray, extras.finish.tape.share if extras.finish.tape else 0.0, 0.2)
        for share in np.arange(0.15, stop, 0.08):
            if any(abs(share - at) * look.body.length_px < thick for at in ties):
                continue
            index = round(share * 95)
            step = sample.midline_xy[index + 1] - sample.midline_xy[index - 1]
            steps, values = darkness_along(
                sample, sample.midline_xy[index], np.array([-step[1], step[0]]), thick
            )
            dark = steps[values > 0.5]
            assert abs(dark[0] + dark[-1]) / 2 < 0.3
    assert seen >= 5


def test_what_is_on_a_body_is_to_be_seen() -> None:
    for kind in ON_THE_BODY:
        for look, extras in with_extras((kind,), 4):
            bare = dc.replace(extras, finish=Extras().finish)
            with_it = Renderer(look, extras=extras).frame(BEND_DEG)
            without = Renderer(dc.replace(look, body=dc.replace(look.body, tip_round=0.1)), extras=bare)
            where = changed(with_it, without.frame(BEND_DEG), 8)
            assert where.sum() > 8, kind
            # It is near the body.
            distance = np.hypot(*(np.argwhere(where)[:, None, ::-1] - with_it.midline_xy).transpose(2, 0, 1))
            assert np.percentile(distance.min(axis=1), 90) < 2.5 * look.body.half_px + 4


def test_tie_and_tape_have_their_colour_where_they_are() -> None:
    red = (0.9, 0.05, 0.05)
    for kind in ("zip ties", "taped tip"):
        for look, extras in with_extras((kind,), 4):
            finish = extras.finish
            ties = tuple(dc.replace(tie, colour=red, head_v=0.5) for tie in finish.ties)
            tape = finish.tape and dc.replace(finish.tape, colour=red, opacity=1.0, glare=0.0)
            coloured = dc.replace(extras, finish=dc.replace(finish, ties=ties, tape=tape))
            look = dc.replace(look, body=dc.replace(look.body, windings=0, cap="none"))
            sample, bare = (Renderer(look, extras=each).frame(BEND_DEG) for each in (coloured, Extras()))
            red_there, red_before = (
                each.image[..., 0].astype(int) - each.image[..., 1] > 50 for each in (sample, bare)
            )
            places = [tie.at for tie in ties] + ([1 - 0.5 * tape.share] if tape else [])
            for at in places:
                x, y = np.round(sample.midline_xy[round(at * 95)]).astype(int)
                assert red_there[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].any(), (kind, at)
            assert (red_there & ~red_before).mean() < 0.05


def test_silicone_is_white_and_wrinkled_and_reflects_in_streaks(
    sampled: list[tuple[Look, Look, Extras]],
) -> None:
    shown = [(look, extras) for _, look, extras in sampled if "wrinkled silicone" in extras.kinds]
    for look, _ in shown:
        # A tint, or a clearer body, would be of the held-out material.
        assert np.ptp(look.surface.colour) < 0.08
        assert look.surface.opacity >= 0.72
        assert look.words.material == "translucent white"
    assert np.mean([extras.finish.crease_px > 0 for _, extras in shown]) > 0.5
    for look, extras in with_extras(("wrinkled silicone",), 6):
        if extras.finish.streak < 0.5:
            continue
        dull = dc.replace(extras, finish=dc.replace(extras.finish, streak=0.0))
        bright, plain = (
            Renderer(look, extras=each).frame(BEND_DEG).image.astype(int) for each in (extras, dull)
        )
        assert (bright - plain).max() > 20
        # A streak lights and never darkens.
        assert (bright - plain).min() >= -3


@pytest.mark.parametrize("kind", BEHIND)
def test_what_lies_behind_a_body_hides_nothing_of_it(kind: str) -> None:
    for look, extras in with_extras((kind,), 6):
        extras = dc.replace(extras, base="clamp", metals=max(extras.metals, kind == "bare metal"))
        rich, plain = Renderer(look, extras=extras).frame(BEND_DEG), Renderer(look).frame(BEND_DEG)
        assert changed(rich, plain).mean() > 0.003
        assert np.abs(at_midline(rich) - at_midline(plain)).max() <= 3
        np.testing.assert_array_equal(rich.visible, plain.visible)


def test_a_tube_is_as_thick_as_the_body_and_has_no_free_end() -> None:
    ended = 0
    for look, extras in with_extras(("thick tube",), 25, TRAINING):
        (tube,) = extras.bystanders
        assert tube.look.surface == look.surface
        assert tube.look.body.valley in ("none", "wave")
        thickness = tube.look.body.half_px / look.body.half_px
        assert TUBE_THICKNESS[0] <= thickness <= TUBE_THICKNESS[1]
        assert tube.bend_deg >= 10
        chain = Chain(tube.look.body, tube.look.place, tube.bend_deg)
        inside = ((chain.end_xy > 0) & (chain.end_xy < np.array(SIZE_WH) - 1)).all()
        fitted = [np.hypot(*(np.array(end.xy) - chain.end_xy)) < 1 for end in extras.fittings]
        assert not inside or any(fitted)
        ended += len(extras.fittings)
    assert ended > 3


def test_a_tube_keeps_off_the_body() -> None:
    for look, extras in with_extras(("thick tube",), 15, TRAINING):
        (tube,) = extras.bystanders
        own = Chain(look.body, look.place, BEND_DEG)
        other = Chain(tube.look.body, tube.look.place, tube.bend_deg)
        line = other.point(np.linspace(0, other.length_px, 200))
        far = own.point(np.linspace(0.35, 1, 100) * own.length_px)
        apart = np.hypot(*(line[:, None] - far).transpose(2, 0, 1)).min()
        assert apart > look.body.half_px + tube.look.body.half_px


@pytest.mark.parametrize("base", ["bracket", "hub"])
def test_what_holds_the_body_ends_where_the_body_begins(base: str) -> None:
    for look, extras in with_extras(("bare metal",), 6):
        extras = dc.replace(extras, metals=0)
        # Where a clamp and what stands in for it differ is behind the face that both share.
        one, other = (
            Renderer(look, extras=dc.replace(extras, base=word)).frame(BEND_DEG) for word in ("clamp", base)
        )
        heading = np.radians(look.place.direction_deg)
        along = np.array([np.cos(heading), np.sin(heading)])
        reach = (np.argwhere(changed(one, other, 25))[:, ::-1] - one.keypoints_xy[0]) @ along
        assert len(reach) > 10
        assert reach.max() < 1.5
        assert reach.min() < -look.body.half_px
        assert other.visible[0] == one.visible[0]


def test_a_second_arm_is_cut_by_the_edge_and_the_labelled_one_is_whole() -> None:
    hubs = 0
    for look, extras in with_extras(("cut two-armed body",), 12, dc.replace(EVEN, clamps=("block",))):
        (arm,) = extras.bystanders
        alone = dc.replace(extras, bystanders=())
        both, one = (
            Renderer(look, extras=extras).frame(BEND_DEG),
            Renderer(look, extras=alone).frame(BEND_DEG),
        )
        width, height = np.array(SIZE_WH) - 1
        end = Projection(look.view, SIZE_WH).to_image(
            Chain(arm.look.body, arm.look.place, arm.bend_deg).end_xy
        )
        assert not ((end > 0) & (end < (width, height))).all()
        (x, y), (u, v) = both.keypoints_xy[[0, 8]]
        assert 0 <= min(x, u) <= max(x, u) <= width
        assert 0 <= min(y, v) <= max(y, v) <= height
        there = changed(both, one)
        # It reaches the edge of the image, and hides nothing of the arm.
        assert there[[0, 1, -2, -1]].any() or there[:, [0, 1, -2, -1]].any()
        assert there.sum() > look.body.half_px**2
        assert np.abs(at_midline(both) - at_midline(one)).max() <= 3
        np.testing.assert_array_equal(both.visible, one.visible)
        assert look.place.second_arm is None
        hubs += extras.base == "hub"
    assert 1 <= hubs <= 11


def test_a_second_arm_rests_or_bends(sampled: list[tuple[Look, Look, Extras]]) -> None:
    arms = [extras.bystanders[0] for _, _, extras in sampled if "cut two-armed body" in extras.kinds]
    at_rest = np.mean([abs(arm.bend_deg) <= 10 for arm in arms])
    assert 0.2 < at_rest < 0.8
    assert all(abs(arm.bend_deg) <= 10 or 20 <= arm.bend_deg <= 150 for arm in arms)


def test_extras_have_no_word_of_a_held_out_family(sampled: list[tuple[Look, Look, Extras]]) -> None:
    for plain, look, extras in sampled:
        for name, word in vars(look.words).items():
            assert word in getattr(TRAINING, f"{name}s")
            assert word == getattr(plain.words, name) or name == "material"
        for each in (look, *(other.look for other in extras.bystanders)):
            assert each.surface.pattern != "specks"
            assert each.body.valley not in ("saw", "joint")


@pytest.mark.parametrize(
    ("stream", "families", "index", "ends_xy", "grey"),
    [
        (777, HELD_OUT, 0, [193.59, 64.04, 308.68, 435.72],
         [65.4, 62.9, 61.7, 70.5, 40.3, 57.7, 50.9, 22.7, 35.2, 53.0, 47.8, 31.7]),
        (777, HELD_OUT, 3, [297.89, 432.89, 428.96, 50.1],
         [154.8, 126.2, 96.7, 109.8, 136.8, 89.4, 102.1, 110.6, 110.1, 82.1, 101.7, 112.2]),
        (777, HELD_OUT, 5, [254.86, 100.27, 439.18, 430.32],
         [69.5, 91.1, 53.5, 32.9, 56.1, 148.9, 74.3, 37.4, 51.7, 56.6, 62.9, 34.7]),
        (778, TRAINING, 0, [284.75, 272.14, 518.19, 130.34],
         [156.1, 188.9, 216.1, 221.2, 155.1, 169.6, 167.7, 219.1, 152.0, 184.1, 214.4, 224.1]),
        (778, TRAINING, 2, [381.42, 268.23, 184.97, 430.15],
         [152.5, 145.0, 140.2, 125.5, 134.7, 131.7, 95.7, 104.3, 124.4, 107.4, 106.7, 100.1]),
        (778, TRAINING, 4, [287.7, 218.6, 144.54, 442.8],
         [82.9, 94.1, 95.4, 87.7, 83.3, 103.8, 92.3, 82.5, 95.8, 134.3, 81.5, 75.9]),
    ],
)  # fmt: skip
def test_looks_of_the_benchmarks_are_what_they_were_before_there_were_extras(
    stream: int, families: Families, index: int, ends_xy: list[float], grey: list[float]
) -> None:
    """Those of `benchmarks/few_labels.py`: base and tip at 60 degrees, and the mean grey level of 3 x 4 blocks."""
    look = drawn_look(stream, index, size_wh=(640, 480), families=families, bend_deg=(0.0, 180.0))
    sample = Renderer(look).frame(60.0)
    np.testing.assert_allclose(sample.keypoints_xy[[0, 8]].ravel(), ends_xy, atol=0.01)
    # Another build of OpenCV rounds here and there another way.
    np.testing.assert_allclose(
        sample.image.reshape(3, 160, 4, 160, 3).mean((1, 3, 4)).ravel(), grey, atol=0.5
    )
    np.testing.assert_array_equal(Renderer(look, extras=Extras()).frame(60.0).image, sample.image)


@pytest.mark.parametrize(
    ("index", "ends_xy", "grey"),
    [
        (0, [115.96, 100.13, 166.1, 26.77],
         [55.9, 71.6, 55.6, 33.7, 63.3, 81.4, 42.4, 42.6, 70.0, 52.9, 41.6, 35.5, 79.8, 55.3, 47.2, 45.9]),
        (1, [87.98, 219.62, 140.76, 111.33],
         [64.9, 99.2, 92.0, 45.0, 61.5, 87.9, 103.7, 86.9, 59.7, 47.6, 103.0, 104.1, 127.7, 132.9, 138.6, 111.1]),
        (2, [34.32, 164.81, 208.94, 73.75],
         [73.1, 86.1, 81.7, 60.7, 89.5, 102.2, 98.8, 97.3, 112.6, 108.3, 102.0, 89.1, 94.0, 90.2, 82.4, 68.2]),
    ],
)  # fmt: skip
def test_the_stream_without_extras_is_what_it_was(
    index: int, ends_xy: list[float], grey: list[float]
) -> None:
    sample = draw(1, index)
    np.testing.assert_allclose(sample.keypoints_xy[[0, 8]].ravel(), ends_xy, atol=0.01)
    np.testing.assert_allclose(sample.image.reshape(4, 64, 4, 64, 3).mean((1, 3, 4)).ravel(), grey, atol=0.5)
    np.testing.assert_array_equal(draw(1, index, kinds=()).image, sample.image)


def test_held_out_looks_are_drawn_without_extras() -> None:
    assert draw(1, 0, families=HELD_OUT).kinds == ()
    with pytest.raises(BendtrackError, match="expected words of the training families only, got 'tinted"):
        draw(1, 0, families=HELD_OUT, kinds=KINDS)
    mixed = dc.replace(TRAINING, clamps=("clip", "pipe"))
    with pytest.raises(BendtrackError, match="got 'pipe'"):
        draw(1, 0, families=mixed, kinds=("zip ties",))
    with pytest.raises(BendtrackError, match=r"kinds: expected one of wrinkled silicone.*, got 'ties'"):
        draw(1, 0, kinds=("ties",))
