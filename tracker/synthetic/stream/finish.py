"""What a body has on it besides its look: creases and streaks of light, zip ties, and a tip that is frayed or taped.

Drawn on the texture in body coordinates (`look.py`); `body_texture.py` calls it. What sticks out of the texture (loose
threads, tails of ties) is drawn in the image, in place. Which bodies have any is decided in `extras_sampling.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .chain import Chain, Projection
from .look import Body, Colour, Light
from .noise import noise_field
from .paint import fixed, tone

TIE_HEAD_V = 1.12
"""Where the middle of a tie's head lies that is seen from the side, in half thicknesses."""

_WHOLE_STRAND, _STRAND_PX = 0.22, 1.6
"""A frayed tip keeps this much about its midline, in half thicknesses and at least in px: there the body ends where its
truth says."""


@dataclass(frozen=True)
class Tie:
    """A zip tie round the body.

    Attributes
    ----------
    at : float
        Its middle, as a share of the body's length.
    width : float
        Half thicknesses.
    colour : Colour
    head_v : float
        Where its head is across the body, half thicknesses.
    tail : float
        Length of the end that sticks out of the head, half thicknesses; 0 where it is cut off.
    """

    at: float
    width: float
    colour: Colour
    head_v: float
    tail: float


@dataclass(frozen=True)
class Tape:
    """Tape wrapped round the tip, up to its end.

    Attributes
    ----------
    share : float
        Its length as a share of the body's.
    colour : Colour
    opacity : float
        1 hides the body.
    glare : float
        Height of the lamp's reflection on it, 0 to 1.
    outline : float
        Its half thickness over the body's.
    flag : float
        How far its loose end stands off the outer side, half thicknesses; 0 for none.
    """

    share: float
    colour: Colour
    opacity: float
    glare: float
    outline: float
    flag: float


@dataclass(frozen=True)
class Finish:
    """What a body has on it.

    Attributes
    ----------
    crease_px : float
        Depth of creases across the body, px; 0 for none.
    streak : float
        Height of the streaks in which lamps are reflected along the body, 0 to 1.
    ties : tuple of Tie
    fray : float
        Length of a frayed tip's fringe as a share of the body's; 0 for none.
    tape : Tape or None
    """

    crease_px: float = 0.0
    streak: float = 0.0
    ties: tuple[Tie, ...] = ()
    fray: float = 0.0
    tape: Tape | None = None


BARE = Finish()
"""Nothing on the body."""


def outline(
    finish: Finish, chain: Chain, s: FloatArray, top: FloatArray, bottom: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The outline with what is round the body.

    Parameters
    ----------
    s : ndarray
        (U,) places along the body, px.
    top, bottom : ndarray
        (U,) outline on the outer and the inner side, half thicknesses.
    """
    for tie in finish.ties:
        away, width = _from_tie(tie, chain, s)
        round_it = away < 0.5 * width
        top, bottom = np.where(round_it, 0.95 * top, top), np.where(round_it, 0.95 * bottom, bottom)
        if tie.head_v > 1:
            top = np.where(away < 0.8 * width, np.maximum(top, tie.head_v + 0.24), top)
    if finish.tape is not None:
        tape = finish.tape
        wrapped = s > chain.length_px * (1 - tape.share)
        top = np.where(wrapped, tape.outline, top)
        bottom = np.where(wrapped, min(tape.outline, 1.13), bottom)
        loose = wrapped & (s > chain.length_px * (1 - 0.75 * tape.share))
        loose &= s < chain.length_px * (1 - 0.25 * tape.share)
        top = np.where(loose, tape.outline + tape.flag, top)
    return top, bottom


def ends_px(finish: Finish, body: Body, chain: Chain, v: FloatArray) -> FloatArray:
    """Where the body ends at each place across it, (V, 1) px: a frayed one earlier away from its midline."""
    rng = np.random.default_rng([body.seed, 12])
    strands = np.sort(rng.uniform(-1.1, 1.1, int(rng.integers(7, 14))))
    lengths = rng.uniform(0.0, 1.0, len(strands) + 1)
    ragged = lengths[np.searchsorted(strands, v[:, 0])]
    # Between two strands there is a slit.
    slit = np.abs(v - strands).min(axis=1) < 0.045
    ragged = np.where(slit, np.maximum(ragged, 0.75), ragged)
    kept = max(_WHOLE_STRAND, _STRAND_PX / float(chain.half_px_at(np.array(chain.length_px))))
    ragged = np.where(np.abs(v[:, 0]) < kept, 0.0, ragged)
    missing: FloatArray = (chain.length_px * finish.fray * ragged)[:, None].astype(np.float32)
    return np.float32(chain.length_px) - missing


def add_relief(
    finish: Finish, body: Body, chain: Chain, s: FloatArray, v: FloatArray, relief: FloatArray
) -> FloatArray:
    """The relief (V, U), px, with creases, ties and tape."""
    if finish.crease_px:
        rng = np.random.default_rng([body.seed, 13])
        shape = (len(v), len(s))
        # Drawn narrow and spread across the body: long creases that run across it.
        narrow = noise_field(rng, (max(shape[0] // 5, 2), shape[1]), 6)
        across = cv2.resize(narrow, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
        waves = across + np.float32(0.5) * noise_field(rng, shape, 12)
        # The inner side is pressed together and creases more.
        pressed = np.minimum(np.maximum(np.float32(0.65) - np.float32(0.55) * v, np.float32(0.2)), 1)
        relief = relief - np.float32(finish.crease_px) * pressed * np.exp(np.float32(-4) * waves * waves)
    for tie in finish.ties:
        away, width = _from_tie(tie, chain, s)
        half = np.float32(body.half_px)
        height = _smooth((0.5 * width - away) / (0.25 * width))
        relief = relief + (np.float32(0.14) * half) * height
    if finish.tape is not None:
        wrapped = _smooth(s - chain.length_px * (1 - finish.tape.share))
        relief = relief * (1 - np.float32(0.6) * wrapped)
    return relief


def add_gloss(
    finish: Finish,
    body: Body,
    light: Light,
    chain: Chain,
    s: FloatArray,
    v: FloatArray,
    gloss: FloatArray,
) -> FloatArray:
    """The highlight (V, U) with streaks along the body and the glare of tape."""
    rng = np.random.default_rng([body.seed, 14])
    if finish.streak:
        windows = (light.azimuth_deg, light.azimuth_deg + float(rng.uniform(90, 270)))
        for azimuth_deg, share in zip(windows, (1.0, 0.55), strict=True):
            middle = _mirror_v(body, light, azimuth_deg, chain, s)
            broken = _smooth(noise_field(rng, (1, len(s)), 24)[0] * np.float32(0.8) + np.float32(0.65))
            wobble = np.float32(0.05) * noise_field(rng, (1, len(s)), 12)[0]
            # As narrow as a px would be lost.
            width = max(float(rng.uniform(0.07, 0.2)), 1.2 / body.half_px)
            away = (v - (middle + wobble)) / np.float32(width)
            gloss = gloss + np.float32(share * finish.streak) * broken * np.exp(-away * away)
    if finish.tape is not None and finish.tape.glare:
        tape = finish.tape
        u = (s - chain.length_px * (1 - tape.share)) / np.float32(chain.length_px * tape.share)
        place, lean, width = rng.uniform(0.25, 0.75), rng.uniform(-0.25, 0.25), rng.uniform(0.08, 0.2)
        away = (u - np.float32(place) - np.float32(lean) * v) / np.float32(width)
        shine = np.exp(-away * away) * (u > 0)
        gloss = gloss + np.float32(tape.glare) * shine.astype(np.float32)
    return gloss


def mixes(
    finish: Finish, chain: Chain, s: FloatArray, v: FloatArray, per_px: float
) -> list[tuple[FloatArray, Colour]]:
    """What lies over the body's colour: coverage from 0 to 1, (V, U) or (1, U), and colour."""
    over: list[tuple[FloatArray, Colour]] = []
    for tie in finish.ties:
        away, width = _from_tie(tie, chain, s)
        band = _smooth((0.5 * width - away) * per_px + 0.5)[None]
        over.append((band.astype(np.float32), tie.colour))
        head = np.minimum(0.8 * width - away, (0.3 - np.abs(v - tie.head_v)) * chain.half_px_at(s))
        covered = _smooth(head.astype(np.float32) * np.float32(per_px) + np.float32(0.5))
        lighter: Colour = tuple(min(1.25 * c + 0.05, 1.0) for c in tie.colour)  # type: ignore[assignment]
        over.append((covered, lighter))
    if finish.tape is not None:
        wrapped = _smooth((s - chain.length_px * (1 - finish.tape.share)) * per_px + 0.5)[None]
        over.append(((finish.tape.opacity * wrapped).astype(np.float32), finish.tape.colour))
    return over


def draw_loose_ends(
    finish: Finish, body: Body, colour: Colour, image: ImageArray, chain: Chain, projection: Projection
) -> None:
    """Draw threads of a frayed tip and tails of ties into an image, in place: thin lines that hide nothing."""
    if not finish.fray and not any(tie.tail for tie in finish.ties):
        return
    rng = np.random.default_rng([body.seed, 15])
    if finish.fray:
        pale: Colour = tuple(0.7 * c + 0.3 for c in colour)  # type: ignore[assignment]
        for _ in range(int(rng.integers(3, 8))):
            side, reach = rng.uniform(-0.9, 0.9), rng.uniform(0.4, 1.6) * body.half_px
            heading = chain.heading[-1] + rng.normal(0, 0.35) + np.cumsum(rng.normal(0, 0.25, 4))
            start = chain.point(
                np.array(chain.length_px * (1 - 0.6 * finish.fray)),
                side * chain.half_px_at(np.array(chain.length_px)),
            )
            steps = reach / 4 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
            line = np.concatenate([start[None], start + np.cumsum(steps, axis=0)])
            shade = tone(pale, float(rng.uniform(0.75, 1.0)))
            cv2.polylines(image, [fixed(projection.to_image(line))], False, shade, 1, cv2.LINE_AA, 4)
    for tie in finish.ties:
        if not tie.tail:
            continue
        s = np.full(4, tie.at * chain.length_px)
        half = chain.half_px_at(s)
        lean = rng.normal(0, 0.25) * np.linspace(0, 1, 4) ** 2
        line = chain.point(s + lean * tie.tail * half, (tie.head_v + tie.tail * np.linspace(0, 1, 4)) * half)
        width = max(1, round(0.55 * tie.width * float(half[0])))
        points = [fixed(projection.to_image(line))]
        cv2.polylines(image, points, False, tone(tie.colour, 0.85), width, cv2.LINE_AA, 4)


def _from_tie(tie: Tie, chain: Chain, s: FloatArray) -> tuple[FloatArray, float]:
    """Distance of each place from a tie's middle, and the tie's width, px."""
    at = tie.at * chain.length_px
    return np.abs(s - np.float32(at)), tie.width * float(chain.half_px_at(np.array(at)))


def _mirror_v(body: Body, light: Light, azimuth_deg: float, chain: Chain, s: FloatArray) -> FloatArray:
    """Where across the body a lamp is reflected to the lens, (U,): where its normal halves the angle between them."""
    azimuth, elevation = np.radians(azimuth_deg), np.radians(light.elevation_deg)
    heading = chain.heading_at(s)
    outward = chain.side * (np.cos(azimuth) * np.sin(heading) - np.sin(azimuth) * np.cos(heading))
    half_way = np.cos(elevation) * outward / np.sqrt(2 + 2 * np.sin(elevation))
    # The face of a body with a narrow rim is a little round too: cast silicone has no flat sides.
    rim = max(body.rim, 0.6)
    v: FloatArray = (np.sign(half_way) * (1 - rim) + rim * half_way).astype(np.float32)
    return np.float32(0.96) * v


def _smooth(values: FloatArray) -> FloatArray:
    """Values clipped to [0, 1], float32."""
    return np.minimum(np.maximum(np.asarray(values, np.float32), np.float32(0)), np.float32(1))
