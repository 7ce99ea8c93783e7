"""Looks sampled at random: which words, how large, where, on what and in which light.

Bodies and surfaces are sampled in `body_sampling.py`, cameras and lamps in `camera_sampling.py`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...types import FloatArray
from .body_sampling import drawn_body, drawn_surface
from .body_texture import INNER, OUTER
from .camera_sampling import drawn_light, drawn_sensor, drawn_view
from .chain import Chain, Projection, opposite, tightest
from .families import TRAINING, Families, Words
from .look import Body, Colour, Look, Place, Scene, Sensor, Surface, View
from .rng import Rng

# The body's inner side must not fold: largest product of curvature and half thickness.
TIGHTEST = 0.72
# Thinnest body, px of an image of 256.
THINNEST_PX = 4.5
# Arms that bend toward each other as far as this would lie in each other's way.
_ARMS_CROSS_DEG = 130
# How much of the clamp, in half thicknesses, and how often.
_CLAMP = 1.8
_HELD_IN_SIGHT = 0.85
# Colours nearer than this (`contrast`) are hard to tell apart.
SEEN = 0.22


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
    seed, index : int
        Of the look; neighbours have nothing to do with each other.
    size_wh : tuple of int
        Of the images, px.
    families : Families
        The words that it may be drawn from.
    bend_deg : tuple of float
        Range that it will be shown at: the body stays in the image over all of it.
    partly_out : float
        How often it does not.
    """
    rng = Rng(seed, index, 7)

    def place(words: Words, body: Body, view: View) -> tuple[Body, Place]:
        return _placed(body, view, size_wh, bend_deg, rng, partly_out)

    return compose_look(rng, size_wh, families, bend_deg, place)


def compose_look(
    rng: Rng,
    size_wh: tuple[int, int],
    families: Families,
    bend_deg: tuple[float, float],
    place: Callable[[Words, Body, View], tuple[Body, Place]],
) -> Look:
    """Draw a look around a body that `place` scales and puts into the image.

    Parameters
    ----------
    rng : Rng
        What everything is drawn from, in a fixed order.
    size_wh : tuple of int
        Size of the images, px.
    families : Families
        The words that the look may be drawn from.
    bend_deg : tuple of float
        Range of bends that it will be shown at, degrees.
    place : callable
        From the words, a body of length 1 and the view to the body in px and its place.
    """
    words = Words(
        *(rng.choice(f) for f in (families.materials, families.backgrounds, families.shapes, families.clamps))
    )
    body, surface = drawn_body(words.shape, rng, bend_deg), drawn_surface(words.material, rng)
    view = drawn_view(rng)
    sensor = drawn_sensor(rng, size_wh)
    body, placed = place(words, body, view)
    light = drawn_light(rng, body, size_wh)
    scene = _scene(words, surface, body, sensor, rng, size_wh)
    if contrast(surface.cap_colour, scene.colour, sensor.kind == "colour") < SEEN:
        # A cap that looks like the background would seem to shorten the body.
        surface = replace(
            surface, cap_colour=(0.90, 0.89, 0.85) if _luma(scene.colour) < 0.5 else (0.08, 0.08, 0.09)
        )
    return Look(size_wh, families, words, bend_deg, body, surface, placed, view, scene, light, sensor)


def in_other_light(look: Look, seed: int) -> Look:
    """The same body and camera at the same place on the same bench under other lamps, otherwise exposed."""
    return replace(look, light=drawn_light(Rng(seed, look.scene.seed, 8), look.body, look.size_wh))


def before_other_background(look: Look, seed: int) -> Look:
    """The same body held by the same clamp before another background of the look's families."""
    rng = Rng(seed, look.scene.seed, 9)
    words = replace(look.words, background=rng.choice(look.families.backgrounds))
    scene = _scene(words, look.surface, look.body, look.sensor, rng, look.size_wh)
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
    rng: Rng,
    partly_out: float,
) -> tuple[Body, Place]:
    """Make the body, which comes with length 1, as large as the image wants it, and put it there."""
    low, high = bend_deg
    bends = np.array([low]) if high == low else np.linspace(low, high, 7)
    folds = max(tightest(body, float(b)) * (INNER if b > 0 else OUTER) for b in {low, high})
    body = replace(body, half_px=min(body.half_px, TIGHTEST / folds))
    side = 1 if rng.bernoulli(0.5) else -1
    place = Place((0.0, 0.0), rng.uniform(0, 360), side, None)
    # The body's outline is the midline and its normals, which grow with it. The end is in the last piece.
    chains = [Chain(body, place, float(bend)) for bend in bends]
    line = np.concatenate([point for chain in chains for point in (chain.origin, chain.end_xy[None])])
    normals = np.concatenate([way for chain in chains for way in (chain.inward, chain.inward[-1:])])

    # Mostly something of the clamp is seen too: without it, which end is held could not be told.
    clamp = _CLAMP if rng.bernoulli(_HELD_IN_SIGHT) else 0.0
    behind = -clamp * chains[0].along[0] + np.array([[-1.0], [1.0]]) * chains[0].inward[0]

    def outline(length: float, half: float) -> FloatArray:
        middle = line * length
        return np.concatenate([middle - half * normals, middle + half * normals, half * behind])

    size = np.asarray(size_wh)
    extent = np.ptp(outline(1.0, body.half_px), axis=0)
    wanted = rng.uniform(0.2, 0.95) if rng.bernoulli(0.3) else rng.uniform(0.35, 0.85)
    length = float(min(wanted * size.max() / extent.max(), (0.95 * size / extent).min()))
    thinnest = 0.5 * THINNEST_PX * size.max() / 256
    half = min(max(body.half_px * length, thinnest), TIGHTEST / folds * length)
    body = replace(body, length_px=length, half_px=half)
    around, projection = outline(length, half), Projection(view, size_wh)
    # Tilt and lens move things a little: where the body comes to lie is seen in the image, twice.
    base, aim = (size - 1) / 2, None
    for _ in range(2):
        seen = projection.to_image(base + around)
        corner, far = seen.min(axis=0), seen.max(axis=0)
        if aim is None:
            room = np.maximum(size - 1 - (far - corner), 0)
            aim = room * rng.generator.random(2)
            if rng.bernoulli(partly_out):
                axis, beyond = rng.integer(0, 1), rng.uniform(0.1, 0.42) * (far - corner)
                aim[axis] = room[axis] + beyond[axis] if rng.bernoulli(0.5) else -beyond[axis]
        base = base + aim - corner
    place = replace(place, base_xy=(float(base[0]), float(base[1])))
    if rng.bernoulli(0.35) and high < _ARMS_CROSS_DEG:
        thick = 2 * body.half_px
        aside = rng.uniform(1.3, 2.5) * thick + rng.uniform(0, 0.5) * body.length_px
        gripper = replace(place, second_arm=(rng.normal(0, 0.1) * thick, aside, rng.uniform(-8, 45)))
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
        near, far = (float(np.hypot(*(projection.to_image(arm.end_xy) - centre))) for arm in (first, other))
        if far < near + 0.06 * max(size_wh):
            return False
    return True


def background_colour(word: str, rng: Rng) -> Colour:
    """Colour of a background, by its word."""
    level = rng.uniform(0.55, 0.97)
    papers: tuple[Colour, ...] = (
        (level, level, 0.98 * level),
        (level, 0.98 * level, 0.93 * level),
        rng.any_hue(rng.uniform(0.1, 0.6), level),
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
    dark = rng.uniform(0.06, 0.45)
    if word in ("plain paper", "lined paper", "squared paper"):
        return rng.choice(
            (papers[0], papers[0], papers[1], papers[2]) if word == "plain paper" else papers[:2]
        )
    if word == "wood":
        return rng.jittered(rng.choice(woods), 0.07)
    if word == "cutting mat":
        return rng.jittered(rng.choice(mats), 0.07)
    if word == "breadboard":
        return rng.jittered(
            rng.choice(((0.90, 0.89, 0.86), (0.90, 0.89, 0.86), (0.15, 0.25, 0.50), (0.15, 0.15, 0.16))),
            0.05,
        )
    if word == "optical table":
        return rng.jittered((dark, dark, 1.04 * dark) if rng.bernoulli(0.7) else (0.62, 0.63, 0.64), 0.05)
    if word in ("dark bench", "cluttered bench"):
        return (
            rng.jittered((dark, dark, dark), 0.06)
            if rng.bernoulli(0.75)
            else rng.any_hue(rng.uniform(0.1, 0.5), rng.uniform(0.3, 0.8))
        )
    if word == "room":
        return rng.jittered((0.55, 0.53, 0.50), 0.15)
    grey = rng.uniform(0.04, 0.95)
    return (
        (grey, grey, grey)
        if rng.bernoulli(0.5)
        else rng.any_hue(rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.9))
    )


def _luma(colour: Colour) -> float:
    return 0.30 * colour[0] + 0.59 * colour[1] + 0.11 * colour[2]


def contrast(one: Colour, other: Colour, coloured: bool) -> float:
    """How well two colours differ to the eye; hue helps where the camera sees it (`coloured`)."""
    luma = abs(_luma(one) - _luma(other))
    if not coloured:
        return luma
    hue = [(a - _luma(one)) - (b - _luma(other)) for a, b in zip(one, other, strict=True)]
    return math.hypot(luma, 0.8 * math.hypot(*hue))


def _scene(
    words: Words, surface: Surface, body: Body, sensor: Sensor, rng: Rng, size_wh: tuple[int, int]
) -> Scene:
    unit = max(size_wh) / 256
    coloured = sensor.kind == "colour"
    best = max(
        (background_colour(words.background, rng) for _ in range(4)),
        key=lambda colour: min(contrast(colour, surface.colour, coloured), 0.3),
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
        rng.choice(metals)
        if rng.bernoulli(0.55)
        else rng.any_hue(rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.9))
    )
    if contrast(clamp, surface.colour, coloured) < SEEN:
        # Where the body leaves the clamp must be seen.
        clamp = max(metals, key=lambda metal: contrast(metal, surface.colour, coloured))
    tubes: tuple[Colour, ...] = (
        (0.85, 0.86, 0.86),
        (0.10, 0.10, 0.11),
        (0.20, 0.40, 0.75),
        (0.80, 0.30, 0.20),
        (0.75, 0.70, 0.50),
    )
    busy = rng.bernoulli(0.55)
    return Scene(
        seed=rng.seed(),
        colour=best,
        ink=light_ink if words.background == "cutting mat" else rng.jittered(rng.choice(inks)),
        pitch_px=rng.log_uniform(5, 22) * unit,
        turn_deg=rng.normal(0, 6) if rng.bernoulli(0.6) else rng.uniform(-90, 90),
        texture=rng.uniform(0.003, 0.03),
        distractors=rng.integer(1, 4) if busy else 0,
        occluders=1 if rng.bernoulli(0.13) else 0,
        clamp_colour=rng.jittered(clamp),
        clamp_seed=rng.seed(),
        tube_colour=rng.jittered(rng.choice(tubes)),
        tube_px=rng.uniform(0.25, 0.6) * body.half_px * 2 + 1.2 * unit if rng.bernoulli(0.75) else 0.0,
    )
