"""How a whole look is drawn by chance: which words, how large, where, on what and in which light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...types import FloatArray
from .bodies import drawn_body, drawn_surface
from .chain import Chain, Projection, opposite, tightest
from .coat import INNER, OUTER
from .dice import Dice
from .families import TRAINING, Families, Words
from .filming import drawn_light, drawn_sensor, drawn_view
from .look import Body, Colour, Look, Place, Scene, Sensor, Surface, View

# The body's inner side must not fold: largest product of curvature and half thickness.
_TIGHTEST = 0.72
# Thinnest body, px of a picture of 256.
_THINNEST_PX = 4.5
# Arms that bend toward each other as far as this would lie in each other's way.
_ARMS_CROSS_DEG = 130
# How much of the clamp, in half thicknesses, and how often.
_CLAMP = 1.8
_HELD_IN_SIGHT = 0.85
# Colours nearer than this are hard to tell apart.
_SEEN = 0.22


def drawn_look(
    seed: int,
    index: int = 0,
    *,
    size_wh: tuple[int, int] = (640, 480),
    families: Families = TRAINING,
    bend_deg: tuple[float, float] = (0.0, 180.0),
    partly_out: float = 0.0,
) -> Look:
    """Draw a look. The same arguments draw the same one.

    Parameters
    ----------
    seed, index : of the look; neighbours have nothing to do with each other
    size_wh : of the pictures, px
    families : the words that it may be drawn from
    bend_deg : range that it will be shown at: the body stays in the picture over all of it
    partly_out : how often it does not
    """
    dice = Dice(seed, index, 7)
    words = Words(
        *(
            dice.one_of(f)
            for f in (families.materials, families.backgrounds, families.shapes, families.clamps)
        )
    )
    body, surface = drawn_body(words.shape, dice, bend_deg), drawn_surface(words.material, dice)
    view = drawn_view(dice)
    sensor = drawn_sensor(dice, size_wh)
    body, place = _placed(body, view, size_wh, bend_deg, dice, partly_out)
    light = drawn_light(dice, body, size_wh)
    scene = _scene(words, surface, body, sensor, dice, size_wh)
    if _contrast(surface.cap_colour, scene.colour, sensor.kind == "colour") < _SEEN:
        # A cap that cannot be told from the background would seem to shorten the body.
        surface = replace(
            surface, cap_colour=(0.90, 0.89, 0.85) if _luma(scene.colour) < 0.5 else (0.08, 0.08, 0.09)
        )
    return Look(size_wh, families, words, bend_deg, body, surface, place, view, scene, light, sensor)


def in_other_light(look: Look, seed: int) -> Look:
    """The same body and camera at the same place on the same bench under other lamps, otherwise exposed."""
    return replace(look, light=drawn_light(Dice(seed, look.scene.seed, 8), look.body, look.size_wh))


def before_other_background(look: Look, seed: int) -> Look:
    """The same body held by the same clamp before another background of the look's families."""
    dice = Dice(seed, look.scene.seed, 9)
    words = replace(look.words, background=dice.one_of(look.families.backgrounds))
    scene = _scene(words, look.surface, look.body, look.sensor, dice, look.size_wh)
    kept = look.scene
    scene = replace(
        scene, clamp_colour=kept.clamp_colour, clamp_seed=kept.clamp_seed,
        tube_colour=kept.tube_colour, tube_px=kept.tube_px, occluders=kept.occluders,
    )  # fmt: skip
    return replace(look, words=words, scene=scene)


def _placed(
    body: Body,
    view: View,
    size_wh: tuple[int, int],
    bend_deg: tuple[float, float],
    dice: Dice,
    partly_out: float,
) -> tuple[Body, Place]:
    """Make the body, which comes with length 1, as large as the picture wants it, and put it there."""
    low, high = bend_deg
    bends = np.array([low]) if high == low else np.linspace(low, high, 7)
    folds = max(tightest(body, float(b)) * (INNER if b > 0 else OUTER) for b in {low, high})
    body = replace(body, half_px=min(body.half_px, _TIGHTEST / folds))
    side = 1 if dice.maybe(0.5) else -1
    place = Place((0.0, 0.0), dice.between(0, 360), side, None)
    # The body's outline is the midline and its normals, which grow with it. The end is in the last piece.
    chains = [Chain(body, place, float(bend)) for bend in bends]
    line = np.concatenate([point for chain in chains for point in (chain.origin, chain.end_xy[None])])
    normals = np.concatenate([way for chain in chains for way in (chain.inward, chain.inward[-1:])])

    # Mostly something of the clamp is seen too: without it, which end is held could not be told.
    clamp = _CLAMP if dice.maybe(_HELD_IN_SIGHT) else 0.0
    behind = -clamp * chains[0].along[0] + np.array([[-1.0], [1.0]]) * chains[0].inward[0]

    def outline(length: float, half: float) -> FloatArray:
        middle = line * length
        return np.concatenate([middle - half * normals, middle + half * normals, half * behind])

    size = np.asarray(size_wh)
    extent = np.ptp(outline(1.0, body.half_px), axis=0)
    wanted = dice.between(0.2, 0.95) if dice.maybe(0.3) else dice.between(0.35, 0.85)
    length = float(min(wanted * size.max() / extent.max(), (0.95 * size / extent).min()))
    thinnest = 0.5 * _THINNEST_PX * size.max() / 256
    half = min(max(body.half_px * length, thinnest), _TIGHTEST / folds * length)
    body = replace(body, length_px=length, half_px=half)
    around, projection = outline(length, half), Projection(view, size_wh)
    # Tilt and lens move things a little: where the body comes to lie is seen in the picture, twice.
    base, aim = (size - 1) / 2, None
    for _ in range(2):
        seen = projection.picture(base + around)
        corner, far = seen.min(axis=0), seen.max(axis=0)
        if aim is None:
            room = np.maximum(size - 1 - (far - corner), 0)
            aim = room * dice.rng.random(2)
            if dice.maybe(partly_out):
                axis, beyond = dice.whole(0, 1), dice.between(0.1, 0.42) * (far - corner)
                aim[axis] = room[axis] + beyond[axis] if dice.maybe(0.5) else -beyond[axis]
        base = base + aim - corner
    place = replace(place, base_xy=(float(base[0]), float(base[1])))
    if dice.maybe(0.35) and high < _ARMS_CROSS_DEG:
        thick = 2 * body.half_px
        aside = dice.between(1.3, 2.5) * thick + dice.between(0, 0.5) * body.length_px
        gripper = replace(place, second_arm=(dice.about(0, 0.1) * thick, aside, dice.between(-8, 45)))
        if _arms_fit(body, gripper, view, size_wh, bends):
            place = gripper
    return body, place


def _arms_fit(body: Body, place: Place, view: View, size_wh: tuple[int, int], bends: FloatArray) -> bool:
    """Whether two arms can be drawn: they do not cross, and the labelled tip is the nearer to the middle, always."""
    second = opposite(place)
    if second is None:
        return True
    projection, centre = Projection(view, size_wh), (np.asarray(size_wh) - 1) / 2
    for bend in bends:
        first, other = Chain(body, place, float(bend)), Chain(body, second, float(bend))
        if (other.end_xy - first.end_xy) @ first.inward[0] < 0:
            return False
        near, far = (float(np.hypot(*(projection.picture(arm.end_xy) - centre))) for arm in (first, other))
        if far < near + 0.06 * max(size_wh):
            return False
    return True


def _background_colour(word: str, dice: Dice) -> Colour:
    level = dice.between(0.55, 0.97)
    papers: tuple[Colour, ...] = (
        (level, level, 0.98 * level),
        (level, 0.98 * level, 0.93 * level),
        dice.hue(dice.between(0.1, 0.6), level),
    )
    mats: tuple[Colour, ...] = (
        (0.12, 0.38, 0.30),
        (0.15, 0.32, 0.50),
        (0.18, 0.18, 0.20),
        (0.45, 0.47, 0.48),
        (0.70, 0.35, 0.45),
    )
    woods: tuple[Colour, ...] = (
        (0.72, 0.55, 0.36),
        (0.55, 0.38, 0.24),
        (0.84, 0.71, 0.53),
        (0.36, 0.25, 0.17),
        (0.65, 0.60, 0.53),
    )
    dark = dice.between(0.06, 0.45)
    if word in ("plain paper", "lined paper", "squared paper"):
        return dice.one_of(
            (papers[0], papers[0], papers[1], papers[2]) if word == "plain paper" else papers[:2]
        )
    if word == "wood":
        return dice.near(dice.one_of(woods), 0.07)
    if word == "cutting mat":
        return dice.near(dice.one_of(mats), 0.07)
    if word == "breadboard":
        return dice.near(
            dice.one_of(((0.90, 0.89, 0.86), (0.90, 0.89, 0.86), (0.15, 0.25, 0.50), (0.15, 0.15, 0.16))),
            0.05,
        )
    if word == "optical table":
        return dice.near((dark, dark, 1.04 * dark) if dice.maybe(0.7) else (0.62, 0.63, 0.64), 0.05)
    if word in ("dark bench", "cluttered bench"):
        return (
            dice.near((dark, dark, dark), 0.06)
            if dice.maybe(0.75)
            else dice.hue(dice.between(0.1, 0.5), dice.between(0.3, 0.8))
        )
    if word == "room":
        return dice.near((0.55, 0.53, 0.50), 0.15)
    grey = dice.between(0.04, 0.95)
    return (grey, grey, grey) if dice.maybe(0.5) else dice.hue(dice.between(0.2, 0.8), dice.between(0.2, 0.9))


def _luma(colour: Colour) -> float:
    return 0.30 * colour[0] + 0.59 * colour[1] + 0.11 * colour[2]


def _contrast(one: Colour, other: Colour, coloured: bool) -> float:
    """How well the two are told apart; hue helps where the camera sees it."""
    luma = abs(_luma(one) - _luma(other))
    if not coloured:
        return luma
    hue = [(a - _luma(one)) - (b - _luma(other)) for a, b in zip(one, other, strict=True)]
    return math.hypot(luma, 0.8 * math.hypot(*hue))


def _scene(
    words: Words, surface: Surface, body: Body, sensor: Sensor, dice: Dice, size_wh: tuple[int, int]
) -> Scene:
    unit = max(size_wh) / 256
    coloured = sensor.kind == "colour"
    best = max(
        (_background_colour(words.background, dice) for _ in range(4)),
        key=lambda colour: min(_contrast(colour, surface.colour, coloured), 0.3),
    )
    inks: tuple[Colour, ...] = (
        (0.55, 0.65, 0.80),
        (0.60, 0.60, 0.62),
        (0.35, 0.45, 0.65),
        (0.75, 0.62, 0.58),
    )
    light_ink: Colour = tuple(min(0.35 + 0.75 * c, 1.0) for c in best)  # type: ignore[assignment]
    metals: tuple[Colour, ...] = (
        (0.62, 0.63, 0.65),
        (0.20, 0.20, 0.22),
        (0.82, 0.82, 0.82),
        (0.35, 0.36, 0.38),
    )
    clamp = (
        dice.one_of(metals) if dice.maybe(0.55) else dice.hue(dice.between(0.4, 0.9), dice.between(0.3, 0.9))
    )
    if _contrast(clamp, surface.colour, coloured) < _SEEN:
        # Where the body leaves the clamp must be seen.
        clamp = max(metals, key=lambda metal: _contrast(metal, surface.colour, coloured))
    tubes: tuple[Colour, ...] = (
        (0.85, 0.86, 0.86),
        (0.10, 0.10, 0.11),
        (0.20, 0.40, 0.75),
        (0.80, 0.30, 0.20),
        (0.75, 0.70, 0.50),
    )
    busy = dice.maybe(0.55)
    return Scene(
        seed=dice.seed(),
        colour=best,
        ink=light_ink if words.background == "cutting mat" else dice.near(dice.one_of(inks)),
        pitch_px=dice.steeply(5, 22) * unit,
        turn_deg=dice.about(0, 6) if dice.maybe(0.6) else dice.between(-90, 90),
        texture=dice.between(0.003, 0.03),
        things=dice.whole(1, 4) if busy else 0,
        occluders=1 if dice.maybe(0.13) else 0,
        clamp_colour=dice.near(clamp),
        clamp_seed=dice.seed(),
        tube_colour=dice.near(dice.one_of(tubes)),
        tube_px=dice.between(0.25, 0.6) * body.half_px * 2 + 1.2 * unit if dice.maybe(0.75) else 0.0,
    )
