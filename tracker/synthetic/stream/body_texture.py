"""The lit body as a texture in body coordinates: its outline, relief, colours and shading.

Where the body is in the image is not known here: `warp.py` puts it there."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from . import finish as finishes
from .chain import Chain
from .finish import BARE, Finish
from .look import Body, Colour, Light, Surface
from .noise import noise_field

# How far the texture reaches beyond the midline, in half thicknesses: inner and outer side.
INNER, OUTER = 1.15, 1.55
# Texels at most: a body that fills the image is drawn a little softer.
_MOST_TEXELS = 36_000.0


def _clipped(values: FloatArray, low: float = 0.0, high: float = 1.0) -> FloatArray:
    """`np.clip` without its checks, which cost more than the clipping."""
    return np.minimum(np.maximum(values, np.float32(low)), np.float32(high))


def hidden_px(body: Body) -> float:
    """How much of the body is drawn under the clamp."""
    return 1.2 * body.half_px + 4.0


@dataclass(frozen=True)
class BodyTexture:
    """Premultiplied RGBA texture of a lit body.

    Attributes
    ----------
    rgba : ndarray
        (V, U, 4) uint8; texel (j, i) is s = `s0` + i / `per_px` and v = -INNER + j / `per_half`.
    s0 : float
        Where the texture begins along the body, px.
    per_px : float
        Texels for a px along the body.
    per_half : float
        Texels for half a thickness across it.
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


@dataclass(frozen=True)
class _Grid:
    """Where the texels are, and what of the body's shape depends on s alone; arrays (U,), v (V, 1).

    Attributes
    ----------
    half : ndarray
        Half thickness, px.
    place, inside : ndarray
        See `_chambers`.
    valley : ndarray
        Depth of the valley between chambers, 0 to 1.
    lobe : ndarray
        How far each chamber swells at full pressure, relative.
    top, bottom : ndarray
        The outline, in v.
    """

    s: FloatArray
    v: FloatArray
    per_px: float
    half: FloatArray
    place: FloatArray
    inside: FloatArray
    valley: FloatArray
    lobe: FloatArray
    top: FloatArray
    bottom: FloatArray

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.v), len(self.s)


def draw_texture(
    body: Body,
    surface: Surface,
    light: Light,
    chain: Chain,
    pressure: float,
    supersampling: float,
    finish: Finish = BARE,
) -> BodyTexture:
    """Draw the lit body.

    Parameters
    ----------
    body, surface, light : Body, Surface or Light
        What is drawn, and in which light.
    chain : Chain
        Gives the length and, for the light, the direction at each place.
    pressure : float
        Relative to the full one, swells the chambers.
    supersampling : float
        Texels wanted for a px.
    finish : Finish, optional
        What the body has on it.
    """
    rng = np.random.default_rng([body.seed, 2])
    grid = _grid(body, chain, pressure, supersampling, finish)
    s, v = grid.s, grid.v
    # Distance to the outline, px, positive inside.
    depth = np.minimum((grid.top - v) * grid.half, (v + grid.bottom) * grid.half)
    end = finishes.ends_px(finish, body, chain, v) if finish.fray else np.float32(chain.length_px)
    depth = np.minimum(depth, end - s)
    cover = _clipped(depth * np.float32(grid.per_px) + np.float32(0.5))
    rim_px = np.maximum(
        body.rim * np.minimum(grid.half * 0.5 * (grid.top + grid.bottom), grid.half * 1.2), 1.0
    )
    edge = _clipped(1 - depth / rim_px)
    thread = _thread(body, chain, grid)
    relief = rim_px * np.sqrt(1 - edge * edge)
    if body.swell and body.rim < 0.9:
        bulge = np.float32(0.5 * pressure * body.swell) * grid.half * grid.lobe
        relief += bulge * np.sqrt(np.maximum(1 - v * v, 0))
    if thread is not None:
        relief -= (0.06 * body.half_px) * thread
    if surface.pattern == "layers":
        relief += np.float32(0.22) * np.sin(v * np.float32(2 * np.pi * max(body.half_px / 2.2, 2)))
    if surface.roughness:
        relief += np.float32(surface.roughness) * noise_field(
            rng, grid.shape, 3 if surface.roughness == 0.15 else 12
        )
    if finish is not BARE:
        relief = finishes.add_relief(finish, body, chain, s, v, relief)

    level, gloss = _lit(relief.astype(np.float32), s, surface, light, chain, grid.per_px)
    tone = level * _tone(body, surface, grid, edge, rng)
    mixes = _mixes(body, surface, chain, grid, thread, rng)
    if finish is not BARE:
        gloss = finishes.add_gloss(finish, body, light, chain, s, v, gloss)
        mixes += finishes.mixes(finish, chain, s, v, grid.per_px)
    see_through = 1 - np.float32(surface.opacity)
    opaque = np.float32(surface.opacity) + see_through * _clipped(edge * 1.2 - 0.5)
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
    return BodyTexture(rgba, -hidden_px(body), grid.per_px, grid.per_px * body.half_px)


def _grid(body: Body, chain: Chain, pressure: float, supersampling: float, finish: Finish) -> _Grid:
    hidden = hidden_px(body)
    area = (chain.length_px + hidden) * (INNER + OUTER) * body.half_px
    per_px = float(min(supersampling, max(np.sqrt(_MOST_TEXELS / area), 0.8)))
    per_half = per_px * body.half_px
    s = (np.arange(int((chain.length_px + hidden + 3) * per_px) + 1) / per_px - hidden).astype(np.float32)
    v = (np.arange(int((INNER + OUTER) * per_half) + 2) / per_half - INNER).astype(np.float32)[:, None]
    half = chain.half_px_at(s).astype(np.float32)
    place, swelling, inside = _chambers(body, s, chain)
    pitch_px = float(chain.keypoint_s[7] - chain.keypoint_s[1]) / body.chambers
    valley = (_valley(body, place, pitch_px * per_px) * inside).astype(np.float32)
    lobe = np.sin(np.pi * place) * inside * swelling
    # Without valleys the whole body swells, as far as its ends let it.
    swelling_v = lobe if body.valley != "none" else inside * 0.6
    top = 1 - 2 * body.depth * valley + body.swell * pressure * swelling_v
    bottom = 1 - 2 * body.depth * valley if body.two_sided else np.ones_like(s)
    if body.cap == "cap":
        top, bottom = (
            np.where(s > chain.length_px * (1 - body.cap_share), 1.1, side) for side in (top, bottom)
        )
    if finish is not BARE:
        top, bottom = finishes.outline(finish, chain, s, top, bottom)
    corner = max(body.tip_round * float(half[-1]), 0.5)
    closing = np.sqrt(1 - np.square(_clipped((s - chain.length_px + corner) / corner)))
    # Everything from here on has the texture's size: single precision.
    top = (np.minimum(top, OUTER - 0.05) * closing).astype(np.float32)
    bottom = (bottom * closing).astype(np.float32)
    return _Grid(s, v, per_px, half, place, inside, valley, lobe, top, bottom)


def _thread(body: Body, chain: Chain, grid: _Grid) -> FloatArray | None:
    """Where the windings run, 0 to 1, (V, U); None without any."""
    if not body.windings:
        return None
    turns = grid.s / (chain.length_px / body.windings)
    thread = np.zeros(grid.shape, np.float32)
    for slant in (body.slant, -body.slant) if body.crossed else (body.slant,):
        away = np.abs((turns + slant * grid.v) % 1 - 0.5)
        thread = np.maximum(thread, _clipped((0.16 - away) * 8))
    first, last = 0.3 * chain.keypoint_s[1], 0.5 * (chain.keypoint_s[7] + chain.length_px)
    thread *= (grid.s > first) & (grid.s < last)
    return thread


def _tone(
    body: Body, surface: Surface, grid: _Grid, edge: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """What the colour is multiplied with besides the light, (V, U)."""
    s, v = grid.s, grid.v
    tone = 1 + np.float32(surface.grain) * noise_field(rng, grid.shape, 24)
    if surface.pattern == "weave":
        across = np.sin(v * np.float32(1.2 * body.half_px))
        tone *= 1 + np.float32(0.10) * np.sin(s * np.float32(2.4)) * across
    if body.valley != "none":
        # Little light comes to the bottom of a valley, and a groove is seen where it runs across the body's face.
        tone *= 1 - np.float32(0.30 if body.rim < 0.9 else 0.16) * grid.valley * _clipped(v + 1.2)
    # The body meets the clamp in a dark line.
    tone *= 1 - np.float32(0.35) * np.exp(-np.square(s / np.float32(max(0.10 * body.half_px, 1.2))))
    if surface.cavity:
        along = _clipped((np.float32(0.34) - np.abs(grid.place - 0.5)) * 9) * grid.inside
        tone *= 1 - np.float32(surface.cavity) * along * _clipped((np.float32(0.62) - np.abs(v - 0.08)) * 7)
        # Light leaves a translucent body at its rim.
        tone += np.float32(0.10) * edge * edge
    return tone


def _mixes(
    body: Body,
    surface: Surface,
    chain: Chain,
    grid: _Grid,
    thread: FloatArray | None,
    rng: np.random.Generator,
) -> list[tuple[FloatArray, Colour]]:
    """What lies over the body's own colour, one over the other: coverage 0 to 1, and colour."""
    s, mixes = grid.s, []
    if surface.pattern == "specks":
        mixes.append((_clipped((noise_field(rng, grid.shape, 2.5) - 0.9) * 2.5), surface.thread_colour))
    elif surface.pattern in ("grade", "bands"):
        mixes.append((_along(surface.pattern, s, chain, rng, grid.shape), surface.thread_colour))
    if body.layer:
        inward = np.float32(-1 + 2 * body.layer) - grid.v
        mixes.append((_clipped(inward * np.float32(grid.per_px * body.half_px) + 0.5), surface.layer_colour))
    if thread is not None:
        mixes.append((np.float32(0.85) * thread, surface.thread_colour))
    if body.cap != "none":
        start, stop = chain.length_px * (1 - body.cap_share), chain.length_px + 3
        if body.cap == "tape":
            start, stop = start - 0.02 * chain.length_px, chain.length_px * (1 - 0.35 * body.cap_share)
        band = _clipped(np.minimum(s - start, stop - s) * grid.per_px + 0.5)
        mixes.append(((band * 0.95)[None].astype(np.float32), surface.cap_colour))
    return mixes


def _along(
    pattern: str, s: FloatArray, chain: Chain, rng: np.random.Generator, shape: tuple[int, int]
) -> FloatArray:
    """Where a colour that changes along the body is the second one, 0 to 1, (V, U) or (1, U)."""
    u = s / np.float32(chain.length_px)
    if pattern == "bands":
        middles = rng.random(int(rng.integers(1, 8)))
        widths = rng.uniform(0.01, 0.05, len(middles))
        near = (widths[:, None] - np.abs(u - middles[:, None])).max(axis=0)
        return _clipped((near * 60 + 0.5).astype(np.float32))[None]
    start, rise = rng.uniform(-0.3, 0.8), rng.choice([-1, 1]) * rng.uniform(0.8, 4)
    return _clipped(np.float32(0.35) * noise_field(rng, shape, 12) + ((u - start) * rise).astype(np.float32))


def _lit(
    relief: FloatArray, s: FloatArray, surface: Surface, light: Light, chain: Chain, per_px: float
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
