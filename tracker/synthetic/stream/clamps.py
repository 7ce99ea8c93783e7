"""What holds the body: drawn over it, by the words of `families`. It leaves the clamp at s = 0."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .distractors import SKIN, Painter
from .look import Colour
from .paint import capsule, fixed, strokes, tone

# From (s, t) about the base, in thicknesses of the body there, to the image: (N, 2) -> (N, 2) px.
Local = Callable[[FloatArray], FloatArray]


def clamp(word: str, colour: Colour, local: Local, thick_px: float, painter: Painter) -> None:
    """Draw the clamp. Its face is s = 0 and looks toward positive s; t is across."""
    {
        "block": _block, "vice": _vice, "printed holder": _printed, "clip": _clip,
        "fingers": _fingers, "pipe": _pipe, "boss head": _boss,
    }[word](colour, local, thick_px, painter)  # fmt: skip


def reach(word: str) -> float:
    """How far behind its face a tube comes out of it, in thicknesses."""
    return {"fingers": 0.4, "clip": 0.9, "pipe": 1.6}.get(word, 1.3)


def extent(word: str) -> tuple[float, float]:
    """How far it can extend behind its face and to each side of the midline, in thicknesses.

    Only what holds the body: a stand's rod and an arm reach farther.
    """
    return {"vice": (1.5, 4.1), "clip": (2.4, 1.7), "block": (2.2, 1.7)}.get(word, (2.3, 1.2))


def hub(colour: Colour, local: Local, thick_px: float, painter: Painter) -> None:
    """Draw the middle of a body with two arms, of its own material, where a clamp would be."""
    rng = painter.rng
    back, wide, corner = -rng.uniform(1.2, 2.6), rng.uniform(0.7, 1.3), rng.uniform(0.15, 0.5)
    outline = np.array([[back, -wide], [0, -wide], [0, wide], [back, wide]])
    # Corners cut twice are round enough at this size.
    for share in (corner, 0.35):
        step = share * 0.5 * (np.roll(outline, -1, axis=0) - outline)
        outline = np.stack([outline + step, np.roll(outline, -1, axis=0) - step], axis=1).reshape(-1, 2)
    painter.fill(local(outline), colour, ramp=0.15, rounding_px=0.22 * thick_px)


def _box(s0: float, s1: float, t0: float, t1: float) -> FloatArray:
    return np.array([[s0, t0], [s1, t0], [s1, t1], [s0, t1]])


def _line(image: ImageArray, points: FloatArray, colour: Colour, factor: float, width: int = 1) -> None:
    cv2.polylines(image, [fixed(points)], False, tone(colour, factor), width, cv2.LINE_AA, 4)


def _screw(image: ImageArray, centre: FloatArray, radius_px: float) -> None:
    for share, level in ((1.0, 0.22), (0.85, 0.62), (0.4, 0.12)):
        radius = int(max(radius_px * share, 0.6) * 16)
        cv2.circle(
            image, tuple(fixed(centre)), radius, tone((level, level, level * 1.03)), -1, cv2.LINE_AA, 4
        )


def _block(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    image, rng = painter.image, painter.rng
    back, low, high = -rng.uniform(0.8, 2.2), -rng.uniform(0.6, 1.6), rng.uniform(0.6, 1.6)
    painter.fill(local(_box(back, 0, low, high)), colour, ramp=0.25)
    bevel = rng.uniform(1.1, 1.6)
    _line(
        image,
        local(np.array([[back, low], [-0.04, low], [-0.04, high]])),
        colour,
        bevel,
        max(1, round(0.06 * thick)),
    )
    if rng.random() < 0.5:
        _line(image, local(np.array([[back, 0.05], [0, 0.05]])), colour, 0.45)
    for t in (0.75 * low, 0.75 * high) if rng.random() < 0.7 else ():
        _screw(image, local(np.array([[0.5 * back, t]]))[0], 0.13 * thick + 0.8)


def _vice(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    image, rng = painter.image, painter.rng
    back, gap, deep = -rng.uniform(0.7, 1.5), rng.uniform(0.02, 0.2), rng.uniform(1.0, 2.4)
    painter.fill(local(_box(back, -0.06, -0.5, 0.5)), (0.10, 0.10, 0.11))
    for sign in (-1, 1):
        painter.fill(local(_box(back, 0, sign * gap, sign * deep)), colour, ramp=0.3)
        teeth = np.linspace(back, 0, 9)[1:-1]
        lines = np.stack(
            [np.stack([teeth, teeth], 1), np.broadcast_to([sign * gap, sign * (gap + 0.18)], (7, 2))], axis=2
        )
        strokes(image, local(lines.reshape(-1, 2)).reshape(-1, 2, 2), tuple(0.5 * c for c in colour))  # type: ignore[arg-type]
        _line(image, local(_box(back, -0.03, sign * gap, sign * deep)[[0, 1, 2]]), colour, 1.4)
    screw = local(np.array([[0.5 * back, deep], [0.5 * back, deep + rng.uniform(0.6, 1.6)]]))
    _line(image, screw, (0.5, 0.5, 0.52), 1.0, max(2, round(0.3 * thick)))


def _printed(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    image, rng = painter.image, painter.rng
    back, wide, neck = -rng.uniform(1.0, 2.2), rng.uniform(0.65, 1.1), rng.uniform(0.55, 1.0)
    lip = [[-0.5, wide], [-0.35, neck], [0, neck]]
    outline = np.array([[back, -wide], *([s, -t] for s, t in lip), *lip[::-1], [back, wide]])
    painter.fill(local(outline), colour, ramp=0.2)
    layers = np.linspace(back, 0, int(np.clip(-back * thick / 2.5, 3, 26)))[1:-1]
    side = min(wide, neck)
    lines = np.stack(
        [np.stack([layers, layers], 1), np.broadcast_to([-side, side], (len(layers), 2))], axis=2
    )
    strokes(image, local(lines.reshape(-1, 2)).reshape(-1, 2, 2), tuple(0.9 * c for c in colour))  # type: ignore[arg-type]
    _line(image, local(outline[[2, 3, 4, 5]] - (0.03, 0)), colour, 1.3)
    if rng.random() < 0.6:
        _screw(image, local(np.array([[0.6 * back, 0.0]]))[0], 0.16 * thick + 0.8)


def _clip(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    image, rng = painter.image, painter.rng
    wide, deep, narrow = rng.uniform(0.8, 1.6), -rng.uniform(0.7, 1.1), rng.uniform(0.5, 0.9)
    outline = np.array([[0, -wide], [0, wide], [deep, narrow * wide], [deep, -narrow * wide]])
    painter.fill(local(outline), colour, ramp=0.35)
    _line(image, local(outline[:2] - (0.1, 0)), colour, 1.8, max(1, round(0.10 * thick)))
    _line(image, local(outline[2:]), colour, 1.3)
    arc = np.linspace(-np.pi / 2, np.pi / 2, 14)
    loop = np.stack([deep - rng.uniform(0.6, 1.2) * np.cos(arc), 0.4 * wide * np.sin(arc)], axis=1)
    _line(image, local(loop), (0.66, 0.66, 0.68), 1.0, max(1, round(0.12 * thick)))


def _fingers(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    """A thumb across the body; its edge passes through the midline at s = 0. Behind it a finger and the hand."""
    rng = painter.rng
    skin = SKIN[int(rng.integers(len(SKIN)))]
    radius, tilt = rng.uniform(0.5, 0.95), rng.uniform(-0.45, 0.45)
    along = np.array([np.sin(tilt), np.cos(tilt)]) * (1.0 if rng.random() < 0.5 else -1.0)
    middle = np.array([-radius / abs(np.cos(tilt)), 0.0])
    thumb, other = (
        middle + along * (0.15 + 0.5 * radius),
        middle + np.array([-0.6 * radius, 0.0]) + 0.9 * along,
    )
    palm = middle - along * rng.uniform(4.5, 6.0) * radius - np.array([2.2 * radius, 0.0])
    wrist = palm - along * 30 * radius - np.array([rng.uniform(0, 5), 0.0])
    finger_root, thumb_root = palm + np.array([0.3, 0.0]), palm + np.array([1.4 * radius, 0.0])
    # The finger lies behind the thumb, which shades it at its rim.
    hand = capsule(wrist, palm, 2.4 * radius, 2.6 * radius)
    behind = capsule(finger_root, other, 1.15 * radius, 0.8 * radius)
    painter.fill([local(hand), local(behind)], skin, rounding_px=0.35 * radius * thick)
    painter.fill(
        local(capsule(thumb_root, thumb, 1.3 * radius, radius)), skin, rounding_px=0.35 * radius * thick
    )
    nail = local(
        capsule(thumb - 0.05 * along * radius, thumb + 0.4 * along * radius, 0.45 * radius, 0.45 * radius)
    )
    light: Colour = tuple(min(1.0, 1.06 * c + 0.04) for c in skin)  # type: ignore[assignment]
    cv2.fillPoly(painter.image, [fixed(nail)], tone(light), cv2.LINE_AA, 4)


def _pipe(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    rng = painter.rng
    back, wide = -rng.uniform(1.2, 2.2), rng.uniform(0.55, 0.75)
    painter.fill(local(_box(back, 0, -wide, wide)), colour, rounding_px=0.35 * wide * thick)
    band = rng.uniform(0.25, 0.5)
    place = -rng.uniform(0.15, 0.5)
    steel: Colour = (0.72, 0.73, 0.75)
    painter.fill(local(_box(place - band, place, -wide - 0.06, wide + 0.06)), steel, ramp=0.3)
    painter.fill(local(_box(place - band, place, wide, wide + 0.35)), (0.5, 0.5, 0.52))


def _boss(colour: Colour, local: Local, thick: float, painter: Painter) -> None:
    """A stand's rod runs across behind a boss head; the jaw's face is s = 0."""
    image, rng = painter.image, painter.rng
    far = rng.uniform(1.3, 1.9)
    rod = local(np.array([[-far, -14.0], [-far, 14.0]]))
    painter.hose(rod, (0.70, 0.71, 0.72), max(2.0, 0.4 * thick))
    ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    head = np.stack([-far + 0.75 * np.cos(ring), 0.85 * np.sin(ring)], axis=1)
    painter.fill(local(head), colour, ramp=0.3, rounding_px=0.15 * thick)
    painter.fill(local(_box(-far + 0.3, 0, -0.62, 0.62)), colour, ramp=0.25)
    _line(image, local(_box(-far + 0.3, -0.03, -0.62, 0.62)), colour, 1.35)
    _screw(image, local(np.array([[-far, 0.0]]))[0], 0.28 * thick + 0.8)
