"""Shapes painted into an image: outlines, and fills with a little light and shadow on them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...types import FloatArray, ImageArray, IntArray
from .look import Colour
from .noise import noise_field


@dataclass(frozen=True)
class Shade:
    """Shadow that a painted thing throws: offset and blur in px, and its depth."""

    offset_xy: tuple[float, float]
    softness_px: float
    depth: float

    @property
    def spread_px(self) -> float:
        """How far beyond the thing its shadow reaches."""
        return 3 * self.softness_px + max(map(abs, self.offset_xy))


def fixed(points: FloatArray) -> np.ndarray:
    """For OpenCV's `shift=4`."""
    return np.round(np.asarray(points) * 16).astype(np.int32)


def tone(colour: Colour, factor: float = 1.0) -> tuple[float, float, float]:
    """Colour in [0, 1] to grey levels."""
    r, g, b = (min(max(255 * factor * c, 0.0), 255.0) for c in colour)
    return r, g, b


def axes(heading: float) -> tuple[FloatArray, FloatArray]:
    """Unit vectors along a heading (radians, from +x toward +y) and across it."""
    along = np.array([np.cos(heading), np.sin(heading)])
    return along, np.array([-along[1], along[0]])


def rectangle(centre: FloatArray, along: FloatArray, length: float, width: float) -> FloatArray:
    """Corners, (4, 2); `along` is a unit vector."""
    across = np.array([-along[1], along[0]])
    a, b = 0.5 * length * along, 0.5 * width * across
    return np.array([centre - a - b, centre + a - b, centre + a + b, centre - a + b])


def capsule(start: FloatArray, end: FloatArray, start_radius: float, end_radius: float) -> FloatArray:
    """Outline of a finger: two half circles and what lies between, (40, 2)."""
    heading = np.arctan2(end[1] - start[1], end[0] - start[0])
    arc = np.linspace(-np.pi / 2, np.pi / 2, 20)
    front, back = heading + arc, heading + np.pi + arc
    return np.concatenate(
        [
            end + end_radius * np.stack([np.cos(front), np.sin(front)], axis=1),
            start + start_radius * np.stack([np.cos(back), np.sin(back)], axis=1),
        ]
    )


def curve(knots: FloatArray, count: int = 60) -> FloatArray:
    """Smooth line through about the knots, (count, 2)."""
    line = cv2.resize(np.asarray(knots, np.float32), (2, count), interpolation=cv2.INTER_CUBIC)
    return np.asarray(line, float)


def strokes(image: ImageArray, lines: FloatArray, colour: Colour, width: int = 1) -> None:
    """Straight lines, (N, 2, 2), all at once."""
    if len(lines):
        cv2.polylines(image, list(fixed(lines)), False, tone(colour), width, cv2.LINE_AA, 4)


def box_about(points: FloatArray, image: ImageArray, spread_px: float = 0.0) -> tuple[IntArray, IntArray]:
    """First and last corner, (2,) px each, of the part of an image about points (N, 2); high <= low for none."""
    low = np.maximum(np.floor(points.min(axis=0) - spread_px).astype(int) - 1, 0)
    high = np.minimum(np.ceil(points.max(axis=0) + spread_px).astype(int) + 2, image.shape[1::-1])
    return low, high


def darken(part: ImageArray, dark: ImageArray, depth: float) -> None:
    """Take a share of `depth` of the light from an image (h, w, 3), in place, where `dark` (h, w) is 255."""
    left = cv2.cvtColor(255 - cv2.convertScaleAbs(dark, alpha=depth), cv2.COLOR_GRAY2RGB)
    part[:] = cv2.multiply(part, left, scale=1 / 255)


def lay_over(part: ImageArray, filled: ImageArray, mask: ImageArray) -> None:
    """Blend another image (h, w, 3) into one, in place, by a mask (h, w) of 0 to 255."""
    # In 8 bits: part + (filled - part) mask / 255.
    weight = cv2.cvtColor(mask, cv2.COLOR_GRAY2RGB)
    part[:] = cv2.add(
        cv2.multiply(filled, weight, scale=1 / 255), cv2.multiply(part, 255 - weight, scale=1 / 255)
    )


def solid(
    image: ImageArray,
    outline: FloatArray | list[FloatArray],
    colour: Colour,
    rng: np.random.Generator,
    *,
    ramp: float = 0.15,
    rounding_px: float = 0.0,
    shade: Shade | None = None,
    cover: ImageArray | None = None,
) -> None:
    """Fill an outline, or the union of several, in place.

    Parameters
    ----------
    ramp : float
        How much the light differs over it; 0 for one colour, which is quick.
    rounding_px : float
        Its rim is darker this far inward.
    cover : ndarray or None
        (H, W) uint8, gets what is covered by it.
    """
    outlines = outline if isinstance(outline, list) else [outline]
    low, high = box_about(np.concatenate(outlines), image, shade.spread_px if shade else 0.0)
    if (high <= low).any():
        return
    within = np.s_[low[1] : high[1], low[0] : high[0]]
    shape = (int(high[1] - low[1]), int(high[0] - low[0]))
    part = image[within]
    if shade:
        dark = np.zeros(shape, np.uint8)
        for each in outlines:
            cv2.fillPoly(dark, [fixed(each - low + shade.offset_xy)], 255, cv2.LINE_8, 4)
        dark = cv2.blur(
            cv2.blur(dark, (int(shade.softness_px) * 2 + 1,) * 2), (int(shade.softness_px) + 1,) * 2
        )
        darken(part, dark, shade.depth)
    plain = not ramp and not rounding_px
    mask = np.zeros(() if plain else shape, np.uint8)
    for each in outlines:
        moved = [fixed(each - low)]
        if plain:
            cv2.fillPoly(part, moved, tone(colour), cv2.LINE_AA, 4)
        else:
            cv2.fillPoly(mask, moved, 255, cv2.LINE_AA, 4)
        if cover is not None:
            cv2.fillPoly(cover[within], moved, 255, cv2.LINE_AA, 4)
    if plain:
        return
    corners = (1 + ramp * (rng.random((2, 2), dtype=np.float32) * 2 - 1)).astype(np.float32)
    level = cv2.resize(corners, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    level = level + np.float32(0.012) * noise_field(rng, shape, 1.0)
    if rounding_px:
        inner = _soft(mask, rounding_px)
        level *= np.float32(0.40) + np.float32(0.62) * inner
    filled = cv2.merge([cv2.convertScaleAbs(level, alpha=255 * c) for c in colour])
    lay_over(part, filled, mask)


def _soft(mask: ImageArray, sigma_px: float) -> FloatArray:
    """Blurred mask, 0 to 1; wide blurs are made small, where they cost little."""
    shrink = max(int(sigma_px / 1.5), 1)
    size = (mask.shape[1], mask.shape[0])
    if shrink > 1:
        small = (max(size[0] // shrink, 1), max(size[1] // shrink, 1))
        mask = cv2.resize(mask, small, interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma_px / shrink)
    return cv2.resize(soft, size, interpolation=cv2.INTER_LINEAR) * np.float32(1 / 255)
