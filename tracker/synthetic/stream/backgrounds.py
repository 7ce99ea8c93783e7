"""What lies behind everything, by the words of `families`."""

from __future__ import annotations

import cv2
import numpy as np

from ...types import FloatArray, ImageArray
from .distractors import Painter, any_colour
from .look import Colour, Scene
from .noise import noise_field
from .paint import Shade, axes, fixed, rectangle, solid, strokes, tone

Size = tuple[int, int]


def background(word: str, scene: Scene, size_wh: Size) -> tuple[ImageArray, FloatArray]:
    """Draw it.

    Returns
    -------
    image : RGB uint8 (H, W, 3), evenly lit
    texture : (H, W) float32 around 1, what it is multiplied with besides the light
    """
    rng = np.random.default_rng([scene.seed, 3])
    shape = (size_wh[1], size_wh[0])
    image = {
        "plain paper": _paper, "lined paper": _lined, "squared paper": _squared, "dark bench": _bench,
        "wood": _wood, "cutting mat": _mat, "breadboard": _holes, "optical table": _holes, "room": _room,
        "studio": _studio, "cluttered bench": _bench, "collage": _collage, "curtain": _curtain,
    }[word](word, scene, size_wh, rng)  # fmt: skip
    texture = cv2.addWeighted(
        noise_field(rng, shape, 1.0), scene.texture, noise_field(rng, shape, 40), 1.5 * scene.texture, 1.0
    )
    if word in ("dark bench", "cluttered bench"):
        texture = cv2.scaleAdd(noise_field(rng, shape, 2.5), 1.2 * scene.texture, texture)
    return image, texture


def _unit(size_wh: Size) -> float:
    return max(size_wh) / 256


def _plain(
    colour: Colour, size_wh: Size, rng: np.random.Generator, spread: float = 0.05, cells: int = 2
) -> ImageArray:
    """One colour that changes slowly."""
    level = (
        1
        + spread * rng.standard_normal((cells, cells, 1))
        + 0.25 * spread * rng.standard_normal((cells, cells, 3))
    )
    coarse = np.clip(255 * np.asarray(colour) * level, 0, 255).astype(np.uint8)
    return cv2.resize(coarse, size_wh, interpolation=cv2.INTER_LINEAR if cells < 3 else cv2.INTER_CUBIC)


def _rules(size_wh: Size, pitch_px: float, turn_deg: float, offset: float) -> FloatArray:
    """Parallel lines over the whole image, (N, 2, 2)."""
    reach = 0.5 * float(np.hypot(*size_wh)) + 1
    along, across = axes(np.radians(turn_deg))
    place = (
        (np.arange(-np.floor(reach / pitch_px), np.floor(reach / pitch_px)) + offset)[:, None]
        * pitch_px
        * across
    )
    centre = np.asarray(size_wh) / 2 + place
    return np.stack([centre - reach * along, centre + reach * along], axis=1)


def _paper(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _plain(scene.colour, size_wh, rng)
    if rng.random() < 0.35:
        # A sheet ends within the image, on something else.
        beyond = any_colour(rng, 0.7)
        along, across = axes(np.radians(scene.turn_deg))
        reach = float(max(size_wh))
        centre = np.asarray(size_wh) / 2 + across * reach * rng.uniform(0.8, 1.0)
        solid(image, rectangle(centre, along, 3 * reach, reach), beyond, rng)
    return image


def _lined(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _paper(word, scene, size_wh, rng)
    width = max(1, round(0.8 * _unit(size_wh)))
    strokes(image, _rules(size_wh, scene.pitch_px, scene.turn_deg, rng.random()), scene.ink, width)
    if rng.random() < 0.4:
        margin = _rules(size_wh, 0.7 * max(size_wh), scene.turn_deg + 90, rng.random())
        strokes(image, margin[:1], (0.85, 0.45, 0.45), width)
    return image


def _squared(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _paper(word, scene, size_wh, rng)
    for turn in (0, 90):
        strokes(image, _rules(size_wh, scene.pitch_px, scene.turn_deg + turn, rng.random()), scene.ink)
        if scene.seed % 2:
            strokes(
                image,
                _rules(size_wh, 5 * scene.pitch_px, scene.turn_deg + turn, rng.random()),
                scene.ink,
                2,
            )
    return image


def _bench(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _plain(scene.colour, size_wh, rng, 0.12, 3)
    centre = rng.random((8, 1, 2)) * size_wh
    scratches = np.concatenate([centre, centre + rng.normal(0, 30 * _unit(size_wh), (8, 1, 2))], axis=1)
    strokes(image, scratches[: int(rng.integers(9))], tuple(0.9 * c + 0.05 for c in scene.colour))  # type: ignore[arg-type]
    if word == "cluttered bench":
        painter = Painter(image, rng, _unit(size_wh), Shade((2.5, 3.0), 2.5, 0.5))
        for _ in range(int(rng.integers(4, 10))):
            painter.any_distractor(rng.random(2) * size_wh, rng.uniform(0, 2 * np.pi))
    return image


def _wood(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _plain(scene.colour, size_wh, rng, 0.08)
    side = int(1.5 * max(size_wh))
    grain = cv2.resize(
        noise_field(rng, (side // 2, max(side // 28, 4)), 2.5), (side, side), interpolation=cv2.INTER_LINEAR
    )
    turn = cv2.getRotationMatrix2D((side / 2, side / 2), scene.turn_deg, 1.0)
    turn[:, 2] -= (side - np.asarray(size_wh)) / 2
    grain = cv2.warpAffine(grain, turn, size_wh, borderMode=cv2.BORDER_REFLECT)
    level = cv2.merge([(1 + np.float32(k) * grain).astype(np.float32) for k in (0.07, 0.09, 0.11)])
    image = cv2.multiply(image, level, dtype=cv2.CV_8U)
    if rng.random() < 0.4:
        strokes(
            image,
            _rules(size_wh, rng.uniform(40, 100) * _unit(size_wh), -scene.turn_deg, rng.random()),
            (0.2, 0.13, 0.08),
        )
    return image


def _mat(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _plain(scene.colour, size_wh, rng)
    faint: Colour = tuple(0.75 * c + 0.25 * i for c, i in zip(scene.colour, scene.ink, strict=True))  # type: ignore[assignment]
    for turn in (0, 90):
        strokes(image, _rules(size_wh, scene.pitch_px, scene.turn_deg + turn, 0.5), faint)
        strokes(image, _rules(size_wh, 5 * scene.pitch_px, scene.turn_deg + turn, 0.5), scene.ink)
    if rng.random() < 0.5:
        strokes(image, _rules(size_wh, 23 * scene.pitch_px, scene.turn_deg + 45, 0.5), scene.ink)
    return image


def _holes(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    """A regular pattern from one cell of it, repeated."""
    cell = np.full((32, 32, 3), tone(scene.colour), np.uint8)
    if word == "breadboard":
        cv2.rectangle(cell, (10, 10), (21, 21), tone(scene.colour, 0.45), -1)
        cv2.rectangle(cell, (12, 13), (20, 21), tone(scene.colour, 0.25), -1)
    else:
        cv2.circle(cell, (16, 16), 9, tone(scene.colour, 1.25), -1, cv2.LINE_AA)
        cv2.circle(cell, (16, 16), 7, tone(scene.colour, 0.25), -1, cv2.LINE_AA)
    pitch = scene.pitch_px * (1.0 if word == "breadboard" else 3.0)
    cell = cv2.resize(cell, (int(max(np.ceil(pitch), 4)),) * 2, interpolation=cv2.INTER_AREA)
    # Tiled as far as the turned image reaches; OpenCV's own repetition is slow.
    scale = len(cell) / pitch
    count = int(np.hypot(*size_wh) * scale / len(cell)) + 3
    tiled = np.tile(cell, (count, count, 1))
    matrix = cv2.getRotationMatrix2D((0, 0), scene.turn_deg, scale)
    middle = np.asarray(size_wh) / 2
    matrix[:, 2] = len(tiled) / 2 - matrix[:, :2] @ middle + (rng.random(2) - 0.5) * len(cell)
    image = cv2.warpAffine(
        tiled, matrix, size_wh, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REFLECT
    )
    if word == "breadboard":
        # Rows end at a groove, and beside the rails run a red and a blue line.
        groove = _rules(size_wh, 7 * scene.pitch_px, -scene.turn_deg, rng.random())
        strokes(image, groove, tuple(0.85 * c for c in scene.colour), max(2, round(1.3 * scene.pitch_px)))  # type: ignore[arg-type]
        strokes(image, groove[::2] + scene.pitch_px, (0.75, 0.25, 0.22))
        strokes(image, groove[::2] - scene.pitch_px, (0.25, 0.35, 0.70))
    return image


def _room(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    """Furniture and windows far out of focus, drawn small."""
    small = (max(size_wh[0] // 4, 8), max(size_wh[1] // 4, 8))
    image = _plain(scene.colour, small, rng, 0.25, 3)
    painter = Painter(image, rng, _unit(small) * 1.6)
    for _ in range(int(rng.integers(4, 11))):
        place, along = (
            rng.random(2) * small,
            (np.array([0.0, 1.0]) if rng.random() < 0.8 else rng.normal(size=2)),
        )
        if rng.random() < 0.7:
            outline = rectangle(place, along / np.hypot(*along), *(rng.uniform(0.1, 0.8, 2) * max(small)))
            cv2.fillPoly(image, [np.round(outline).astype(np.int32)], tone(any_colour(rng, 0.6)), cv2.LINE_AA)
        else:
            painter.disc(place, 0.0)
    image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.7, 3.5)) * _unit(size_wh))
    return cv2.resize(image, size_wh, interpolation=cv2.INTER_CUBIC)


def _studio(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    return _plain(scene.colour, size_wh, rng, 0.15, 2)


def _collage(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    """Shapes of any colour on each other, smooth, rough or striped: like nothing in particular."""
    image = _plain(scene.colour, size_wh, rng, 0.25, 3)
    for _ in range(int(rng.integers(5, 26))):
        reach = max(size_wh) * 0.5 ** rng.uniform(0.5, 4.5)
        turn = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 9))))
        radius = reach * rng.uniform(0.5, 1.0, (len(turn), 1)) * rng.uniform(0.3, 1.0, 2)
        outline = rng.random(2) * size_wh + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        low = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
        high = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, size_wh)
        if (high <= low + 1).any():
            continue
        part = image[low[1] : high[1], low[0] : high[0]]
        shape = (int(high[1] - low[1]), int(high[0] - low[0]))
        mask = np.zeros(shape, np.uint8)
        cv2.fillPoly(mask, [fixed(outline - low)], 255, cv2.LINE_8, 4)
        level: FloatArray = np.ones(shape, np.float32)
        kind = rng.random()
        if kind < 0.4:
            level += np.float32(rng.uniform(0.05, 0.4)) * noise_field(
                rng, shape, (1.0, 2.5, 12, 24)[int(rng.integers(4))]
            )
        elif kind < 0.65:
            along, _ = axes(rng.uniform(0, np.pi))
            x, y = np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32)[:, None]
            wave = np.sin(
                (x * np.float32(along[0]) + y * np.float32(along[1])) / np.float32(rng.uniform(0.7, 6))
            )
            level += np.float32(rng.uniform(0.1, 0.5)) * np.sign(wave)
        filled = cv2.merge([cv2.convertScaleAbs(level, alpha=255 * c) for c in any_colour(rng, 0.4)])
        cv2.copyTo(filled, mask, part)
    if rng.random() < 0.5:
        image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(0.4, 3)) * _unit(size_wh))
    return image


def _curtain(word: str, scene: Scene, size_wh: Size, rng: np.random.Generator) -> ImageArray:
    image = _plain(scene.colour, size_wh, rng)
    across = np.arange(size_wh[0], dtype=np.float32) / _unit(size_wh)
    bent = across + 9 * np.sin(across / rng.uniform(20, 45) + rng.uniform(0, 6))
    folds = 1 + 0.22 * np.sin(bent / rng.uniform(4, 9)) + 0.1 * np.sin(across / rng.uniform(12, 25))
    level = np.broadcast_to(folds.astype(np.float32)[None, :, None], (size_wh[1], size_wh[0], 3))
    return cv2.multiply(image, np.ascontiguousarray(level), dtype=cv2.CV_8U)
