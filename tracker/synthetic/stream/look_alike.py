"""Bodies that may be taken for the actuator, laid where they hide nothing of it: a thick tube, a second arm.

Both are of the actuator's own material. Neither has what makes an actuator: the tube has no free end, the arm is cut by
the image's edge.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...types import BoolArray, FloatArray
from .body_texture import OUTER
from .chain import Chain, Projection, tightest
from .clamps import reach
from .extras import Fitting
from .look import Body, Look, Place
from .look_sampling import TIGHTEST
from .paint import axes
from .rng import Rng

TUBE_THICKNESS = (0.7, 1.35)
"""Thickness of a tube over the body's: thinner ones differ from it by their thickness alone."""

_ATTEMPTS = 8
_ARM_ATTEMPTS = 18
# How far two bodies keep apart, over the sum of their half thicknesses: a chamber reaches farther than the midline's.
_APART = 1.25
# Of a tube this much of the body's length is to be seen, and of an arm this much.
_TUBE_SEEN, _ARM_SEEN = 0.45, 0.15
# The beginning of an arm may lie under the hub or the clamp, this many thicknesses of it.
_UNDER_HUB = 1.8


def thick_tube(look: Look, bend_deg: float, rng: Rng) -> tuple[Look, float, tuple[Fitting, ...]] | None:
    """A smooth tube of the body's own material, about as thick as the body.

    It runs through the image, or out of the clamp, or lies between two fittings.

    Parameters
    ----------
    look : Look
        Of the actuator. The tube keeps clear of it over the range of its bends.
    bend_deg : float
        One more bend that it keeps clear of.
    rng : Rng

    Returns
    -------
    look, bend_deg, fittings
        The tube's body, surface and place; its bend; what ends it within the image. None where none fits.
    """
    kind = rng.choice(("through", "clamp", "between"))
    # What comes out of the clamp is near the body's beginning.
    first_px = 0.3 * look.body.length_px if kind == "clamp" else 0.0
    own = np.concatenate([_line(chain, first_px) for chain in _chains(look, bend_deg)])
    projection = Projection(look.view, look.size_wh)
    for _ in range(_ATTEMPTS):
        half = look.body.half_px * rng.uniform(*TUBE_THICKNESS)
        start, heading, length = _begin(kind, look, half, rng)
        x, y = start.tolist()
        body = _smooth(look.body, length, half, rng)
        place = Place((x, y), heading, 1 if rng.bernoulli(0.5) else -1, None)
        own_deg = rng.uniform(10, 110)
        if tightest(body, own_deg) * half > TIGHTEST:
            continue
        tube = Chain(body, place, own_deg)
        line = _line(tube)
        seen_px = _seen_px(tube, line, projection, look.size_wh)
        if seen_px < _TUBE_SEEN * look.body.length_px or not _clear(line, own, half + look.body.half_px):
            continue
        ends = [(np.asarray(tube.end_xy), tube.heading[-1])]
        if kind == "between":
            ends.append((start, tube.heading[0] + np.pi))
        fittings = tuple(
            Fitting((float(xy[0]), float(xy[1])), float(np.degrees(way)), 2 * half)
            for xy, way in ends
            if _seen(projection.to_image(xy[None]), look.size_wh)[0]
        )
        return replace(look, body=body, place=place), own_deg, fittings
    return None


def second_arm(look: Look, bend_deg: float, rng: Rng) -> tuple[Look, float] | None:
    """Another arm of the same body, at rest or bent, whose tip is out of the image.

    Parameters
    ----------
    look : Look
        Of the labelled arm. The other one keeps clear of it over the range of its bends.
    bend_deg : float
        One more bend. Where base or tip of the labelled arm leave the image there is no other one.
    rng : Rng

    Returns
    -------
    look, bend_deg
        The arm's body, surface and place, and its bend. None where none fits.
    """
    chains, projection = _chains(look, bend_deg), Projection(look.view, look.size_wh)
    ends = np.concatenate([chain.point(chain.keypoint_s[[0, -1]]) for chain in chains])
    if not _seen(projection.to_image(ends), look.size_wh).all():
        return None
    own, thick = np.concatenate([_line(chain) for chain in chains]), 2 * look.body.half_px
    along, _ = axes(np.radians(look.place.direction_deg))
    for _ in range(_ARM_ATTEMPTS):
        x, y = (np.asarray(look.place.base_xy) - rng.uniform(0.5, 1.8) * thick * along).tolist()
        place = Place(
            (x, y),
            look.place.direction_deg + 180 + rng.uniform(-80, 80),
            1 if rng.bernoulli(0.5) else -1,
            None,
        )
        # How long it is beyond the edge is not to be seen.
        longer = rng.uniform(1.0, 2.4)
        own_deg = rng.normal(0, 5) if rng.bernoulli(0.45) else rng.uniform(20, 150)
        if _ends_inside(place, own_deg, longer * look.body.length_px, look.size_wh):
            continue
        body = replace(
            look.body,
            seed=rng.seed(),
            length_px=look.body.length_px * longer,
            chambers=max(round(look.body.chambers * longer), 1),
            windings=round(look.body.windings * longer),
            cap="none",
        )
        if tightest(body, own_deg) * body.half_px * OUTER > TIGHTEST:
            continue
        arm = Chain(body, place, own_deg)
        line = _line(arm)
        seen_px = _seen_px(arm, line, projection, look.size_wh) - _UNDER_HUB * thick
        beyond = _seen(projection.to_image(line[-1:]), look.size_wh, body.half_px)
        if beyond[0] or seen_px < _ARM_SEEN * look.body.length_px:
            continue
        if _clear(_line(arm, 1.2 * thick), own, thick):
            return replace(look, body=body, place=place), own_deg
    return None


def _chains(look: Look, bend_deg: float) -> list[Chain]:
    """The labelled body at a bend and over the range of its bends."""
    bends = {bend_deg, *np.linspace(*look.bend_deg, 5).tolist()}
    return [Chain(look.body, look.place, bend) for bend in sorted(bends)]


def _begin(kind: str, look: Look, half_px: float, rng: Rng) -> tuple[FloatArray, float, float]:
    """Where a tube begins, (2,) px, its heading there, degrees, and its length, px."""
    size, heading = np.asarray(look.size_wh, float), rng.uniform(0, 360)
    if kind == "through":
        # It comes in at the border, toward somewhere in the middle.
        aim = size * (rng.uniform(0.1, 0.9), rng.uniform(0.1, 0.9))
        along, _ = axes(np.radians(heading))
        away = float(np.min(np.where(along > 0, size - aim, -aim) / np.where(along == 0, 1e-9, along)))
        start: FloatArray = aim + (away + 3 * half_px) * along
        return start, heading + 180 + rng.normal(0, 12), 1.7 * float(size.max())
    if kind == "clamp":
        base_deg = look.place.direction_deg
        along, _ = axes(np.radians(base_deg))
        start = (
            np.asarray(look.place.base_xy) - 2 * look.body.half_px * (reach(look.words.clamp) - 0.3) * along
        )
        return start, base_deg + 180 + rng.normal(0, 18), look.body.length_px * rng.uniform(0.6, 1.8)
    start = size * (rng.uniform(0.05, 0.95), rng.uniform(0.05, 0.95))
    return start, heading, look.body.length_px * rng.uniform(0.6, 1.6)


def _smooth(body: Body, length_px: float, half_px: float, rng: Rng) -> Body:
    """A round tube, bent here or there, sometimes with the ribs of a corrugated hose."""
    ribbed = rng.bernoulli(0.4)
    return replace(
        body,
        seed=rng.seed(),
        length_px=length_px,
        half_px=half_px,
        stretch=0.0,
        taper=0.0,
        base_share=0.03,
        tip_share=0.03,
        centre=rng.uniform(0.1, 0.9),
        focus=rng.uniform(0.0, 2.5),
        spread=rng.uniform(0.2, 0.4),
        s_turn_deg=rng.normal(0, 45),
        valley="wave" if ribbed else "none",
        chambers=max(round(length_px / (half_px * rng.uniform(0.35, 0.6))), 3),
        two_sided=True,
        depth=rng.uniform(0.03, 0.08) if ribbed else 0.0,
        swell=0.0,
        rim=rng.uniform(0.85, 1.0),
        windings=0,
        layer=0.0,
        cap="none",
        tip_round=0.1,
    )


def _ends_inside(place: Place, bend_deg: float, length_px: float, size_wh: tuple[int, int]) -> bool:
    """Whether a body that bends evenly would end well inside the image: quicker than its chain."""
    half_turn = math.radians(bend_deg) / 2
    chord = length_px * (math.sin(half_turn) / half_turn if abs(half_turn) > 1e-6 else 1.0)
    heading = math.radians(place.direction_deg) + place.side * half_turn
    x, y = place.base_xy[0] + chord * math.cos(heading), place.base_xy[1] + chord * math.sin(heading)
    margin = 0.1 * length_px
    return margin < x < size_wh[0] - margin and margin < y < size_wh[1] - margin


def _seen(image_xy: FloatArray, size_wh: tuple[int, int], beyond_px: float = 0.0) -> BoolArray:
    """Which points are in the image, or up to `beyond_px` outside of it; (N,) bool."""
    high = np.asarray(size_wh) - 0.5 + beyond_px
    return np.asarray(((image_xy > -0.5 - beyond_px) & (image_xy < high)).all(axis=1))


def _line(chain: Chain, first_px: float = 0.0) -> FloatArray:
    """Midline points from `first_px` along it on, and its end, (N, 2) px; the chain knows both already."""
    return np.concatenate([chain.origin[chain.s >= first_px], chain.end_xy[None]])


def _seen_px(chain: Chain, line: FloatArray, projection: Projection, size_wh: tuple[int, int]) -> float:
    """Length of a midline that is in the image, px; `line` holds its whole `_line`."""
    seen = _seen(projection.to_image(line), size_wh).astype(float)
    return float(np.diff(np.append(chain.s, chain.length_px)) @ (seen[1:] + seen[:-1]) / 2)


def _clear(line: FloatArray, other: FloatArray, reach_px: float) -> bool:
    """Whether two bodies keep apart, by points of their midlines and the sum of their half thicknesses."""
    distance = np.hypot(line[:, None, 0] - other[:, 0], line[:, None, 1] - other[:, 1])
    return float(distance.min(initial=np.inf)) > _APART * reach_px + 2
