"""Looks by chance: every seed is another actuator on another table, its whole bend inside the picture."""

from __future__ import annotations

import colorsys

import numpy as np

from ..errors import BendtrackError
from .geometry import SEGMENTS, Midline
from .looks import Body, Camera, Colour, Light, Look, Material, Pose, Scene

MATERIALS = ("translucent", "pigmented", "rubber")
BACKGROUNDS = ("paper", "lined", "grid", "bench", "wood", "clutter")
MARKS = ("pins", "seams", "steps")


def random_look(
    seed: int,
    *,
    size_wh: tuple[int, int] = (640, 480),
    end_vector_px: float = 40.0,
    angle_range_deg: tuple[float, float] = (-20.0, 220.0),
    material: str | None = None,
    background: str | None = None,
    marks: str | None = None,
) -> Look:
    """Draw a look from a seed.

    Parameters
    ----------
    size_wh : px of the picture
    end_vector_px : distance between the two points of an end
    angle_range_deg : over these angles every keypoint stays visible in the picture
    material, background, marks : one of `MATERIALS`, `BACKGROUNDS`, `MARKS`; None draws one

    Raises
    ------
    BendtrackError
        A word that is not known, or an end vector that leaves no room for the body in the picture.
    """
    for word, known in ((material, MATERIALS), (background, BACKGROUNDS), (marks, MARKS)):
        if word is not None and word not in known:
            raise BendtrackError(f"expected one of {', '.join(known)}, got {word!r}")
    rng = np.random.default_rng([seed, 0])
    kind = material or str(rng.choice(MATERIALS, p=(0.5, 0.3, 0.2)))
    ground = background or str(rng.choice(BACKGROUNDS))
    marks = marks or str(rng.choice(MARKS))
    body, pose = _placed_body(rng, size_wh, end_vector_px, angle_range_deg, marks)
    return Look(
        seed=seed,
        size_wh=size_wh,
        pose=pose,
        body=body,
        material=_material(rng, kind),
        scene=_scene(rng, ground, kind),
        light=_light(rng),
        camera=_camera(rng),
    )


def _placed_body(
    rng: np.random.Generator,
    size_wh: tuple[int, int],
    end_vector_px: float,
    angles: tuple[float, float],
    marks: str,
) -> tuple[Body, Pose]:
    """Draw bodies and poses until one fits; bodies become smaller while none does."""
    for attempt in range(150):
        body = _body(rng, end_vector_px, marks, 1.0 - 0.6 * attempt / 150, min(size_wh))
        pose = _pose(rng, body, size_wh, angles)
        if pose is not None:
            return body, pose
    raise BendtrackError(
        f"expected end vectors that leave room for the body in a picture of {size_wh[0]} x {size_wh[1]} px, "
        f"got {end_vector_px:g} px"
    )


def _body(rng: np.random.Generator, end_vector_px: float, marks: str, scale: float, room_px: int) -> Body:
    largest = max(90.0, min(270.0, room_px * 0.56) * scale)
    bend = float(rng.uniform(max(90.0, 0.6 * largest), largest))
    # The inner side must not be pressed flat: the layer stays well under the tightest radius.
    height = float(np.clip(bend * rng.uniform(0.17, 0.30), 20, 62))
    chambers = int(np.clip(round(bend / (height * rng.uniform(0.32, 0.75))), 5, 16))
    return Body(
        end_vector_px=float(end_vector_px),
        marks=marks,
        mark_radius_px=float(rng.uniform(2.0, 3.2)) if marks == "pins" else 0.0,
        margin_px=float(rng.uniform(7, 14)),
        bend_length_px=bend,
        height_px=height,
        cap_height_px=height * float(rng.uniform(0.55, 0.85)),
        layer_px=float(rng.uniform(3.5, 8.0)),
        chambers=chambers,
        # From nearly one block (slow pneu-nets) to separate bellows (fast ones).
        gap_depth=float(rng.uniform(0.07, 0.25) if rng.uniform() < 0.4 else rng.uniform(0.25, 0.75)),
        gap_width=float(rng.uniform(0.12, 0.32)),
        centre_factor=float(rng.choice([1.0, 1.0, 0.7, 1.35])),
        roundness=float(rng.uniform(0.12, 0.5)),
        swell=float(rng.uniform(0.1, 0.34)),
        unevenness=float(rng.uniform(0.0, 0.18)),
        curvature_peak=float(rng.uniform(-0.3, 0.3)),
        curvature_tilt=float(rng.uniform(-0.3, 0.3)),
    )


def _pose(
    rng: np.random.Generator, body: Body, size_wh: tuple[int, int], angles: tuple[float, float]
) -> Pose | None:
    """A place where all keypoints stay in sight over all angles; None if this direction has none."""
    side = int(rng.choice([-1, 1]))
    direction = float(rng.uniform(0, 360))
    pose = Pose((0.0, 0.0), direction, side)
    lines = [Midline(body, pose, angle) for angle in np.linspace(*angles, 25)]
    points = np.concatenate([line.point(np.array(body.keypoint_s), body.keypoint_t) for line in lines])
    # Keypoints keep off the rim; so does most of the body, whose outer side may leave the picture a little.
    s = np.linspace(body.margin_px, body.end_s, 20)
    outer = np.concatenate([line.point(s, 0.8 * body.height_px) for line in lines])
    low = np.minimum(points.min(axis=0) - 14, outer.min(axis=0))
    high = np.maximum(points.max(axis=0) + 14, outer.max(axis=0))
    room = np.asarray(size_wh) - 1 - (high - low)
    if (room < 0).any() or any(_covers_base(body, line) for line in lines):
        return None
    corner = rng.uniform(0, room)
    base = corner - low
    return Pose((float(base[0]), float(base[1])), direction, side)


def _covers_base(body: Body, line: Midline) -> bool:
    """Whether the tip's half comes over a base keypoint, or a tip keypoint under the clamp."""
    xy = line.point(np.array(body.keypoint_s), body.keypoint_t)
    tip_s, tip_t = np.meshgrid(
        np.linspace(line.s[SEGMENTS // 2 + 1], body.end_s, 40),
        np.linspace(-body.layer_px, body.height_px * (1 + body.swell), 14),
    )
    tip_half = line.point(tip_s.ravel(), tip_t.ravel())
    if np.linalg.norm(tip_half[:, None] - xy[None, :2], axis=2).min() < 10:
        return True
    s, t = line.body_coordinates(xy[2:, 0], xy[2:, 1], np.zeros(2, np.intp))
    return bool(((s < 8) & (s > -90) & (t > -body.layer_px - 34) & (t < body.height_px + 34)).any())


def _hsv(hue: float, saturation: float, value: float) -> Colour:
    return colorsys.hsv_to_rgb(hue % 1.0, saturation, value)


def _near_white(rng: np.random.Generator, value: float) -> Colour:
    red, green, blue = value * rng.uniform((0.97, 0.97, 0.92), (1.0, 1.0, 1.01))
    return float(red), float(green), float(blue)


def _material(rng: np.random.Generator, kind: str) -> Material:
    pigment = _hsv(rng.uniform(), rng.uniform(0.45, 0.85), rng.uniform(0.45, 0.9))
    if kind == "translucent":
        white = rng.uniform(0.74, 0.9)
        colour = _near_white(rng, white)
        layer = pigment if rng.uniform() < 0.6 else _near_white(rng, 0.7 * white)
        mark: Colour = (0.16, 0.16, 0.18)
        opacity, gloss, shininess = rng.uniform(0.84, 0.97), rng.uniform(0.3, 0.7), rng.uniform(30, 110)
    elif kind == "pigmented":
        colour = pigment
        layer = _hsv(rng.uniform(), 0.15, 0.85 if rng.uniform() < 0.6 else 0.2)
        mark = (0.92, 0.92, 0.9) if max(pigment) < 0.6 else (0.1, 0.1, 0.12)
        opacity, gloss, shininess = 1.0, rng.uniform(0.12, 0.5), rng.uniform(14, 70)
    else:
        colour = _hsv(rng.uniform(), rng.uniform(0.0, 0.25), rng.uniform(0.13, 0.27))
        layer = _hsv(rng.uniform(), rng.uniform(0.0, 0.4), rng.uniform(0.5, 0.85))
        mark = (0.8, 0.8, 0.78)
        opacity, gloss, shininess = 1.0, rng.uniform(0.1, 0.4), rng.uniform(10, 60)
    return Material(
        kind=kind,
        colour=colour,
        layer_colour=layer,
        mark_colour=mark,
        opacity=float(opacity),
        gloss=float(gloss),
        shininess=float(shininess),
        roughness=float(rng.uniform(0.05, 0.4)),
        bubbles=int(rng.integers(0, 26 if kind == "translucent" else 6)),
    )


def _scene(rng: np.random.Generator, ground: str, material: str) -> Scene:
    if ground in ("paper", "lined", "grid"):
        # White silicone on white paper is what nobody would film; coloured or grey card is.
        value = (
            rng.uniform(0.25, 0.62)
            if material == "translucent" and rng.uniform() < 0.6
            else rng.uniform(0.72, 0.95)
        )
        colour = _hsv(rng.uniform(), rng.uniform(0.0, 0.3) if value < 0.7 else rng.uniform(0.0, 0.06), value)
        line = _hsv(rng.uniform(0.5, 0.7), rng.uniform(0.1, 0.6), 0.45 if value > 0.6 else 0.9)
    elif ground == "wood":
        colour = _hsv(rng.uniform(0.05, 0.11), rng.uniform(0.3, 0.62), rng.uniform(0.35, 0.8))
        line = (0.0, 0.0, 0.0)
    else:
        colour = _hsv(rng.choice([0.4, 0.58, 0.6, 0.1]), rng.uniform(0.0, 0.5), rng.uniform(0.14, 0.6))
        line = (0.0, 0.0, 0.0)
    metal = rng.uniform() < 0.5
    clamp = (
        _hsv(0.6, 0.04, rng.uniform(0.5, 0.8))
        if metal
        else _hsv(rng.uniform(), rng.uniform(0, 0.8), rng.uniform(0.15, 0.75))
    )
    return Scene(
        background=ground,
        colour=colour,
        line_colour=line,
        pitch_px=float(rng.uniform(9, 28)),
        turn_deg=float(rng.normal(0, 6) + 90 * rng.integers(2)),
        contrast=float(rng.uniform(0.5, 1.3)),
        clamp_colour=clamp,
        clamp_length_px=float(rng.uniform(26, 70)),
        clamp_overhang_px=(float(rng.uniform(3, 24)), float(rng.uniform(0, 26))),
        screws=int(rng.integers(0, 4)),
        tube_colour=_hsv(rng.uniform(), rng.choice([0.05, 0.7]), rng.uniform(0.25, 0.9)),
        tube_radius_px=float(rng.uniform(3, 7)),
        tube_bend=(float(rng.normal(0, 0.4)), float(rng.normal(0, 0.4))),
    )


def _light(rng: np.random.Generator) -> Light:
    warmth = rng.normal(0, 0.07)
    return Light(
        azimuth_deg=float(rng.uniform(0, 360)),
        elevation_deg=float(rng.uniform(28, 72)),
        ambient=float(rng.uniform(0.3, 0.65)),
        tint=(float(1 + warmth), 1.0, float(1 - warmth)),
        gradient=float(rng.uniform(0.0, 0.25)),
        vignette=float(rng.uniform(0.0, 0.22)),
        shadow=float(rng.uniform(0.2, 0.65)),
        shadow_softness_px=float(rng.choice([rng.uniform(1.5, 4), rng.uniform(5, 14)])),
        shadow_length_px=float(rng.uniform(3, 22)),
    )


def _camera(rng: np.random.Generator) -> Camera:
    return Camera(
        blur_px=float(rng.uniform(0.45, 1.1)),
        sharpening=float(rng.choice([0.0, rng.uniform(0.1, 0.6)])),
        noise=float(rng.uniform(0.6, 2.6)),
        colour_noise=float(rng.uniform(0.2, 1.2)),
        jpeg_quality=int(rng.integers(60, 95)),
        exposure_s=float(rng.uniform(0.004, 0.018)),
        flicker=float(rng.uniform(0.0, 0.012)),
        drift=float(rng.uniform(0.0, 0.03)),
    )
