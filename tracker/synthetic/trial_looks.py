"""Looks of trials: a stream's look with end vectors of a given length, filmed with care.

The plane is seen from the front, so that the angle in the image is the bend; nothing lies over the body, and every
keypoint stays visible over the whole range of angles. Everything else is sampled and drawn by the parts of `stream`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from ..errors import BendtrackError
from ..types import FloatArray
from .stream.body_texture import INNER, OUTER
from .stream.chain import ENDS, Chain, tightest
from .stream.clamps import extent
from .stream.families import HELD_OUT, TRAINING, Families, Words
from .stream.look import Body, Light, Look, Place, Sensor, View
from .stream.look_sampling import THINNEST_PX, TIGHTEST, compose_look
from .stream.rng import Rng

_FRONTAL = View(tilt_x_deg=0.0, tilt_y_deg=0.0, nearness=0.0, lens=0.0)
# A hand does not hold an actuator for many cycles; a stand's rod may come before a tip that points backward.
_NO_CLAMPS = ("fingers", "boss head")
# How far keypoints and the outline keep off the image's edge, and the moving end off the base and its clamp, over the
# image's larger side.
_KEYPOINT_MARGIN, _OUTLINE_MARGIN, _CLEAR = 10 / 640, 3 / 640, 6 / 640
# The part that bends, over the image's smaller side: long enough to bend by 220 degrees beside its own base.
_BENDING_SHARE = (0.38, 0.6)
_ATTEMPTS = 100
_REDRAWS = 8


def trial_look(
    seed: int,
    *,
    size_wh: tuple[int, int] = (640, 480),
    end_vector_px: float = 40.0,
    angle_range_deg: tuple[float, float] = (-20.0, 220.0),
    families: Families = TRAINING,
) -> Look:
    """Draw the look of a trial from a seed. The same arguments draw the same look.

    Parameters
    ----------
    seed : int
        Of the look, from 0.
    size_wh : tuple of int
        Size of the image, px.
    end_vector_px : float
        Distance base_1 - base_2 and tip_1 - tip_2 in the image.
    angle_range_deg : tuple of float
        Over these angles all of the body stays in the image, and the moving end off the base.
    families : Families
        The words that the look may be drawn from.

    Returns
    -------
    Look
        Its `bend_deg` is the range of angles.

    Raises
    ------
    BendtrackError
        A word that is not known, or end vectors that leave no room for the body in the image.
    """
    _check_words(families)
    clamps = tuple(word for word in families.clamps if word not in _NO_CLAMPS) or families.clamps
    for redraw in range(_REDRAWS):
        rng = Rng(seed, 14, redraw)
        place = partial(_placed, size_wh, end_vector_px, angle_range_deg, rng)
        try:
            look = compose_look(rng, size_wh, replace(families, clamps=clamps), angle_range_deg, place)
        except _NoRoomError:
            continue
        return replace(
            look,
            view=_FRONTAL,
            scene=replace(look.scene, occluders=0),
            light=_steady(look.light),
            sensor=_careful(look.sensor),
        )
    raise BendtrackError(
        f"expected end vectors that leave room for the body in an image of {size_wh[0]} x {size_wh[1]} px, "
        f"got {end_vector_px:g} px"
    )


class _NoRoomError(Exception):
    """This body fits nowhere; another one may."""


def _check_words(families: Families) -> None:
    for name, words in vars(families).items():
        known = getattr(TRAINING, name) + getattr(HELD_OUT, name)
        for word in words:
            if word not in known:
                raise BendtrackError(f"{name}: expected one of {', '.join(known)}, got {word!r}")


def _steady(light: Light) -> Light:
    """Lamps and exposure of a laboratory: neither much too dark nor too bright, and hardly drifting."""
    return replace(light, gain=float(np.clip(light.gain, 0.85, 1.15)), drift=min(light.drift, 0.03))


def _careful(sensor: Sensor) -> Sensor:
    """A camera on a stand, in focus and at its full resolution; H.264 comes when the film is written."""
    return replace(
        sensor,
        blur_px=min(sensor.blur_px, 1.1),
        motion_px=0.0,
        noise=min(sensor.noise, 2.6),
        jpeg_quality=max(sensor.jpeg_quality, 60) if sensor.jpeg_quality else 0,
        h264_crf=0,
        shrink=1.0,
    )


def _placed(
    size_wh: tuple[int, int],
    end_vector_px: float,
    angles_deg: tuple[float, float],
    rng: Rng,
    words: Words,
    body: Body,
    _: View,
) -> tuple[Body, Place]:
    """Draw sizes and places until one fits; bodies become smaller while none does."""
    bends, unit, clamp = np.linspace(*angles_deg, 25), float(max(size_wh)), extent(words.clamp)
    for attempt in range(_ATTEMPTS):
        sized = _sized(body, size_wh, end_vector_px, angles_deg, 1 - 0.3 * attempt / _ATTEMPTS, rng)
        place = Place((0.0, 0.0), rng.uniform(0, 360), 1 if rng.bernoulli(0.5) else -1, None)
        # The largest bend first: where it does not fit, the others need not be looked at.
        if not all(_clear(Chain(sized, place, float(b)), clamp, _CLEAR * unit) for b in bends[::-1]):
            continue
        low, high = _reach([Chain(sized, place, float(b)) for b in bends], sized, clamp[0], unit)
        room = np.asarray(size_wh) - 1 - (high - low)
        if (room >= 0).all():
            x, y = (rng.generator.random(2) * room - low).tolist()
            return sized, replace(place, base_xy=(x, y))
    raise _NoRoomError


def _sized(
    body: Body,
    size_wh: tuple[int, int],
    end_vector_px: float,
    angles_deg: tuple[float, float],
    scale: float,
    rng: Rng,
) -> Body:
    """The body in px: straight ends of the length wanted, and no thicker than its tightest bend allows."""
    bending = min(size_wh) * rng.uniform(*_BENDING_SHARE) * scale
    length = bending + 2 * end_vector_px
    body = replace(
        body,
        length_px=length,
        base_share=end_vector_px / length,
        tip_share=end_vector_px / length,
        # A film shows one bend to one side; the tip's direction is then that of its straight end.
        focus=min(body.focus, 0.8),
        s_turn_deg=float(np.clip(body.s_turn_deg, -8, 8)),
    )
    low, high = angles_deg
    folds = max(tightest(body, low) * OUTER, tightest(body, high) * INNER)
    thinnest = 0.5 * THINNEST_PX * max(size_wh) / 256
    half = min(max(body.half_px * length * scale**3, thinnest), TIGHTEST / folds)
    return replace(body, half_px=half)


def _outer(body: Body) -> float:
    """How far the body reaches outward at full pressure, in half thicknesses."""
    return min(1 + body.swell * (1 + body.uneven), OUTER)


def _reach(chains: list[Chain], body: Body, behind: float, unit: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the box that the outline, the keypoints and the clamp need with their margins, (2,) px each."""
    outlines, keypoints = [], []
    for chain in chains:
        s = np.linspace(0, chain.length_px, 30)
        half = chain.half_px_at(s)
        outlines += [chain.point(s, -half), chain.point(s, _outer(body) * half)]
        keypoints.append(chain.point(chain.keypoint_s[ENDS]))
    base = chains[0]
    seen = [base.point(-behind * body.half_px, side * body.half_px)[None] for side in (-1, 1)]
    outline, points = np.concatenate(outlines + seen), np.concatenate(keypoints)
    low = np.minimum(
        outline.min(axis=0) - _OUTLINE_MARGIN * unit, points.min(axis=0) - _KEYPOINT_MARGIN * unit
    )
    high = np.maximum(
        outline.max(axis=0) + _OUTLINE_MARGIN * unit, points.max(axis=0) + _KEYPOINT_MARGIN * unit
    )
    return low, high


def _clear(chain: Chain, clamp: tuple[float, float], margin_px: float) -> bool:
    """Whether the moving half of the body keeps off the straight base, and the moving end's points off the clamp."""
    base_half = float(chain.half_px_at(np.array(0.0)))
    axes = np.stack([chain.along[0], -chain.inward[0]], axis=1)
    s = np.linspace(chain.s[len(chain.s) // 2 + 1], chain.length_px, 24)
    half = chain.half_px_at(s)
    moving = np.concatenate([chain.point(s, -half), chain.point(s, OUTER * half)])
    along, aside = ((moving - chain.origin[0]) @ axes).T
    at_base = (along > -margin_px) & (along < chain.s[1] + margin_px)
    at_base &= (aside > -base_half - margin_px) & (aside < OUTER * base_half + margin_px)
    along, aside = ((chain.point(chain.keypoint_s[ENDS[2:]]) - chain.origin[0]) @ axes).T
    at_clamp = (along < margin_px) & (along > -clamp[0] * 2 * base_half - margin_px)
    at_clamp &= np.abs(aside) < clamp[1] * 2 * base_half + margin_px
    return not (at_base.any() or at_clamp.any())
