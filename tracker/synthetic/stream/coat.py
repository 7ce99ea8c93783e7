"""The lit body as a texture in body coordinates: its outline, relief, colours and shading. Knows no picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .chain import Chain
from .look import Body, Light, Surface
from .noise import cut

# How far the texture reaches beyond the midline, in half thicknesses: inner and outer side.
INNER, OUTER = 1.15, 1.55
# Texels at most: a body that fills the picture is drawn a little softer.
_MOST_TEXELS = 36_000.0


def _clipped(values: FloatArray, low: float = 0.0, high: float = 1.0) -> FloatArray:
    """`np.clip` without its checks, which cost more than the clipping."""
    return np.minimum(np.maximum(values, np.float32(low)), np.float32(high))


def hidden_px(body: Body) -> float:
    """How much of the body is drawn under the clamp."""
    return 1.2 * body.half_px + 4.0


@dataclass(frozen=True)
class Coat:
    """Premultiplied RGBA texture of a lit body.

    Attributes
    ----------
    rgba : (V, U, 4) uint8; texel (j, i) is s = `s0` + i / `per_px` and v = -INNER + j / `per_half`
    s0 : px
    per_px : texels for a px along the body
    per_half : texels for half a thickness across it
    """

    rgba: ImageArray
    s0: float
    per_px: float
    per_half: float


def _chambers(body: Body, s: FloatArray, chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Place within the chamber (0..1), how much this chamber swells, and whether there are chambers here; (U,) each."""
    start, end = float(chain.keypoint_s[1]), float(chain.keypoint_s[7])
    rng = np.random.default_rng([body.seed, 1])
    lengths = 1 + 0.25 * body.uneven * _clipped(rng.standard_normal(body.chambers), -2, 2)
    edges = start + (end - start) * np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()])
    phase = np.interp(s, edges, np.arange(body.chambers + 1.0))
    number = np.minimum(phase.astype(np.intp), body.chambers - 1)
    swelling = _clipped(1 + body.uneven * rng.standard_normal(body.chambers), 0.2, 1.8)[number]
    inside = (s > start) & (s < end)
    return (phase - number).astype(np.float32), swelling.astype(np.float32), inside.astype(np.float32)


def _valley(body: Body, place: FloatArray, pitch_texels: float) -> FloatArray:
    """Depth of the valley between chambers, 0 to 1."""
    away = np.abs(place - 0.5)
    if body.valley == "gap":
        soft = max(0.06, 1.5 / pitch_texels)
        return _clipped((away - 0.5 + 0.5 * body.gap) / soft + 0.5, 0, 1)
    if body.valley == "wave":
        return np.square(np.sin(np.pi * (place - 0.5)))
    if body.valley == "saw":
        return np.where(place < 0.12, 1 - place / 0.12, (place - 0.12) / 0.88)
    if body.valley == "joint":
        return (2 * away) ** 5
    return np.zeros_like(place)


def coat(
    body: Body, surface: Surface, light: Light, chain: Chain, pressure: float, supersampling: float
) -> Coat:
    """Draw the lit body.

    Parameters
    ----------
    chain : gives the length and, for the light, the direction at each place
    pressure : relative to the full one, swells the chambers
    supersampling : texels wanted for a px
    """
    rng = np.random.default_rng([body.seed, 2])
    hidden = hidden_px(body)
    area = (chain.length_px + hidden) * (INNER + OUTER) * body.half_px
    per_px = float(min(supersampling, max(np.sqrt(_MOST_TEXELS / area), 0.8)))
    per_half = per_px * body.half_px
    s = (np.arange(int((chain.length_px + hidden + 3) * per_px) + 1) / per_px - hidden).astype(np.float32)
    v = (np.arange(int((INNER + OUTER) * per_half) + 2) / per_half - INNER).astype(np.float32)[:, None]
    half = chain.half_px_at(s).astype(np.float32)
    end_half = float(half[-1])
    shape = (len(v), len(s))

    place, swelling, inside = _chambers(body, s, chain)
    pitch_px = float(chain.keypoint_s[7] - chain.keypoint_s[1]) / body.chambers
    valley = (_valley(body, place, pitch_px * per_px) * inside).astype(np.float32)
    lobe = np.sin(np.pi * place) * inside * swelling
    has_valleys = body.valley != "none"
    top = 1 - 2 * body.depth * valley + body.swell * pressure * (lobe if has_valleys else inside * 0.6)
    bottom = 1 - 2 * body.depth * valley if body.two_sided else np.ones_like(s)
    cap_s = chain.length_px * (1 - body.cap_share)
    if body.cap == "cap":
        top, bottom = (np.where(s > cap_s, 1.1, side) for side in (top, bottom))
    corner = max(body.tip_round * end_half, 0.5)
    closing = np.sqrt(1 - np.square(_clipped((s - chain.length_px + corner) / corner, 0, 1)))
    # Everything from here on has the texture's size: single precision.
    top = (np.minimum(top, OUTER - 0.05) * closing).astype(np.float32)
    bottom = (bottom * closing).astype(np.float32)

    # Distance to the outline, px, positive inside.
    depth = np.minimum((top - v) * half, (v + bottom) * half)
    depth = np.minimum(depth, np.float32(chain.length_px) - s)
    cover = _clipped(depth * np.float32(per_px) + np.float32(0.5), 0, 1)
    rim_px = np.maximum(body.rim * np.minimum(half * 0.5 * (top + bottom), half * 1.2), 1.0)
    edge = _clipped(1 - depth / rim_px, 0, 1)
    relief = rim_px * np.sqrt(1 - edge * edge)
    if body.swell and body.rim < 0.9:
        relief += (np.float32(0.5 * pressure * body.swell) * half * lobe) * np.sqrt(np.maximum(1 - v * v, 0))
    thread = np.zeros((1, 1), np.float32)
    if body.windings:
        turns = s / (chain.length_px / body.windings)
        thread = np.zeros(shape, np.float32)
        for slant in (body.slant, -body.slant) if body.crossed else (body.slant,):
            away = np.abs((turns + slant * v) % 1 - 0.5)
            thread = np.maximum(thread, _clipped((0.16 - away) * 8, 0, 1))
        thread *= (s > 0.3 * chain.keypoint_s[1]) & (s < 0.5 * (chain.keypoint_s[7] + chain.length_px))
        relief -= (0.06 * body.half_px) * thread
    if surface.pattern == "layers":
        relief += np.float32(0.22) * np.sin(v * np.float32(2 * np.pi * max(body.half_px / 2.2, 2)))
    if surface.roughness:
        relief += np.float32(surface.roughness) * cut(rng, shape, 12 if surface.pattern == "none" else 3)

    level, gloss = _lit(relief.astype(np.float32), s, body, surface, light, chain, per_px)
    tone = level * (1 + np.float32(surface.grain) * cut(rng, shape, 24))
    if surface.pattern == "weave":
        tone *= 1 + np.float32(0.10) * np.sin(s * np.float32(2.4)) * np.sin(
            v * np.float32(1.2 * body.half_px)
        )
    if has_valleys:
        # Little light comes to the bottom of a valley, and a groove is seen where it runs across the body's face.
        tone *= 1 - np.float32(0.30 if body.rim < 0.9 else 0.16) * valley * _clipped(v + 1.2, 0, 1)
    # The body meets the clamp in a dark line.
    tone *= 1 - np.float32(0.35) * np.exp(-np.square(s / np.float32(max(0.10 * body.half_px, 1.2))))
    if surface.cavity:
        across = (
            _clipped((np.float32(0.34) - np.abs(place - 0.5)) * 9, 0, 1)
            if has_valleys or body.valley == "none"
            else 1
        )
        tone *= 1 - np.float32(surface.cavity) * (across * inside) * _clipped(
            (np.float32(0.62) - np.abs(v - 0.08)) * 7, 0, 1
        )
        # Light leaves a translucent body at its rim.
        tone += np.float32(0.10) * edge * edge

    mixes: list[tuple[FloatArray, tuple[float, float, float]]] = []
    if surface.pattern == "specks":
        specks = _clipped((cut(rng, shape, 2.5) - 0.9) * 2.5, 0, 1)
        mixes.append((specks, surface.thread_colour))
    if body.layer:
        at = np.float32(-1 + 2 * body.layer)
        mixes.append((_clipped((at - v) * np.float32(per_half) + 0.5, 0, 1), surface.layer_colour))
    if body.windings:
        mixes.append((np.float32(0.85) * thread, surface.thread_colour))
    if body.cap != "none":
        start = cap_s if body.cap == "cap" else cap_s - 0.02 * chain.length_px
        stop = chain.length_px if body.cap == "cap" else chain.length_px * (1 - 0.35 * body.cap_share)
        band = _clipped(
            (np.minimum(s - start, stop + (3 if body.cap == "cap" else 0) - s)) * per_px + 0.5, 0, 1
        )
        mixes.append(((band * 0.95)[None].astype(np.float32), surface.cap_colour))
    opaque = np.float32(surface.opacity) + (1 - np.float32(surface.opacity)) * _clipped(
        edge * 1.2 - 0.5, 0, 1
    )
    for weight, _ in mixes:
        opaque = opaque + (1 - opaque) * weight
    alpha = cover * opaque * np.float32(255)
    planes = []
    for channel in range(3):
        plane: FloatArray = np.full((1, 1), surface.colour[channel], np.float32)
        for weight, other in mixes:
            plane = plane + (np.float32(other[channel]) - plane) * weight
        planes.append(np.minimum(plane * tone + gloss, np.float32(1)) * alpha)
    rgba = cv2.convertScaleAbs(cv2.merge([*planes, alpha]))
    return Coat(rgba, -hidden, per_px, per_half)


def _lit(
    relief: FloatArray, s: FloatArray, body: Body, surface: Surface, light: Light, chain: Chain, per_px: float
) -> tuple[FloatArray, FloatArray]:
    """Light on each texel, around 1 where the body faces the lens, and the highlight that is added."""
    azimuth, elevation = np.radians(light.azimuth_deg), np.radians(light.elevation_deg)
    lx, ly, lz = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    heading = chain.heading_at(s)
    cos, sin = np.cos(heading), np.sin(heading)
    along = (lx * cos + ly * sin).astype(np.float32)
    outward = (chain.side * (lx * sin - ly * cos)).astype(np.float32)
    slope_s = cv2.Sobel(relief, cv2.CV_32F, 1, 0, ksize=3, scale=per_px / 8)
    slope_v = cv2.Sobel(relief, cv2.CV_32F, 0, 1, ksize=3, scale=per_px / 8)
    up = 1 / np.sqrt(1 + slope_s * slope_s + slope_v * slope_v)
    facing = (np.float32(lz) - slope_s * along - slope_v * outward) * up
    wrap = np.float32(surface.wrap)
    lit = np.maximum((facing + wrap) * (1 / (1 + wrap)), 0)
    full = max((lz + surface.wrap) / (1 + surface.wrap), 0.35)
    level = (
        np.float32(light.ambient) * (np.float32(0.6) + np.float32(0.4) * up)
        + np.float32((1 - light.ambient) / full) * lit
    )
    mirror = np.maximum(2 * up * facing - np.float32(lz), 0)
    gloss = np.float32(surface.gloss) * cv2.pow(mirror, surface.shininess)
    return level, gloss
