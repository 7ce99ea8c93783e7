"""Distractors: what lies about in a laboratory, behind the body or as an occluder in front of it.

How many of them, and where, is decided in `renderer.py` and `backgrounds.py`."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .look import Colour
from .paint import Shade, axes, capsule, curve, fixed, rectangle, solid, strokes, tone
from .rng import hue_colour

SKIN: tuple[Colour, ...] = (
    *((0.91, 0.72, 0.61), (0.84, 0.62, 0.50), (0.72, 0.50, 0.38)),
    *((0.55, 0.37, 0.27), (0.38, 0.25, 0.19), (0.45, 0.60, 0.85), (0.93, 0.93, 0.92)),
)


def any_colour(rng: np.random.Generator, grey: float = 0.5) -> Colour:
    """Of plastics and papers: grey ones as often as `grey`."""
    level = rng.uniform(0.08, 0.95)
    if rng.random() < grey:
        warm = rng.normal(0, 0.02)
        return (float(np.clip(level + warm, 0, 1)), level, float(np.clip(level - warm, 0, 1)))
    hue, saturation = rng.uniform(0, 6), rng.uniform(0.3, 0.95)
    return hue_colour(hue, saturation, level)


class Painter:
    """Draws distractors into one image, in place.

    Parameters
    ----------
    unit_px : float
        Larger side of the image / 256.
    shade : Shade or None
        The shadow that they throw, or None.
    cover : ndarray or None
        (H, W) uint8 that gets what they cover, or None.
    """

    def __init__(
        self,
        image: ImageArray,
        rng: np.random.Generator,
        unit_px: float,
        shade: Shade | None = None,
        cover: ImageArray | None = None,
    ) -> None:
        self.image, self.rng, self.unit = image, rng, unit_px
        self.shade, self.cover = shade, cover

    def any_distractor(self, place: FloatArray, heading: float) -> None:
        """One distractor that may lie on a bench."""
        kinds: tuple[Callable[[FloatArray, float], None], ...] = (
            *(self.sheet, self.sheet, self.box, self.box, self.ruler, self.pen, self.pen, self.cable),
            *(self.cable, self.tape, self.disc, self.disc, self.hand, self.breadboard),
        )
        kinds[int(self.rng.integers(len(kinds)))](place, heading)

    def any_occluder(self, place: FloatArray, heading: float) -> None:
        """One occluder, narrow enough to leave most of the body visible."""
        kinds = (self.pen, self.cable, self.cable, self.tape, self.finger, self.ruler)
        kinds[int(self.rng.integers(len(kinds)))](place, heading)

    def fill(
        self,
        outline: FloatArray | list[FloatArray],
        colour: Colour,
        ramp: float = 0.0,
        rounding_px: float = 0.0,
    ) -> None:
        """Fill an outline; see `paint.solid`."""
        solid(
            self.image, outline, colour, self.rng,
            ramp=ramp, rounding_px=rounding_px, shade=self.shade, cover=self.cover,
        )  # fmt: skip

    def _patch(self, outline: FloatArray, colour: Colour) -> None:
        """Fill an outline on top of what is there: no shadow."""
        for image, filled in ((self.image, tone(colour)), (self.cover, 255)):
            if image is not None:
                cv2.fillPoly(image, [fixed(outline)], filled, cv2.LINE_AA, 4)

    def sheet(self, place: FloatArray, heading: float) -> None:
        """A paper with some print on it."""
        rng, unit = self.rng, self.unit
        along, across = axes(heading)
        length, width = rng.uniform(40, 130, 2) * unit
        colour = any_colour(rng, 0.8) if rng.random() < 0.4 else (0.90, 0.90, 0.88)
        self.fill(rectangle(place, along, length, width), colour, 0.06)
        rows = int(rng.integers(0, 9))
        v = np.linspace(-0.4, 0.4, max(rows, 1))[:rows, None] * width * across
        ends = rng.uniform(-0.1, 0.42, (rows, 1)) * length * along
        ink: Colour = tuple(0.35 * c for c in colour)  # type: ignore[assignment]
        strokes(self.image, np.stack([place + v - 0.42 * length * along, place + v + ends], axis=1), ink)

    def box(self, place: FloatArray, heading: float) -> None:
        """A box or an instrument: two faces, perhaps buttons."""
        rng, unit = self.rng, self.unit
        along, _ = axes(heading)
        length, width = rng.uniform(18, 90, 2) * unit
        colour = any_colour(rng)
        outline = rectangle(place, along, length, width)
        self.fill(outline, colour)
        side = np.array(
            [outline[0], outline[1], outline[1] + (0, 0.25 * width), outline[0] + (0, 0.25 * width)]
        )
        cv2.fillPoly(self.image, [fixed(side)], tone(colour, rng.uniform(0.5, 1.3)), cv2.LINE_AA, 4)
        for _ in range(int(rng.integers(0, 5))):
            spot = place + along * rng.uniform(-0.4, 0.4) * length
            cv2.circle(
                self.image,
                tuple(fixed(spot)),
                int(rng.uniform(1, 4) * unit * 16),
                tone(any_colour(rng)),
                -1,
                cv2.LINE_AA,
                4,
            )

    def ruler(self, place: FloatArray, heading: float) -> None:
        """Ticks on steel, wood or plastic."""
        rng, unit = self.rng, self.unit
        along, across = axes(heading)
        length, width, pitch = (
            rng.uniform(90, 300) * unit,
            rng.uniform(9, 20) * unit,
            rng.uniform(2.2, 5) * unit,
        )
        colours: tuple[Colour, ...] = (
            (0.75, 0.76, 0.78),
            (0.82, 0.67, 0.42),
            (0.93, 0.93, 0.90),
            (0.95, 0.82, 0.2),
        )
        self.fill(rectangle(place, along, length, width), colours[int(rng.integers(4))])
        number = np.arange(int(length / pitch))
        start = place + (number[:, None] * pitch - 0.5 * length) * along + 0.5 * width * across
        end = start - np.where(number % 5 == 0, 0.55, 0.3)[:, None] * width * across
        strokes(self.image, np.stack([start, end], axis=1), (0.12, 0.12, 0.14))

    def pen(self, place: FloatArray, heading: float) -> None:
        """A pen, a screwdriver or a rod: a shaft with a tip and a cap."""
        rng, unit = self.rng, self.unit
        along, across = axes(heading)
        length, width = rng.uniform(60, 130) * unit, rng.uniform(3.5, 8) * unit
        colour = any_colour(rng, 0.3)
        self.hose(place + np.array([[-0.5], [0.5]]) * length * along, colour, width)
        tip = place + 0.5 * length * along
        cone = np.array([tip - 0.5 * width * across, tip + 0.5 * width * across, tip + 1.6 * width * along])
        self._patch(cone, any_colour(rng))
        cap = rectangle(place - 0.35 * length * along, along, 0.3 * length, 1.15 * width)
        self._patch(cap, any_colour(rng, 0.3))

    def cable(self, place: FloatArray, heading: float) -> None:
        """A cable or hose that runs through."""
        rng, unit = self.rng, self.unit
        turn = heading + np.cumsum(rng.normal(0, 0.45, 8))
        steps = 45 * unit * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        knots = place + np.cumsum(steps, axis=0) - steps[:4].sum(axis=0)
        self.hose(curve(knots), any_colour(rng, 0.55), rng.uniform(1.2, 4.5) * unit)

    def hose(self, line: FloatArray, colour: Colour, width_px: float) -> None:
        """A round line: strokes from its rim to its highlight."""
        points = [fixed(line)]
        if self.shade is not None:
            moved = [fixed(line + self.shade.offset_xy)]
            cv2.polylines(
                self.image, moved, False, tone((0.16, 0.16, 0.16)), max(1, int(width_px)), cv2.LINE_AA, 4
            )
        light = [fixed(line - (0.12 * width_px, 0.15 * width_px))]
        for share, factor, drawn in (
            (1.0, 0.68, points),
            (0.78, 0.86, points),
            (0.5, 1.0, points),
            (0.2, 1.18, light),
        ):
            cv2.polylines(
                self.image,
                drawn,
                False,
                tone(colour, factor),
                max(1, round(width_px * share)),
                cv2.LINE_AA,
                4,
            )
        if self.cover is not None:
            cv2.polylines(self.cover, points, False, 255, max(1, round(width_px)), cv2.LINE_AA, 4)

    def tape(self, place: FloatArray, heading: float) -> None:
        """A strip of adhesive tape."""
        rng, unit = self.rng, self.unit
        along, _ = axes(heading)
        colours: tuple[Colour, ...] = (
            (0.90, 0.85, 0.65),
            (0.15, 0.25, 0.6),
            (0.12, 0.12, 0.13),
            (0.85, 0.83, 0.78),
            (0.75, 0.2, 0.15),
        )
        self.fill(
            rectangle(place, along, rng.uniform(25, 90) * unit, rng.uniform(5, 14) * unit),
            colours[int(rng.integers(5))],
        )

    def disc(self, place: FloatArray, heading: float) -> None:
        """A roll, a cup, a weight: rings."""
        rng, unit = self.rng, self.unit
        radius, colour = rng.uniform(6, 32) * unit, any_colour(rng)
        arc = np.linspace(0, 2 * np.pi, 28, endpoint=False) + heading
        ring = np.stack([np.cos(arc), np.sin(arc) * rng.uniform(0.6, 1)], axis=1)
        self.fill(place + radius * ring, colour)
        for share in (0.8, rng.uniform(0.2, 0.7)):
            cv2.fillPoly(
                self.image,
                [fixed(place + radius * share * ring)],
                tone(colour, rng.uniform(0.5, 1.2)),
                cv2.LINE_AA,
                4,
            )

    def finger(self, place: FloatArray, heading: float) -> None:
        """A finger whose end is at `place`, from there against the heading."""
        rng, unit = self.rng, self.unit
        radius = rng.uniform(4, 8) * unit
        skin = SKIN[int(rng.integers(len(SKIN)))]
        along, _ = axes(heading)
        end = place - radius * along
        hand = capsule(end - 30 * radius * along, end - 9 * radius * along, 2.8 * radius, 2.6 * radius)
        self.fill(
            [hand, capsule(end - 8 * radius * along, end, 1.3 * radius, radius)], skin, 0.12, 0.5 * radius
        )
        nail: Colour = tuple(min(1.0, 1.08 * c + 0.03) for c in skin)  # type: ignore[assignment]
        spot = capsule(end - 0.3 * radius * along, end + 0.45 * radius * along, 0.42 * radius, 0.42 * radius)
        cv2.fillPoly(self.image, [fixed(spot)], tone(nail), cv2.LINE_AA, 4)

    def hand(self, place: FloatArray, heading: float) -> None:
        """A palm with fingers, gloved or not."""
        rng, unit = self.rng, self.unit
        skin, radius = SKIN[int(rng.integers(len(SKIN)))], rng.uniform(6, 10) * unit
        along, across = axes(heading)
        arm = capsule(place - 26 * radius * along, place - 3 * radius * along, 1.9 * radius, 1.8 * radius)
        palm = capsule(place - 3 * radius * along, place, 2.3 * radius, 2.5 * radius)
        fingers = []
        for number in range(4):
            start = place + across * (number - 1.5) * 1.35 * radius + along * radius
            turn = heading + (number - 1.5) * 0.12 + rng.normal(0, 0.08)
            end = start + rng.uniform(3, 5.5) * radius * np.array([np.cos(turn), np.sin(turn)])
            fingers.append(capsule(start, end, 0.85 * radius, 0.75 * radius))
        self.fill([arm, palm, *fingers], skin, 0.15, 0.7 * radius)

    def breadboard(self, place: FloatArray, heading: float) -> None:
        """A board with holes or chips."""
        rng, unit = self.rng, self.unit
        along, across = axes(heading)
        length, width = rng.uniform(50, 110) * unit, rng.uniform(20, 50) * unit
        boards: tuple[Colour, ...] = (
            (0.92, 0.91, 0.87),
            (0.08, 0.30, 0.16),
            (0.10, 0.22, 0.45),
            (0.12, 0.12, 0.13),
        )
        self.fill(rectangle(place, along, length, width), boards[int(rng.integers(4))])
        u, v = np.meshgrid(np.linspace(-0.45, 0.45, 18) * length, np.linspace(-0.4, 0.4, 6) * width)
        holes = place + u.reshape(-1, 1) * along + v.reshape(-1, 1) * across
        strokes(self.image, np.stack([holes, holes + 0.8 * along], axis=1), (0.35, 0.34, 0.32))
