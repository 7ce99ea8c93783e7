"""What is around the body: background, clamp, tube, and how the light falls on the scene. All of it still."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import FloatArray
from .looks import Colour, Light, Look, Scene
from .skin import smooth_noise


def light_map(light: Light, size_wh: tuple[int, int]) -> FloatArray:
    """How bright the light makes each pixel: a gradient away from the light, a vignette; (H, W, 1), around 1."""
    width, height = size_wh
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = (x - width / 2) / (width / 2), (y - height / 2) / (width / 2)
    lx, ly, _ = light.direction
    length = max(float(np.hypot(lx, ly)), 1e-6)
    falling = 1 + light.gradient * (x * lx + y * ly) / length
    level: FloatArray = (falling * (1 - light.vignette * (x * x + y * y)))[..., None].astype(np.float32)
    return level


def _flat(colour: Colour, shape: tuple[int, int]) -> FloatArray:
    return np.broadcast_to(np.asarray(colour, np.float32), (*shape, 3)).copy()


def _turned(shape: tuple[int, int], turn_deg: float) -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    return (x * cos + y * sin).astype(np.float32), (y * cos - x * sin).astype(np.float32)


def _rules(along: FloatArray, pitch_px: float, width_px: float) -> FloatArray:
    """Coverage of parallel lines, anti-aliased."""
    distance = np.abs((along / pitch_px + 0.5) % 1 - 0.5) * pitch_px
    coverage: FloatArray = np.clip(0.5 + 0.5 * width_px - distance, 0, 1)
    return coverage


def _paper(scene: Scene, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    picture = _flat(scene.colour, shape)
    grain = 0.012 * smooth_noise(rng, shape, 60) + 0.008 * smooth_noise(rng, shape, 2.5)
    return picture * (1 + scene.contrast * grain)[..., None]


def _ruled(scene: Scene, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    picture = _paper(scene, shape, rng)
    u, v = _turned(shape, scene.turn_deg)
    lines = _rules(v + scene.pitch_px * rng.uniform(), scene.pitch_px, 1.0)
    if scene.background == "grid":
        lines = np.maximum(lines, _rules(u + scene.pitch_px * rng.uniform(), scene.pitch_px, 1.0))
        lines = np.maximum(0.55 * lines, _rules(v, 5 * scene.pitch_px, 1.6))
        lines = np.maximum(lines, _rules(u, 5 * scene.pitch_px, 1.6))
    lines *= scene.contrast * 0.7 * (1 + 0.15 * smooth_noise(rng, shape, 20))
    return picture + (np.asarray(scene.line_colour, np.float32) - picture) * lines[..., None]


def _bench(scene: Scene, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    picture = _flat(scene.colour, shape)
    u, v = _turned(shape, scene.turn_deg)
    specks = 0.05 * smooth_noise(rng, shape, 2.0) + 0.04 * smooth_noise(rng, shape, 90)
    picture *= (1 + scene.contrast * specks)[..., None]
    for _ in range(int(rng.integers(0, 14))):  # scratches
        offset, angle = rng.uniform(-400, 600), rng.uniform(-0.4, 0.4)
        line = np.exp(-np.square((v - offset - angle * u) / 0.8)) * (np.sin(u / rng.uniform(60, 200)) > 0.2)
        picture += (scene.contrast * rng.uniform(-0.06, 0.09) * line)[..., None].astype(np.float32)
    return picture


def _wood(scene: Scene, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    u, v = _turned(shape, scene.turn_deg)
    warp = smooth_noise(rng, shape, 160) * 10 + smooth_noise(rng, shape, 60) * 2.5
    rings = np.sin((v + warp) / rng.uniform(5, 11) + 1.5 * np.sin(v / 70.0))
    fine_noise = cv2.resize(
        rng.standard_normal((shape[0] + shape[1], 24), dtype=np.float32),
        (shape[0] + shape[1], shape[0] + shape[1]),
    )
    reach = shape[0] + shape[1]
    fibres = cv2.remap(
        fine_noise,
        (u % reach).astype(np.float32),
        ((v + 0.2 * warp) % reach).astype(np.float32),
        cv2.INTER_LINEAR,
    )
    tone = 1 + scene.contrast * (0.07 * rings + 0.05 * fibres + 0.03 * smooth_noise(rng, shape, 120))
    seams = _rules(v, rng.uniform(110, 220), 1.4) * 0.5
    return _flat(scene.colour, shape) * (tone * (1 - seams))[..., None]


def _clutter(scene: Scene, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    # Anti-aliased drawing needs 8 bits a channel.
    picture = cv2.convertScaleAbs(_bench(scene, shape, rng), alpha=255)
    height, width = shape
    for _ in range(int(rng.integers(10, 26))):
        colour = tuple(
            float(c) for c in 255 * np.clip(rng.normal(rng.uniform(0.1, 0.9), 0.12, 3), 0.02, 0.98)
        )
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        size = rng.uniform(12, 130, 2)
        turn = float(rng.uniform(0, 180))
        kind = rng.integers(0, 4)
        layer = picture.copy()
        if kind == 0:
            box = cv2.boxPoints(((x, y), (float(size[0]), float(size[1])), turn))
            shadow = (box + rng.uniform(3, 7)).astype(np.int32)
            cv2.fillConvexPoly(layer, shadow, tuple(90 * c for c in scene.colour), cv2.LINE_AA)
            layer = cv2.GaussianBlur(layer, (0, 0), 3)
            cv2.fillConvexPoly(layer, box.astype(np.int32), colour, cv2.LINE_AA)
        elif kind == 1:
            cv2.ellipse(
                layer,
                (int(x), int(y)),
                (int(size[0] / 2), int(size[1] / 2)),
                turn,
                0,
                360,
                colour,
                -1,
                cv2.LINE_AA,
            )
        elif kind == 2:  # a cable
            start = np.array([x, y])
            knots = start + np.cumsum(rng.normal(0, 70, (5, 2)), axis=0)
            curve = cv2.resize(knots.astype(np.float32), (2, 60), interpolation=cv2.INTER_CUBIC)
            thickness = int(rng.integers(2, 9))
            cv2.polylines(
                layer,
                [curve.astype(np.int32)],
                False,
                tuple(0.6 * c for c in colour),
                thickness + 2,
                cv2.LINE_AA,
            )
            cv2.polylines(layer, [curve.astype(np.int32)], False, colour, thickness, cv2.LINE_AA)
        else:
            text = "".join(rng.choice(list("0123456789ABCDEFGHKLMNRSTUVXYZ -"), int(rng.integers(3, 10))))
            cv2.putText(
                layer,
                text,
                (int(x), int(y)),
                cv2.FONT_HERSHEY_SIMPLEX,
                float(rng.uniform(0.4, 1.2)),
                colour,
                1,
                cv2.LINE_AA,
            )
        picture = layer
    soft = float(rng.uniform(0.0, 2.2))
    lit = picture.astype(np.float32) / 255
    return cv2.GaussianBlur(lit, (0, 0), soft) if soft > 0.4 else lit


def background(look: Look) -> FloatArray:
    """The unlit table behind everything, (H, W, 3) float32 in [0, 1]."""
    scene = look.scene
    shape = (look.size_wh[1], look.size_wh[0])
    rng = np.random.default_rng([look.seed, 2])
    draw = {
        "paper": _paper, "lined": _ruled, "grid": _ruled, "bench": _bench, "wood": _wood, "clutter": _clutter,
    }[scene.background]  # fmt: skip
    return np.clip(draw(scene, shape, rng), 0, 1).astype(np.float32)


def _tube(look: Look, along: FloatArray, outward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Colour (H, W, 3) and coverage (H, W) of the tube that enters the clamp from behind."""
    scene = look.scene
    shape = (look.size_wh[1], look.size_wh[0])
    start = (
        np.asarray(look.pose.base_xy)
        - along * (scene.clamp_length_px - 6)
        + outward * 0.35 * look.body.height_px
    )
    bend = np.asarray(scene.tube_bend)
    u = np.linspace(0, 1, 80)[:, None]
    curve = start - along * (u * 420) + outward * (bend[0] * u**2 + bend[1] * u**3) * 420
    fixed = np.round(curve * 16).astype(np.int32)
    colour = np.zeros((*shape, 3), np.uint8)
    radius = scene.tube_radius_px
    base = np.asarray(scene.tube_colour)
    lx, ly, _ = look.light.direction
    to_light = np.array([lx, ly]) / max(np.hypot(lx, ly), 1e-6)
    # Stacked strokes from the rim to the highlight make a round tube; the highlight lies toward the light.
    for width, level, shift in (
        (1.0, 0.55, 0),
        (0.8, 0.8, 0.05),
        (0.6, 1.0, 0.1),
        (0.35, 1.12, 0.25),
        (0.12, 1.45, 0.4),
    ):
        stroke = fixed + np.round(to_light * shift * radius * 16).astype(np.int32)
        tone = tuple(float(c) for c in np.clip(255 * base * level, 0, 255))
        cv2.polylines(colour, [stroke], False, tone, max(1, round(2 * radius * width)), cv2.LINE_AA, 4)
    mask = np.zeros(shape, np.uint8)
    cv2.polylines(mask, [fixed], False, 255, max(1, round(2 * radius)), cv2.LINE_AA, 4)
    return colour.astype(np.float32) / 255, mask.astype(np.float32) / 255


def _clamp(look: Look, along: FloatArray, outward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Colour and coverage of the clamp, a bevelled block whose face is s = 0."""
    scene, body = look.scene, look.body
    shape = (look.size_wh[1], look.size_wh[0])
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    dx, dy = x - look.pose.base_xy[0], y - look.pose.base_xy[1]
    s, t = dx * along[0] + dy * along[1], dx * outward[0] + dy * outward[1]
    inner, outer = scene.clamp_overhang_px
    low, high = -body.layer_px - inner, body.height_px + outer
    inside = np.minimum(np.minimum(-s, s + scene.clamp_length_px), np.minimum(t - low, high - t))
    mask = np.clip(0.5 + inside, 0, 1)
    lx, ly, lz = look.light.direction
    # A bevel of 3 px: the nearest side decides which way it looks.
    sides = np.stack([-s, s + scene.clamp_length_px, t - low, high - t])
    nearest = np.argmin(sides, axis=0)
    normals = np.stack([along, -along, -outward, outward])
    bevel = np.clip(1 - inside / 3.0, 0, 1) * 0.7
    facing = lz + bevel * (normals[nearest] @ np.array([lx, ly]))
    rng = np.random.default_rng([look.seed, 3])
    brushed = 0.025 * smooth_noise(rng, shape, 3)
    level = 0.6 + 0.45 * facing + brushed
    # The two jaws part along the body.
    level *= 1 - 0.45 * np.exp(-np.square((t - 0.5 * body.cap_height_px) / 1.1))
    for index in range(scene.screws):
        place = low + (high - low) * (0.15 + 0.7 * index / max(scene.screws - 1, 1))
        radius = 5.5
        rs, rt = s + 0.5 * scene.clamp_length_px, t - place
        distance = np.hypot(rs, rt)
        dome = np.clip(0.5 + radius - distance, 0, 1)
        shade = 0.75 + 0.3 * (rs * (along @ (lx, ly)) + rt * (outward @ (lx, ly))) / radius
        hexagon = np.clip(0.5 + 2.4 - distance, 0, 1)
        level += dome * (shade * (1 - 0.7 * hexagon) - level)
        level *= 1 - 0.4 * np.exp(-np.square((distance - radius - 0.5) / 0.8))
    colour = np.asarray(scene.clamp_colour, np.float32) * level[..., None]
    return np.clip(colour, 0, 1).astype(np.float32), mask.astype(np.float32)


def still_scene(look: Look) -> tuple[FloatArray, FloatArray]:
    """The scene without the body.

    Returns
    -------
    behind : (H, W, 3) float32, grey levels 0..255: background, tube, shadow of the clamp, lit
    front : (H, W, 4) float32, grey levels premultiplied and coverage 0..1: the clamp, which is in front of the body
    """
    light = look.light
    heading = np.radians(look.pose.direction_deg)
    along = np.array([np.cos(heading), np.sin(heading)])
    outward = look.pose.side * np.array([np.sin(heading), -np.cos(heading)])
    picture = background(look)
    tube, tube_mask = _tube(look, along, outward)
    clamp, clamp_mask = _clamp(look, along, outward)
    picture *= shadow_factor(np.maximum(tube_mask, 0), light, 0.5)[..., None]
    picture += (tube - picture) * tube_mask[..., None]
    picture *= shadow_factor(clamp_mask, light, 1.3)[..., None]
    lit = light_map(light, look.size_wh) * (255 * np.sqrt(np.asarray(light.tint, np.float32)))
    front = np.concatenate([clamp * lit * clamp_mask[..., None], clamp_mask[..., None]], axis=2)
    return picture * lit, front


def shadow_factor(mask: FloatArray, light: Light, height: float = 1.0) -> FloatArray:
    """What a shadow leaves of the light: the mask, blurred and moved away from the light; (H, W) in [0, 1]."""
    lx, ly, _ = light.direction
    length = max(float(np.hypot(lx, ly)), 1e-6)
    offset = -light.shadow_length_px * height / length
    moved = cv2.warpAffine(
        mask, np.array([[1, 0, offset * lx], [0, 1, offset * ly]]), (mask.shape[1], mask.shape[0]), flags=cv2.INTER_LINEAR
    )  # fmt: skip
    soft = cv2.GaussianBlur(moved, (0, 0), max(light.shadow_softness_px * height, 0.6))
    contact = cv2.GaussianBlur(mask, (0, 0), 3.0)
    factor: FloatArray = 1 - light.shadow * (0.75 * soft + 0.25 * contact)
    return factor
