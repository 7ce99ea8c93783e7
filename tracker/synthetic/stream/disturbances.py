"""Disturbances of a film: what goes on in a picture besides the actuator, and how its clamp and its camera give way.

What they are, and where they are at a moment of the film; `renderer.py` draws them. Every one is off unless it is asked
for, and no look draws any by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ...types import FloatArray, ImageArray
from .distractors import Painter
from .look import Colour, Look, Place
from .paint import curve

PIVOT = 0.8
"""A clamp that yields turns about a point so far behind its face, in thicknesses of the body."""

SWAY = 0.01
"""How far a cable sways at its middle, as a share of the picture's larger side."""

SHADOW_WIDTH = 0.3
"""Half width of a shadow that passes, as a share of the picture's width."""


@dataclass(frozen=True)
class Tube:
    """A body that hardly moves, such as a supply tube that stiffens under pressure.

    Attributes
    ----------
    look : Look
        Its body, surface and place.
    bend_deg : tuple of float
        Its bend while the actuator is at rest, and at the actuator's largest bend, degrees.
    """

    look: Look
    bend_deg: tuple[float, float]


@dataclass(frozen=True)
class Cable:
    """A cable that sways a little.

    Attributes
    ----------
    knots_xy : tuple of tuple of float
        Places that it passes near, px.
    colour : Colour
    width_px : float
    """

    knots_xy: tuple[tuple[float, float], ...]
    colour: Colour
    width_px: float


@dataclass(frozen=True)
class Hand:
    """A hand that comes in once.

    Attributes
    ----------
    xy : tuple of float
        Where its palm is, px.
    heading_deg : float
        Where its fingers point, from +x toward +y.
    moments : tuple of float
        When it comes and when it is gone again, each from 0 to 1.
    """

    xy: tuple[float, float]
    heading_deg: float
    moments: tuple[float, float]


@dataclass(frozen=True)
class Disturbances:
    """What disturbs a film.

    Tubes and clamp follow the bend. Cable, shadow, hand and shake follow the moment; without one the cable is at rest
    and the others are absent.

    Attributes
    ----------
    tubes : tuple of Tube
    cable : Cable or None
    hand : Hand or None
    shadow : float
        Share of the light that a shadow takes which passes once over the picture; 0 for none.
    shake_px : float
        How far the camera shakes in x and in y, px.
    yield_deg : float
        How far the clamp turns at the largest bend, in proportion to the bend, clockwise on the screen positive,
        degrees in the body's plane.
    """

    tubes: tuple[Tube, ...] = ()
    cable: Cable | None = None
    hand: Hand | None = None
    shadow: float = 0.0
    shake_px: float = 0.0
    yield_deg: float = 0.0

    def place(self, look: Look, bend_deg: float) -> Place:
        """Where the body leaves the clamp at a bend."""
        if not self.yield_deg:
            return look.place
        place = look.place
        turn = math.radians(self.yield_deg * load(look, bend_deg))
        heading = math.radians(place.direction_deg)
        reach = PIVOT * 2 * look.body.half_px
        x = place.base_xy[0] + reach * (math.cos(heading + turn) - math.cos(heading))
        y = place.base_xy[1] + reach * (math.sin(heading + turn) - math.sin(heading))
        return replace(place, base_xy=(x, y), direction_deg=place.direction_deg + math.degrees(turn))

    def shake_xy(self, moment: float | None) -> FloatArray:
        """Shift of the whole picture at a moment, (2,) px."""
        if moment is None or not self.shake_px:
            return np.zeros(2)
        # Two tones in each direction, none of which fits into a film a whole number of times.
        turn = 2 * np.pi * moment * np.array([[7.3, 31.7], [5.9, 26.3]])
        return np.asarray(self.shake_px * (0.6 * np.sin(turn[:, 0]) + 0.4 * np.sin(turn[:, 1] + 1.0)))

    def shadowed(self, image: ImageArray, moment: float | None) -> ImageArray:
        """An image (H, W, 3) with the shadow that passes over it."""
        if moment is None or not self.shadow:
            return image
        across = np.linspace(0, 1, image.shape[1]) - (1.6 * moment - 0.3)
        left = 1 - self.shadow * np.exp(-((across / SHADOW_WIDTH) ** 4))
        return np.asarray(np.rint(image * left[None, :, None]), np.uint8)

    def draw_cable(self, painter: Painter, moment: float | None) -> None:
        """Draw the cable as it hangs at a moment."""
        if self.cable is None:
            return
        knots = np.asarray(self.cable.knots_xy, float)
        if moment is not None:
            height, width = painter.image.shape[:2]
            sway = SWAY * max(height, width) * math.sin(2 * np.pi * 2.7 * moment)
            knots[:, 0] += sway * np.sin(np.pi * np.linspace(0, 1, len(knots)))
        painter.hose(curve(knots), self.cable.colour, self.cable.width_px)

    def draw_hand(self, painter: Painter, moment: float | None) -> None:
        """Draw the hand while it is there."""
        if self.hand is None or moment is None:
            return
        come, gone = self.hand.moments
        if come <= moment < gone:
            painter.hand(np.asarray(self.hand.xy), math.radians(self.hand.heading_deg))


def load(look: Look, bend_deg: float) -> float:
    """Load on the clamp at a bend, as a share of the load at the look's largest bend, 0 to 1."""
    return min(max(bend_deg / max(look.bend_deg[1], 1.0), 0.0), 1.0)


CALM = Disturbances()
"""Nothing disturbs the film."""
