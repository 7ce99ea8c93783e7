"""Marks on video frames: sub-pixel anti-aliased lines, arrows, points, and text legible on any background.

What is drawn where is decided in `overlay.py` and `curve_inset.py`. Images are RGB uint8 (H, W, 3), drawn
on in place; positions are px with (0, 0) the centre of the top-left pixel.
"""

from __future__ import annotations

from functools import cache, lru_cache
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .types import FloatArray, ImageArray

Colour = tuple[int, ...]  # RGB, or one level for a mask

# Okabe and Ito's palette, distinguishable with any colour vision (jfly.uni-koeln.de/color).
SKY_BLUE: Colour = (86, 180, 233)
ORANGE: Colour = (245, 150, 10)
YELLOW: Colour = (250, 232, 80)
VERMILLION: Colour = (255, 88, 40)
WHITE: Colour = (255, 255, 255)
DARK: Colour = (16, 18, 24)

_SHIFT = 4  # OpenCV's fixed-point positions: sixteenths of a px


def lines(image: ImageArray, points: FloatArray, colour: Colour, width: float) -> None:
    """An open line through (N, 2) positions.

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    points : ndarray of float
        (N, 2) px.
    colour : Colour
        RGB, or one level for a mask.
    width : float
        Line width, px.
    """
    fixed = _fixed(points)
    cv2.polylines(image, [fixed[:, None]], False, colour, max(1, round(width)), cv2.LINE_AA, _SHIFT)


def polygon(image: ImageArray, points: FloatArray, colour: Colour) -> None:
    """A filled shape with (N, 2) corners.

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    points : ndarray of float
        (N, 2) px, the corners.
    colour : Colour
        RGB, or one level for a mask.
    """
    fixed = _fixed(points)
    cv2.fillPoly(image, [fixed[:, None]], colour, cv2.LINE_AA, _SHIFT)


def _fixed(points: FloatArray) -> np.ndarray:
    """Positions in OpenCV's fixed-point format; positions far outside any frame are clipped, which is not visible."""
    return np.round(np.clip(points, -1e5, 1e5) * (1 << _SHIFT)).astype(np.int32)


def disc(image: ImageArray, centre: FloatArray, radius: float, colour: Colour) -> None:
    """A filled circle around (2,).

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    centre : ndarray of float
        (2,) px.
    radius : float
        Radius, px.
    colour : Colour
        RGB, or one level for a mask.
    """
    # By the fraction of each px that it covers: OpenCV's small circles come out as polygons.
    left, top = (int(np.floor(value - radius)) for value in centre)
    side = np.arange(int(2 * radius) + 4)
    distance = np.hypot(side + (left - centre[0]), side[:, None] + (top - centre[1]))
    shade(image, (255 * np.clip(radius + 0.5 - distance, 0, 1)).astype(np.uint8), colour, left, top)


def arc_points(radius: float, start_rad: float, sweep_rad: float) -> FloatArray:
    """Points (N, 2) of an arc around (0, 0), from x towards y (clockwise as seen), fine enough to look round.

    Parameters
    ----------
    radius : float
        Radius, px.
    start_rad : float
        Direction of the first point, rad.
    sweep_rad : float
        Angle from the first to the last point, rad.

    Returns
    -------
    ndarray of float
        (N, 2) px.
    """
    count = max(3, int(abs(sweep_rad) * (8 + radius) / 3))
    turn = start_rad + np.linspace(0.0, sweep_rad, count)
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def arrow_points(start: FloatArray, end: FloatArray, width: float) -> tuple[FloatArray, FloatArray]:
    """Shaft (2, 2) and head (3, 2) of an arrow whose head ends exactly at `end`.

    Parameters
    ----------
    start, end : ndarray of float
        (2,) px.
    width : float
        Width of the shaft, px.

    Returns
    -------
    shaft : ndarray of float
        (2, 2) px, both ends of the shaft.
    head : ndarray of float
        (3, 2) px, corners of the head.
    """
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, 1e-9)
    across = np.array([-along[1], along[0]])
    head = min(4.2 * width, 0.6 * length)
    neck = end - head * along
    wings = 0.48 * head * across
    return np.stack([start, neck]), np.stack([end, neck + wings, neck - wings])


def shade(
    image: ImageArray, alpha: ImageArray, colour: Colour, left: int, top: int, strength: float = 1.0
) -> None:
    """Blend a colour in by an alpha mask uint8 (h, w) put at (left, top); what falls outside is cut off.

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    alpha : ndarray of uint8
        (h, w) opacity, 0 to 255.
    colour : Colour
        RGB, or one level for a mask.
    left, top : int
        Position of the mask in the image, px.
    strength : float, optional
        Factor on the opacity.
    """
    height, width = image.shape[:2]
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + alpha.shape[1], width), min(top + alpha.shape[0], height)
    if x0 >= x1 or y0 >= y1:
        return
    part = image[y0:y1, x0:x1]
    weight = alpha[y0 - top : y1 - top, x0 - left : x1 - left, None].astype(np.float32) * (strength / 255)
    part[:] = part + weight * (np.array(colour, np.float32) - part) + 0.5


def sector(
    image: ImageArray, centre: FloatArray, points: FloatArray, colour: Colour, strength: float
) -> None:
    """A translucent sector between a centre and the points (N, 2) of an arc.

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    centre : ndarray of float
        (2,) px.
    points : ndarray of float
        (N, 2) px, of an arc.
    colour : Colour
        RGB, or one level for a mask.
    strength : float
        Opacity, 0 to 1.
    """
    outline = np.vstack([centre, points])
    left, top = np.floor(outline.min(axis=0)).astype(int) - 1
    right, bottom = np.ceil(outline.max(axis=0)).astype(int) + 2
    if max(right - left, bottom - top) > 4 * max(image.shape[:2]):
        return  # far outside
    mask = np.zeros((bottom - top, right - left), np.uint8)
    fixed = _fixed(outline - (left, top))
    cv2.fillPoly(mask, [fixed[:, None]], (255,), cv2.LINE_AA, _SHIFT)
    shade(image, mask, colour, left, top, strength)


def text(
    image: ImageArray,
    string: str,
    at: tuple[float, float],
    size: int,
    colour: Colour = WHITE,
    *,
    anchor: tuple[float, float] = (0.0, 0.0),
    bold: bool = False,
    halo: bool = True,
) -> tuple[int, int]:
    """Write a string with a dark halo; returns its (width, height) in px.

    Parameters
    ----------
    image : ndarray of uint8
        RGB uint8 (H, W, 3), drawn on in place.
    string : str
        The text.
    at : tuple of (float, float)
        Position of the anchor, px.
    size : int
        Font size, px.
    colour : Colour, optional
        RGB, or one level for a mask.
    anchor : tuple of (float, float), optional
        Which point of the text lies at `at`: (0, 0) left top, (0.5, 0.5) centre, (1, 1) right bottom.
    bold : bool, optional
        Whether the letters are bold.
    halo : bool, optional
        Whether a dark halo is drawn.

    Returns
    -------
    width : int
        Width of the text, px.
    height : int
        Height of the text, px.
    """
    fill, edge = _letters(string, size, bold)
    height, width = fill.shape
    left, top = round(at[0] - anchor[0] * width), round(at[1] - anchor[1] * height)
    if halo:
        shade(image, edge, DARK, left, top, 0.75)
    shade(image, fill, colour, left, top)
    return width, height


def text_size(string: str, size: int, *, bold: bool = False) -> tuple[int, int]:
    """(width, height) in px of what `text` would write.

    Parameters
    ----------
    string : str
        The text.
    size : int
        Font size, px.
    bold : bool, optional
        Whether the letters are bold.

    Returns
    -------
    width : int
        Width of the text, px.
    height : int
        Height of the text, px.
    """
    height, width = _letters(string, size, bold)[0].shape
    return width, height


@lru_cache(maxsize=256)
def _letters(string: str, size: int, bold: bool) -> tuple[ImageArray, ImageArray]:
    """Alpha masks (h, w) of the letters and of their halo, assembled from single letters."""
    ends = np.cumsum([_advance(letter, size, bold) for letter in string])
    starts = np.round(np.concatenate([[0.0], ends[:-1]])).astype(int)
    glyphs = [_glyph(letter, size, bold) for letter in string]
    shape = (
        glyphs[0][0].shape[0],
        max(x + fill.shape[1] for x, (fill, _) in zip(starts, glyphs, strict=True)),
    )
    masks = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    for x, glyph in zip(starts, glyphs, strict=True):
        for mask, letter in zip(masks, glyph, strict=True):
            part = mask[:, x : x + letter.shape[1]]
            np.maximum(part, letter, out=part)
    return masks


@cache
def _advance(letter: str, size: int, bold: bool) -> float:
    return float(_font(size, bold).getlength(letter))


@cache
def _glyph(letter: str, size: int, bold: bool) -> tuple[ImageArray, ImageArray]:
    font = _font(size, bold)
    stroke = max(1, round(size / 9))
    ascent, descent = font.getmetrics()
    shape = (int(np.ceil(font.getlength(letter))) + 2 * stroke, ascent + descent + 2 * stroke)
    masks = []
    for stroke_width in (0, stroke):
        mask = Image.new("L", shape)
        ImageDraw.Draw(mask).text((stroke, stroke), letter, fill=255, font=font, stroke_width=stroke_width)
        masks.append(np.array(mask))
    return masks[0], np.asarray(cv2.GaussianBlur(masks[1], (0, 0), max(0.4, stroke / 3)), dtype=np.uint8)


@cache
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, which comes with matplotlib: digits of one width, degree and plus-minus signs."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / name), size)
