"""Extras: what real footage shows that no look has by itself, on the body and about it.

Here are the kinds, and what a renderer is told of them. Looks stay what they are: extras come on top, where the stream
for pretraining asks for them. They are sampled in `extras_sampling.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...types import FloatArray
from .chain import Projection
from .distractors import Painter
from .finish import BARE, Finish
from .look import Look
from .metal import any_metal, fitting
from .sheets import Sheet, glaring_tape, ruled_sheet

KINDS = (
    *("wrinkled silicone", "rounded tip", "frayed tip", "taped tip", "zip ties"),
    *("thick tube", "bare metal", "ruled paper", "tape glare", "cut two-armed body"),
)
"""Kinds of extras. None has a word of a held-out family: no tint in translucent silicone, no specks, no pipe or rod."""


@dataclass(frozen=True)
class Bystander:
    """Another body that lies behind the labelled one and does not move.

    Attributes
    ----------
    look : Look
        Its body, surface and place.
    bend_deg : float
    finish : Finish
        What it has on it.
    """

    look: Look
    bend_deg: float
    finish: Finish = BARE


@dataclass(frozen=True)
class Fitting:
    """Metal that ends a tube: middle in the body's plane, heading outward from the tube, the tube's width."""

    xy: tuple[float, float]
    heading_deg: float
    width_px: float


@dataclass(frozen=True)
class Extras:
    """What an image shows besides its look.

    Attributes
    ----------
    kinds : tuple of str
        Those of `KINDS` that are there.
    seed : int
        Of where metal and tape lie.
    finish : Finish
        What the labelled body has on it.
    base : str
        What the body leaves: the look's "clamp", a metal "bracket", or a "hub" of the body's own material.
    bystanders : tuple of Bystander
    fittings : tuple of Fitting
    sheet : Sheet or None
    metals, tapes : int
        Pieces of bare metal and strips of tape that lie about.
    """

    kinds: tuple[str, ...] = ()
    seed: int = 0
    finish: Finish = BARE
    base: str = "clamp"
    bystanders: tuple[Bystander, ...] = ()
    fittings: tuple[Fitting, ...] = ()
    sheet: Sheet | None = None
    metals: int = 0
    tapes: int = 0

    def draw_sheet(self, painter: Painter) -> None:
        """Draw the paper, in place."""
        if self.sheet is not None:
            ruled_sheet(painter, self.sheet)

    def draw_things(self, painter: Painter) -> None:
        """Draw metal and tape that lie about, in place."""
        height, width = painter.image.shape[:2]
        for count, thing in ((self.metals, any_metal), (self.tapes, glaring_tape)):
            for _ in range(count):
                place: FloatArray = painter.rng.random(2) * (width, height)
                thing(painter, place, float(painter.rng.uniform(0, np.pi)))

    def draw_fittings(self, painter: Painter, projection: Projection) -> None:
        """Draw what ends the tubes, in place."""
        for end in self.fittings:
            place = projection.to_image(np.asarray(end.xy))
            fitting(painter, place, float(np.radians(end.heading_deg)), end.width_px)


NO_EXTRAS = Extras()
"""Nothing but the look."""
