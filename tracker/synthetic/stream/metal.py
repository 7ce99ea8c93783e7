"""Bare metal that lies about or holds the body: brackets, blocks and instruments, brushed, with highlights.

Rods, pipes and boss heads are held out (`families.py`) and stay so: nothing here is round, and none has a hole pattern
like that of an optical table.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .clamps import Local
from .distractors import Painter
from .look import Colour
from .noise import noise_field
from .paint import Shade, axes, box_about, darken, fixed, lay_over, rectangle, strokes, tone

_GREYS: tuple[Colour, ...] = (
    *((0.62, 0.63, 0.65), (0.52, 0.53, 0.55), (0.70, 0.71, 0.72)),
    *((0.44, 0.45, 0.47), (0.66, 0.64, 0.60), (0.58, 0.61, 0.66)),
)


def any_grey(rng: np.random.Generator) -> Colour:
    """Colour of aluminium or steel."""
    return _GREYS[int(rng.integers(len(_GREYS)))]


def brush(
    painter: Painter, outline: FloatArray, colour: Colour, heading: float, shade: Shade | None = None
) -> None:
    """Fill an outline with brushed metal: fine lines along the heading, bands of highlight across it.

    Parameters
    ----------
    painter : Painter
        Its image is filled, its cover gets what is covered.
    outline : ndarray
        (N, 2) px.
    colour : Colour
        Of the metal halfway between dark and highlight.
    heading : float
        Of the brushing, radians from +x toward +y.
    shade : Shade or None
        The shadow that it throws.
    """
    image, rng = painter.image, painter.rng
    low, high = box_about(outline, image)
    corners = rng.random(6)
    if (high <= low).any():
        return
    if shade is not None:
        _throw_shadow(image, outline, shade)
    shape = (int(high[1] - low[1]), int(high[0] - low[0]))
    along, across = axes(heading)
    x = np.arange(low[0], high[0], dtype=np.float32)
    y = np.arange(low[1], high[1], dtype=np.float32)[:, None]
    reach = max(float(np.ptp(outline @ along)), 1.0)
    u = (
        x * np.float32(along[0]) + y * np.float32(along[1]) - np.float32((outline @ along).min())
    ) / np.float32(reach)
    v = x * np.float32(across[0]) + y * np.float32(across[1])
    # A highlight is wide across the brushing and narrow along it.
    level = np.float32(0.78) + np.float32(0.3 * (corners[0] - 0.5)) * (u - np.float32(0.5))
    for place, wide, tall in (
        (corners[1], 0.06 + 0.15 * corners[2], 0.75),
        (corners[3], 0.02 + 0.08 * corners[4], 0.5),
    ):
        away = (u - np.float32(place)) / np.float32(wide)
        level = level + np.float32(tall * (0.4 + 0.6 * corners[5])) * np.exp(-away * away)
    lines = noise_field(rng, (1, 600), 1.0)[0]
    level = level * (1 + np.float32(0.07) * lines[(v * np.float32(1.3)).astype(np.int32) % 600])
    filled = cv2.merge([cv2.convertScaleAbs(level, alpha=255 * c) for c in colour])
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [fixed(outline - low)], 255, cv2.LINE_AA, 4)
    lay_over(image[low[1] : high[1], low[0] : high[0]], filled, mask)
    if painter.cover is not None:
        cv2.fillPoly(painter.cover, [fixed(outline)], 255, cv2.LINE_AA, 4)


def bracket(local: Local, painter: Painter, heading: float) -> None:
    """An angle bracket as a clamp, drawn over the body. Its face is s = 0 and looks toward positive s.

    Parameters
    ----------
    local : callable
        From (s, t) about the base, in thicknesses of the body, to px of the image.
    painter : Painter
    heading : float
        Of the body at its base, radians.
    """
    rng = painter.rng
    back, low, high = -rng.uniform(0.9, 2.2), -rng.uniform(0.6, 2.6), rng.uniform(0.6, 2.6)
    colour = any_grey(rng)
    plate = np.array([[back, low], [0, low], [0, high], [back, high]])
    brush(painter, local(plate), colour, heading + (np.pi / 2 if rng.random() < 0.6 else 0.0), painter.shade)
    # The flange that is bent up toward the lens, seen along its edge.
    fold = rng.uniform(0.14, 0.35)
    flange = np.array([[-fold, low], [0, low], [0, high], [-fold, high]])
    brush(painter, local(flange), _toned(colour, 1.18), heading + np.pi / 2)
    _edge(painter.image, local(np.array([[-fold, low], [-fold, high]])), 0.35)
    _edge(painter.image, local(np.array([[-0.03, low], [-0.03, high]])), 0.95)
    for t in np.linspace(low, high, int(rng.integers(2, 5)) + 1)[:-1] + (high - low) / 8:
        if rng.random() < 0.7:
            _hole(painter, local, np.array([0.6 * back, t]), rng.uniform(0.1, 0.2))


def any_metal(painter: Painter, place: FloatArray, heading: float) -> None:
    """One piece of bare metal that may lie on a bench or stand behind a body."""
    kinds = (_plate, _plate, _profile, _profile, _caliper, _cell)
    kinds[int(painter.rng.integers(len(kinds)))](painter, place, heading)


def fitting(painter: Painter, place: FloatArray, heading: float, width_px: float) -> None:
    """A hexagonal nut and a sleeve at a tube's end."""
    along, _ = axes(heading)
    colour: Colour = (0.72, 0.60, 0.34) if painter.rng.random() < 0.4 else any_grey(painter.rng)
    sleeve = rectangle(place - 0.35 * width_px * along, along, 0.9 * width_px, 1.12 * width_px)
    nut = rectangle(place + 0.25 * width_px * along, along, 0.6 * width_px, 1.4 * width_px)
    for outline in (sleeve, nut):
        brush(painter, outline, colour, heading + np.pi / 2, painter.shade)
    for share in (-0.25, 0.25):
        middle = place + 0.25 * width_px * along + 1.4 * share * width_px * axes(heading)[1]
        _edge(painter.image, middle + np.array([[-0.3], [0.3]]) * width_px * along, 0.3)


def _plate(painter: Painter, place: FloatArray, heading: float) -> None:
    """A plate or an angle with a few holes and a slot."""
    rng, unit = painter.rng, painter.unit
    length, width = rng.uniform(35, 120) * unit, rng.uniform(16, 50) * unit
    along, across = axes(heading)
    colour = any_grey(rng)
    brush(painter, rectangle(place, along, length, width), colour, heading, painter.shade)
    side = place + 0.42 * width * across
    if rng.random() < 0.6:
        brush(painter, rectangle(side, along, length, 0.16 * width), _toned(colour, 0.6), heading)

    local = _about(place, heading)
    for s in (-0.36, 0.36) if rng.random() < 0.7 else ():
        for t in (-0.25, 0.18) if rng.random() < 0.5 else (0.0,):
            _hole(painter, local, np.array([s * length, t * width]), rng.uniform(2.0, 4.0) * unit)
    if rng.random() < 0.4:
        painter.fill(rectangle(place, along, 0.4 * length, 0.14 * width), (0.08, 0.08, 0.09))


def _profile(painter: Painter, place: FloatArray, heading: float) -> None:
    """An aluminium profile with slots along it."""
    rng, unit = painter.rng, painter.unit
    along, across = axes(heading)
    width, slots = rng.uniform(14, 30) * unit, int(rng.integers(1, 3))
    length = rng.uniform(120, 340) * unit
    brush(painter, rectangle(place, along, length, width * slots), any_grey(rng), heading, painter.shade)
    for number in range(slots):
        middle = place + (number - 0.5 * (slots - 1)) * width * across
        cv2.fillPoly(
            painter.image,
            [fixed(rectangle(middle, along, length, 0.27 * width))],
            tone((0.07, 0.07, 0.08)),
            cv2.LINE_AA,
            4,
        )
        for side, level in ((-0.5, 0.95), (-0.14, 0.9), (0.14, 0.3), (0.5, 0.28)):
            edge = middle + side * width * across
            _edge(painter.image, edge + np.array([[-0.5], [0.5]]) * length * along, level)


def _caliper(painter: Painter, place: FloatArray, heading: float) -> None:
    """A caliper: a beam with ticks, two jaws, a display."""
    rng, unit = painter.rng, painter.unit
    along, across = axes(heading)
    length, width = rng.uniform(110, 240) * unit, rng.uniform(7, 13) * unit
    colour = any_grey(rng)
    brush(painter, rectangle(place, along, length, width), colour, heading, painter.shade)
    start = place - 0.5 * length * along
    for s, reach in ((0.0, 4.0), (rng.uniform(0.15, 0.5), 4.0)):
        root = start + s * length * along
        jaw = np.array([[0, -1.2], [1.1, -1.2], [1.0, 0.6], [0.15, reach], [0, reach]]) * width
        brush(painter, _about(root, heading)(jaw), colour, heading, painter.shade)
    number = np.arange(int(0.45 * length / (2.4 * unit)))
    tick = place + (number[:, None] * 2.4 * unit) * along + 0.5 * width * across
    ends = tick - np.where(number % 5 == 0, 0.6, 0.35)[:, None] * width * across
    strokes(painter.image, np.stack([tick, ends], axis=1), (0.15, 0.15, 0.16))
    box = rectangle(start + 0.42 * length * along, along, 0.24 * length, 1.7 * width)
    painter.fill(box, (0.13, 0.13, 0.14))
    painter.fill(
        rectangle(start + 0.42 * length * along, along, 0.15 * length, 0.9 * width), (0.62, 0.66, 0.58)
    )


def _cell(painter: Painter, place: FloatArray, heading: float) -> None:
    """A load cell or a stage: a block with a cut and screws, on a darker base."""
    rng, unit = painter.rng, painter.unit
    along, across = axes(heading)
    length, width = rng.uniform(34, 80) * unit, rng.uniform(18, 36) * unit
    colour = any_grey(rng)
    brush(painter, rectangle(place, along, 1.25 * length, 1.2 * width), _toned(colour, 0.5), heading)
    brush(painter, rectangle(place, along, length, width), colour, heading + np.pi / 2, painter.shade)
    for side in (-1, 1):
        cut = rectangle(place + side * 0.16 * length * along, along, 0.42 * length, 0.09 * width)
        painter.fill(cut + side * 0.18 * width * across, (0.06, 0.06, 0.07))

    local = _about(place, heading)
    for s in (-0.4, 0.4):
        _hole(painter, local, np.array([s * length, 0.0]), 0.14 * width)


def _about(place: FloatArray, heading: float) -> Local:
    """From (s, t) px along and across a heading (radians) about a place to px of the image."""
    along, across = axes(heading)
    return lambda st: place + st[:, :1] * along + st[:, 1:] * across


def _hole(painter: Painter, local: Local, at: FloatArray, radius: float) -> None:
    """A drilled hole: dark, its far rim bright; in the units of `local`."""
    ring = np.linspace(0, 2 * np.pi, 18, endpoint=False)
    circle = radius * np.stack([np.cos(ring), np.sin(ring)], axis=1)
    for grow, shift, level in ((1.2, 0.12, 0.92), (1.0, 0.0, 0.07)):
        points = fixed(local(at + grow * circle) + shift * painter.unit)
        cv2.fillPoly(painter.image, [points], tone((level, level, level)), cv2.LINE_AA, 4)


def _toned(colour: Colour, factor: float) -> Colour:
    r, g, b = (min(factor * c, 1.0) for c in colour)
    return r, g, b


def _edge(image: ImageArray, line: FloatArray, level: float) -> None:
    cv2.polylines(image, [fixed(line)], False, tone((level, level, level)), 1, cv2.LINE_AA, 4)


def _throw_shadow(image: ImageArray, outline: FloatArray, shade: Shade) -> None:
    """Darken what lies under an outline's shadow, in place."""
    low, high = box_about(outline, image, shade.spread_px)
    if (high <= low).any():
        return
    dark = np.zeros((int(high[1] - low[1]), int(high[0] - low[0])), np.uint8)
    cv2.fillPoly(dark, [fixed(outline - low + shade.offset_xy)], 255, cv2.LINE_8, 4)
    dark = cv2.blur(dark, (2 * int(shade.softness_px) + 1,) * 2)
    darken(image[low[1] : high[1], low[0] : high[0]], dark, shade.depth)
