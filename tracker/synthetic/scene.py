"""What is around the body: background, clamp, tube, and how the light falls on the scene. All of it still."""

from __future__ import annotations

import cv2
import numpy as np

from ..types import FloatArray, ImageArray
from .looks import Colour, Light, Look, Scene
from .stream.noise import smooth_noise


def thrice(plane: FloatArray) -> FloatArray:
    """(H, W) to (H, W, 3); contiguous, so that arithmetic with colours is as quick as it can be."""
    return np.asarray(cv2.merge([plane, plane, plane]))


def light_map(light: Light, size_wh: tuple[int, int]) -> FloatArray:
    """Light on each pixel: a gradient away from the lamp and a vignette; (H, W) float32, around 1."""
    width, height = size_wh
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = (x - width / 2) / (width / 2), (y - height / 2) / (width / 2)
    lx, ly, _ = light.direction
    length = max(float(np.hypot(lx, ly)), 1e-6)
    falling = 1 + light.gradient * (x * lx + y * ly) / length
    level: FloatArray = (falling * (1 - light.vignette * (x * x + y * y))).astype(np.float32)
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
    grain = 0.006 * smooth_noise(rng, shape, 110) + 0.008 * smooth_noise(rng, shape, 2.5)
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
    specks = 0.04 * smooth_noise(rng, shape, 2.0) + 0.03 * smooth_noise(rng, shape, 120)
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
    """A bench with things on it: sheets and boards, round things, cables, rulers; a little out of focus."""
    # Anti-aliased drawing needs 8 bits a channel.
    picture = np.asarray(cv2.convertScaleAbs(_bench(scene, shape, rng), alpha=255), np.uint8)
    draw = (_sheet, _disc, _cable, _ruler)
    for _ in range(int(rng.integers(6, 16))):
        colour = 255 * np.clip(rng.uniform(0.1, 0.9) + rng.normal(0, 0.07, 3), 0.03, 0.97)
        place = rng.uniform(0, 1, 2) * (shape[1], shape[0])
        mask = np.zeros(shape, np.uint8)
        drawn = picture.copy()
        draw[int(rng.choice(4, p=(0.45, 0.25, 0.2, 0.1)))](drawn, mask, place, colour, rng)
        shift = np.array([[1, 0, rng.uniform(2, 7)], [0, 1, rng.uniform(2, 7)]])
        shadow = cv2.GaussianBlur(
            cv2.warpAffine(mask, shift, (shape[1], shape[0])), (0, 0), rng.uniform(2, 5)
        )
        shaded = picture * (1 - 0.5 / 255 * shadow.astype(np.float32))[..., None]
        cover = mask[..., None].astype(np.float32) / 255
        picture = np.asarray(cv2.convertScaleAbs(shaded + (drawn - shaded) * cover), np.uint8)
    lit = picture.astype(np.float32) / 255
    return np.asarray(cv2.GaussianBlur(lit, (0, 0), float(rng.uniform(0.5, 2.5))), np.float32)


def _sheet(
    picture: ImageArray, mask: ImageArray, place: FloatArray, colour: FloatArray, rng: np.random.Generator
) -> None:
    size = rng.uniform((25, 25), (190, 130))
    turn = float(rng.uniform(0, 180))
    corners = cv2.boxPoints((tuple(map(float, place)), tuple(map(float, size)), turn))
    for target, tone in ((picture, tuple(colour.tolist())), (mask, (255,))):
        cv2.fillConvexPoly(target, np.round(corners * 16).astype(np.int32), tone, cv2.LINE_AA, 4)
    ink = tuple((colour * rng.uniform(0.35, 0.85)).tolist())
    rows = int(rng.integers(0, 9))
    for row in range(rows):  # print, or the tracks of a board
        u = 0.12 + 0.76 * row / max(rows - 1, 1)
        start, end = corners[0] + u * (corners[1] - corners[0]), corners[3] + u * (corners[2] - corners[3])
        end = start + (end - start) * rng.uniform(0.4, 0.92)
        start = start + (end - start) * 0.1
        a, b = (tuple(map(int, np.round(point * 16))) for point in (start, end))
        cv2.line(picture, a, b, ink, int(rng.integers(1, 3)), cv2.LINE_AA, 4)


def _disc(
    picture: ImageArray, mask: ImageArray, place: FloatArray, colour: FloatArray, rng: np.random.Generator
) -> None:
    centre = tuple(map(int, place * 16))
    radius = float(rng.uniform(7, 45))
    cv2.circle(mask, centre, int(radius * 16), 255, -1, cv2.LINE_AA, 4)
    for share in (1.0, 0.82, 0.78, 0.4):
        tone = tuple((colour * rng.uniform(0.65, 1.05)).clip(0, 255).tolist())
        cv2.circle(picture, centre, int(radius * share * 16), tone, -1, cv2.LINE_AA, 4)


def _cable(
    picture: ImageArray, mask: ImageArray, place: FloatArray, colour: FloatArray, rng: np.random.Generator
) -> None:
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.5, 9))
    knots = place + 55 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    curve = np.asarray(cv2.resize(knots.astype(np.float32), (2, 120), interpolation=cv2.INTER_CUBIC))
    line = [np.round(curve * 16).astype(np.int32)]
    width = int(rng.integers(2, 8))
    cv2.polylines(mask, line, False, 255, width, cv2.LINE_AA, 4)
    cv2.polylines(picture, line, False, tuple((0.6 * colour).tolist()), width, cv2.LINE_AA, 4)
    cv2.polylines(picture, line, False, tuple(colour.tolist()), max(width // 2, 1), cv2.LINE_AA, 4)


def _ruler(
    picture: ImageArray, mask: ImageArray, place: FloatArray, colour: FloatArray, rng: np.random.Generator
) -> None:
    heading = rng.uniform(0, np.pi)
    along, across = (
        np.array([np.cos(heading), np.sin(heading)]),
        np.array([-np.sin(heading), np.cos(heading)]),
    )
    length, width, pitch = rng.uniform(200, 420), rng.uniform(20, 34), rng.uniform(5, 9)
    corners = [place + along * i * length + across * j * width for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    for target, tone in ((picture, tuple((0.4 * colour + 150).clip(0, 255).tolist())), (mask, (255,))):
        cv2.fillConvexPoly(target, np.round(np.array(corners) * 16).astype(np.int32), tone, cv2.LINE_AA, 4)
    for tick in range(int(length / pitch)):
        start = place + along * tick * pitch
        end = start + across * width * (0.45 if tick % 5 == 0 else 0.25)
        a, b = (tuple(map(int, np.round(point * 16))) for point in (start, end))
        cv2.line(picture, a, b, (35, 35, 40), 1, cv2.LINE_AA, 4)


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
    front : (H, W, 4) float32, grey levels premultiplied and coverage 0..1: the clamp, before the body
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
    lit = light_map(light, look.size_wh)[..., None] * (255 * np.sqrt(np.asarray(light.tint, np.float32)))
    front = np.concatenate([clamp * lit * clamp_mask[..., None], clamp_mask[..., None]], axis=2)
    return picture * lit, front


def shadow_factor(mask: FloatArray, light: Light, height: float = 1.0) -> FloatArray:
    """What a shadow leaves of the light: the mask, blurred and moved away from the lamp; (H, W) in [0, 1].

    Drawn at half size: a shadow has no detail that would be lost.
    """
    lx, ly, _ = light.direction
    length = max(float(np.hypot(lx, ly)), 1e-6)
    offset = -0.5 * light.shadow_length_px * height / length
    rows, columns = mask.shape
    small = cv2.resize(mask, ((columns + 1) // 2, (rows + 1) // 2), interpolation=cv2.INTER_AREA)
    move = np.array([[1, 0, offset * lx], [0, 1, offset * ly]])
    moved = cv2.warpAffine(small, move, (small.shape[1], small.shape[0]), flags=cv2.INTER_LINEAR)
    soft = cv2.GaussianBlur(moved, (0, 0), 0.5 * max(light.shadow_softness_px * height, 1.2))
    contact = cv2.GaussianBlur(small, (0, 0), 1.5)
    shade = cv2.addWeighted(soft, -0.75 * light.shadow, contact, -0.25 * light.shadow, 1.0)
    return np.asarray(cv2.resize(shade, (columns, rows), interpolation=cv2.INTER_LINEAR))
