"""What the body is made of: colour, coverage and relief as textures in body coordinates, and their shading.

Nothing here knows where the body is in the image; `render` places it.
"""

from __future__ import annotations

import cv2
import numpy as np

from ..types import FloatArray, ImageArray
from .geometry import HIDDEN_PX
from .looks import Body, Look, Material

# Texels a px. Two is what the picture is supersampled with, so texels and samples are of one size.
TEXELS = 2.0
_MARGIN_PX = 4.0


def _box(
    s: FloatArray, t: FloatArray, span_s: tuple[float, float], span_t: tuple[float, float], radius: float
) -> FloatArray:
    """Signed distance to a rounded box, negative inside."""
    (s0, s1), (t0, t1) = span_s, span_t
    radius = min(radius, 0.5 * (s1 - s0), 0.5 * (t1 - t0))
    ds = np.abs(s - 0.5 * (s0 + s1)) - 0.5 * (s1 - s0) + radius
    dt = np.abs(t - 0.5 * (t0 + t1)) - 0.5 * (t1 - t0) + radius
    outside = np.hypot(np.maximum(ds, 0), np.maximum(dt, 0))
    distance: FloatArray = outside + np.minimum(np.maximum(ds, dt), 0) - radius
    return distance


def _rounded(distance: FloatArray, radius: float) -> FloatArray:
    """Height of a rounded rim: 0 at the edge, `radius` from `radius` px inward on."""
    rim = np.clip(1 + distance / radius, 0, 1)
    height: FloatArray = radius * np.sqrt(1 - rim * rim)
    return height


def _step(distance: FloatArray) -> FloatArray:
    """Anti-aliased inside (1) or outside (0): a ramp one texel wide around distance 0."""
    coverage: FloatArray = np.clip(0.5 - distance * TEXELS, 0, 1)
    return coverage


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], cell_px: float) -> FloatArray:
    """Random field of about unit variance that varies over `cell_px`, float32."""
    height, width = shape
    rows, columns = max(2, round(height / cell_px) + 2), max(2, round(width / cell_px) + 2)
    coarse = rng.standard_normal((rows, columns), dtype=np.float32)
    field: FloatArray = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * 1.3
    return field


def chamber_edges(body: Body) -> FloatArray:
    """s of the chambers' boundaries, (chambers + 1,); `centre_factor` stretches the middle ones."""
    start, end = body.chambers_s
    place = (np.arange(body.chambers) + 0.5) / body.chambers
    lengths = 1 + (body.centre_factor - 1) * np.sin(np.pi * place) ** 2
    edges: FloatArray = start + (end - start) * np.concatenate([[0], np.cumsum(lengths) / lengths.sum()])
    return edges


class Skin:
    """Textures of one look.

    Texel (v, u) is the point s = `origin_s` + u / TEXELS, t = `origin_t` + v / TEXELS.

    Attributes
    ----------
    reach_px : how far outward the body can extend when fully swollen
    """

    def __init__(self, look: Look) -> None:
        body, material = look.body, look.material
        rng = np.random.default_rng([look.seed, 1])
        self._material, self._light = material, look.light
        self.origin_s = -HIDDEN_PX
        self.origin_t = -body.layer_px - _MARGIN_PX
        self.flange_px = body.cap_height_px + 0.35 * (body.height_px - body.cap_height_px) + 4.0
        top = max(body.height_px, self.flange_px) + _MARGIN_PX
        shape = (
            round((top - self.origin_t) * TEXELS) + 1,
            round((body.end_s + _MARGIN_PX + HIDDEN_PX) * TEXELS) + 1,
        )
        t, s = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32) / np.float32(TEXELS)
        s += np.float32(self.origin_s)
        t += np.float32(self.origin_t)
        self.s = s[0]
        self._edges = chamber_edges(body)
        self._uneven = np.clip(1 + body.unevenness * rng.standard_normal(body.chambers), 0.4, 1.6)
        self.reach_px = top + body.swell * body.height_px * float(self._uneven.max())
        self._draw(s, t, body, material, rng)

    def _draw(
        self, s: FloatArray, t: FloatArray, body: Body, material: Material, rng: np.random.Generator
    ) -> None:
        core_px = body.height_px * (1 - body.gap_depth)
        start, end = body.chambers_s
        pitch = (end - start) / body.chambers
        gap = 0.5 * body.gap_width * pitch
        base_1, base_2, tip_1, _ = body.keypoint_s
        low = -body.layer_px

        layer = _box(s, t, (-2 * HIDDEN_PX, body.end_s), (low, 0.0), 0.0)
        core = _box(s, t, (-2 * HIDDEN_PX, body.end_s), (low, min(core_px, body.cap_height_px)), 0.0)
        core = np.minimum(core, _box(s, t, (start, end), (low, core_px), 0.0))
        caps = np.minimum(
            _box(s, t, (-2 * HIDDEN_PX, start), (low, body.cap_height_px), 0.0),
            _box(s, t, (end, body.end_s), (low, body.cap_height_px), 0.0),
        )
        if body.marks == "steps":
            caps = np.minimum(caps, _box(s, t, (-2 * HIDDEN_PX, base_1), (low, self.flange_px), 0.0))
        rim = 0.09 * body.height_px + 2.0
        relief = np.maximum(_rounded(core, rim) - 0.16 * pitch, _rounded(caps, rim))
        outline = np.minimum(np.minimum(core, caps), layer)
        pillow = np.zeros_like(s)
        cavity = np.zeros_like(s)
        lobe = np.zeros_like(s[0])
        for left, right, uneven in zip(self._edges[:-1], self._edges[1:], self._uneven, strict=True):
            first, last = left == self._edges[0], right == self._edges[-1]
            span = (left + (0 if first else gap), right - (0 if last else gap))
            radius = body.roundness * (span[1] - span[0])
            chamber = _box(s, t, span, (low, body.height_px), 0.0)
            # Only the outer corners are round: the inner ones meet the core.
            chamber = np.maximum(chamber, _box(s, t, span, (low - 2 * radius, body.height_px), radius))
            outline = np.minimum(outline, chamber)
            relief = np.maximum(relief, _rounded(chamber, min(rim * 1.3, 0.45 * (span[1] - span[0]))))
            across = np.clip((s - span[0]) / (span[1] - span[0]), 0, 1)
            up = np.clip(t / body.height_px, 0, 1)
            pillow += uneven * np.sin(np.pi * across) * np.sin(np.pi * up**0.8)
            inset = 0.18 * (span[1] - span[0]) + 1.0
            cavity = np.maximum(
                cavity,
                1
                / (
                    1
                    + np.exp(
                        _box(
                            s,
                            t,
                            (span[0] + inset, span[1] - inset),
                            (0.14 * body.height_px, 0.84 * body.height_px),
                            3.0,
                        )
                        / 0.8
                    )
                ),
            )
            lobe += (uneven * np.sin(np.pi * np.clip((s[0] - left) / (right - left), 0, 1))).astype(
                lobe.dtype
            )
        self._lobe = lobe * body.swell

        in_layer = _step(t) * _step(-t + low)
        relief += material.roughness * smooth_noise(rng, s.shape, 44)
        relief += 0.25 * material.roughness * smooth_noise(rng, s.shape, 12)
        # The seam between the layer and the body is a shallow groove.
        relief -= 0.8 * np.exp(-np.square(t / 0.9))
        marks = self._marks(s, t, body, base_1, base_2, tip_1)
        bubble_relief, bubble_shade = self._bubbles(s, t, body, material, rng)

        self._relief = relief + bubble_relief - 0.4 * marks
        self._pillow = pillow * 0.22 * pitch * (body.swell / 0.25)
        gap_shade = np.clip(1 - 0.10 * (cv2.GaussianBlur(relief, (0, 0), 3.5 * TEXELS) - relief), 0.45, 1.05)
        cloth = 1 + 0.05 * np.sin(2 * np.pi * s / 2.6) * in_layer
        tone = (1 + 0.035 * smooth_noise(rng, s.shape, 50)) * gap_shade * cloth * (1 + bubble_shade)
        colour = np.asarray(material.colour, np.float32) ** 2
        layer_colour = np.asarray(material.layer_colour, np.float32) ** 2
        mark_colour = np.asarray(material.mark_colour, np.float32) ** 2
        albedo = colour + (layer_colour - colour) * in_layer[..., None]
        albedo = albedo * tone[..., None]
        if material.kind == "translucent":
            albedo = albedo * (1 - 0.16 * cavity[..., None])
        albedo = albedo + (mark_colour - albedo) * (0.85 * marks)[..., None]
        self._albedo = [np.ascontiguousarray(albedo[..., c], dtype=np.float32) for c in range(3)]
        self._cavity = cavity.astype(np.float32)
        thin = np.clip(-outline / 7.0, 0, 1)
        opacity = (
            material.opacity * (0.8 + 0.2 * thin) if material.kind == "translucent" else material.opacity
        )
        opacity = np.maximum(opacity, np.maximum(in_layer, marks) * 0.97)
        self._alpha = (_step(outline) * opacity).astype(np.float32)
        self._gradient = self._slopes(self._relief)
        self._pillow_gradient = self._slopes(self._pillow)

    @staticmethod
    def _marks(
        s: FloatArray, t: FloatArray, body: Body, base_1: float, base_2: float, tip_1: float
    ) -> FloatArray:
        """Coverage of the marks that the keypoints sit on; the outline's corners need none."""
        if body.marks == "pins":
            distance = np.full_like(s, np.inf)
            for place in body.keypoint_s:
                distance = np.minimum(distance, np.hypot(s - place, t - body.keypoint_t))
            return np.clip(0.5 + (body.mark_radius_px - distance) / 1.2, 0, 1)
        if body.marks == "seams":
            lines = np.zeros_like(s)
            for place in (base_1, base_2, tip_1):
                lines = np.maximum(lines, np.exp(-np.square((s - place) / 0.9)))
            return lines * _step(t - body.cap_height_px)
        return np.zeros_like(s)

    @staticmethod
    def _bubbles(
        s: FloatArray, t: FloatArray, body: Body, material: Material, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Air bubbles and specks: small dents and spots away from the marks."""
        relief, shade = np.zeros_like(s), np.zeros_like(s)
        for _ in range(material.bubbles):
            centre = rng.uniform(*body.chambers_s), rng.uniform(2, 0.9 * body.height_px)
            radius = rng.uniform(0.5, 1.6)
            spot = np.exp(-0.5 * (np.square(s - centre[0]) + np.square(t - centre[1])) / radius**2)
            relief -= 0.8 * radius * spot
            shade += rng.uniform(-0.25, 0.12) * spot
        return relief, shade

    @staticmethod
    def _slopes(relief: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slopes of the relief along s and t, px per px."""
        relief = relief.astype(np.float32)
        scale = TEXELS / 8
        along = cv2.Sobel(relief, cv2.CV_32F, 1, 0, ksize=3, scale=scale)
        across = cv2.Sobel(relief, cv2.CV_32F, 0, 1, ksize=3, scale=scale)
        return np.asarray(along, np.float32), np.asarray(across, np.float32)

    def rise(self, s: FloatArray, pressure: float) -> FloatArray:
        """How many times as high as at rest the body stands at s. `pressure` is relative to the full one."""
        rise: FloatArray = 1 + pressure * np.interp(s, self.s, self._lobe).astype(np.float32)
        return rise

    def shaded(self, heading: FloatArray, side: int, pressure: float) -> ImageArray:
        """Premultiplied RGBA texture (V, U, 4) uint8 of the lit body.

        Parameters
        ----------
        heading : (U,) direction of each texture column in the image, radians
        side : of the pose
        pressure : relative to the full one
        """
        light, material = self._light, self._material
        lx, ly, lz = light.direction
        cos, sin = np.cos(heading), np.sin(heading)
        along = (lx * cos + ly * sin).astype(np.float32)
        outward = (side * (lx * sin - ly * cos)).astype(np.float32)
        pressure = float(pressure)
        slope_s = self._gradient[0] + pressure * self._pillow_gradient[0]
        slope_t = self._gradient[1] + pressure * self._pillow_gradient[1]
        up = 1 / np.sqrt(1 + slope_s * slope_s + slope_t * slope_t)
        facing = (np.float32(lz) - slope_s * along - slope_t * outward) * up
        # Light that enters a translucent body leaves it elsewhere: the shade's edge is soft.
        wrap = {"translucent": 0.6, "pigmented": 0.25, "rubber": 0.1}[material.kind]
        lit = np.maximum((facing + np.float32(wrap)) * np.float32(1 / (1 + wrap)), 0)
        key = np.float32((1 - light.ambient) / max(lz, 0.35))
        level = np.float32(light.ambient) * (0.55 + 0.45 * up) + key * lit
        # Mirror direction of the view (0, 0, 1) against the light: 2 (n.v)(n.l) - l.v.
        mirror = np.maximum(2 * up * facing - np.float32(lz), 0)
        gloss = np.asarray(cv2.pow(mirror, material.shininess)) + np.float32(0.12) * np.asarray(
            cv2.pow(mirror, 3)
        )
        # Grazing surfaces mirror the room.
        gloss += np.float32(0.10) * np.square(1 - up)
        gloss *= np.float32(material.gloss)
        # Stretched walls let more light through.
        level *= 1 + np.float32(0.06 * pressure) * self._cavity
        alpha = 255 * self._alpha
        planes = []
        for albedo, tint in zip(self._albedo, light.tint, strict=True):
            plane = np.minimum(albedo * (level * np.float32(tint)) + gloss, 1)
            planes.append(np.sqrt(plane) * alpha)
        rgba = cv2.merge([*planes, alpha])
        texture: ImageArray = np.asarray(cv2.convertScaleAbs(rgba), np.uint8)
        return texture
