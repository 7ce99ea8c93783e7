"""Ruled and graph paper, and strips of tape that reflect a lamp: what lies flat on the bench behind the body."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...types import FloatArray
from .distractors import Painter
from .look import Colour
from .noise import noise_field
from .paint import axes, box_about, fixed, rectangle, solid, strokes

_TAPES: tuple[tuple[Colour, float], ...] = (
    *(((0.93, 0.94, 0.95), 0.22), ((0.93, 0.94, 0.95), 0.15), ((0.90, 0.89, 0.86), 0.95)),
    *(((0.20, 0.42, 0.75), 0.95), ((0.10, 0.10, 0.11), 0.97), ((0.66, 0.48, 0.28), 0.85)),
    *(((0.72, 0.73, 0.75), 0.95), ((0.88, 0.82, 0.62), 0.92)),
)
"""Colour and opacity: clear twice, white, blue masking, black electrical, brown packing, duct, yellow masking."""


@dataclass(frozen=True)
class Sheet:
    """A sheet of paper with lines.

    Attributes
    ----------
    xy : tuple of float
        Its middle, px.
    heading_deg : float
        Of its lines, from +x toward +y.
    size_px : tuple of float
        Along and across the lines.
    colour, ink : Colour
        Of the paper and of its lines.
    pitch_px : float
        Distance between two lines; of graph paper, between two of the finest.
    ruling : str
        "lines", "squares" or "graph"; graph paper has stronger lines at every fifth and tenth.
    """

    xy: tuple[float, float]
    heading_deg: float
    size_px: tuple[float, float]
    colour: Colour
    ink: Colour
    pitch_px: float
    ruling: str


def ruled_sheet(painter: Painter, sheet: Sheet) -> None:
    """Draw a sheet, in place."""
    rng, image = painter.rng, painter.image
    place = np.asarray(sheet.xy)
    along, across = axes(float(np.radians(sheet.heading_deg)))
    length, width = sheet.size_px
    colour, ink, pitch_px, ruling = sheet.colour, sheet.ink, sheet.pitch_px, sheet.ruling
    shade = painter.shade if rng.random() < 0.8 else None
    solid(image, rectangle(place, along, length, width), colour, rng, ramp=0.05, shade=shade)

    def ruled(u: FloatArray, one: FloatArray, other: FloatArray, reach: float) -> FloatArray:
        middle = place + u[:, None] * one
        return np.stack([middle - 0.5 * reach * other, middle + 0.5 * reach * other], axis=1)

    rows = np.arange(-0.5 * width + (2.5 if ruling == "lines" else 1) * pitch_px, 0.5 * width, pitch_px)
    fine = max(1, round(0.45 * painter.unit))
    pale: Colour = tuple(0.55 * i + 0.45 * c for i, c in zip(ink, colour, strict=True))  # type: ignore[assignment]
    strokes(image, ruled(rows, across, along, length), ink if ruling == "lines" else pale, fine)
    if ruling == "lines":
        margin = place + (rng.uniform(0.08, 0.2) - 0.5) * length * along
        line = np.stack([margin - 0.5 * width * across, margin + 0.5 * width * across])[None]
        if rng.random() < 0.6:
            strokes(image, line, (0.80, 0.38, 0.40), fine)
        return
    columns = np.arange(-0.5 * length + pitch_px, 0.5 * length, pitch_px)
    strokes(image, ruled(columns, along, across, width), pale, fine)
    if ruling == "graph":
        for every, drawn, wide in ((5, ink, fine), (10, tuple(0.75 * i for i in ink), fine + 1)):
            strokes(image, ruled(rows[::every], across, along, length), drawn, wide)  # type: ignore[arg-type]
            strokes(image, ruled(columns[::every], along, across, width), drawn, wide)  # type: ignore[arg-type]


def glaring_tape(painter: Painter, place: FloatArray, heading: float) -> None:
    """A strip of tape, clear or not, in which a lamp is reflected as a crinkled streak."""
    rng, image, unit = painter.rng, painter.image, painter.unit
    along, across = axes(heading)
    length, width = rng.uniform(35, 130) * unit, rng.uniform(8, 26) * unit
    colour, opacity = _TAPES[int(rng.integers(len(_TAPES)))]
    drawn = rng.random(8)
    outline = rectangle(place, along, length, width)
    low, high = box_about(outline, image)
    if (high <= low).any():
        return
    shape = (int(high[1] - low[1]), int(high[0] - low[0]))
    x = np.arange(low[0], high[0], dtype=np.float32) - np.float32(place[0])
    y = np.arange(low[1], high[1], dtype=np.float32)[:, None] - np.float32(place[1])
    u = (x * np.float32(along[0]) + y * np.float32(along[1])) / np.float32(0.5 * length)
    v = (x * np.float32(across[0]) + y * np.float32(across[1])) / np.float32(0.5 * width)
    crinkle = noise_field(rng, shape, 12)
    # The lamp's reflection lies along the strip or across it, and is torn by creases.
    lean = np.float32(0.8 * (drawn[0] - 0.5))
    if drawn[1] < 0.6:
        away = (v - np.float32(1.2 * drawn[2] - 0.6) - lean * u) / np.float32(0.2 + 0.5 * drawn[3])
    else:
        away = (u - np.float32(1.4 * drawn[2] - 0.7) - lean * v) / np.float32(0.1 + 0.3 * drawn[3])
    torn = np.minimum(np.maximum(np.float32(0.85) + np.float32(0.45) * crinkle, 0), 1)
    glare = np.float32(0.75 + 0.45 * drawn[4]) * np.exp(-away * away) * torn
    level = 1 + np.float32(0.05) * crinkle
    mask = np.zeros(shape, np.uint8)
    cv2.fillPoly(mask, [fixed(outline - low)], 255, cv2.LINE_AA, 4)
    inside = mask.astype(np.float32) * np.float32(1 / 255)
    part = image[low[1] : high[1], low[0] : high[0]]
    seen = part.astype(np.float32)
    hides = (inside * np.float32(opacity))[..., None]
    own = level[..., None] * (255 * np.asarray(colour, np.float32))
    seen += (own - seen) * hides
    seen += (255 - seen) * (inside * glare)[..., None]
    part[:] = np.minimum(np.maximum(seen, 0), 255).astype(np.uint8)
    for side, shade in ((-0.5, 0.8), (0.5, 0.95)):
        edge = place + side * width * across + np.array([[-0.5], [0.5]]) * length * along
        strokes(image, edge[None], tuple(shade * c for c in colour))  # type: ignore[arg-type]
