"""From a look and an angle to a picture with its truth: places the skin in the scene and takes the photograph."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ..types import FloatArray, ImageArray
from .camera import NoisePool, blur_reach_px, blurred, developed
from .geometry import HIDDEN_PX, SEGMENTS, Midline
from .looks import KEYPOINTS, Look
from .scene import light_map, shadow_factor, still_scene
from .skin import TEXELS, Skin

# From this turn on the tip's half may come over the base's half and is laid over it.
_OVERLAP_DEG = 120.0
_FAR = np.float32(1e5)


@dataclass(frozen=True)
class RenderedFrame:
    """A picture and its exact truth.

    Attributes
    ----------
    image : RGB uint8 (H, W, 3)
    keypoints : names, the order of `xy`
    xy : (4, 2) float64 px
    visible : (4,) bool, inside the picture
    angle_deg : bending angle, positive toward the pose's side
    midline : (100, 2) float64 px, the strain-limiting line from the clamp's face to the tip
    """

    image: ImageArray
    keypoints: tuple[str, ...]
    xy: FloatArray
    visible: np.ndarray
    angle_deg: float
    midline: FloatArray


class Renderer:
    """Draws one look at any angle. Everything that does not move is drawn once, here."""

    def __init__(self, look: Look) -> None:
        self.look = look
        self._skin = Skin(look)
        behind, front = still_scene(look)
        self._behind, self._front = behind, front
        self._still = blurred(self._over(behind, front), look.camera)
        self._lit = light_map(look.light, look.size_wh)
        self._noise = NoisePool(look.camera, look.size_wh, look.seed)

    @staticmethod
    def _over(picture: FloatArray, layer: FloatArray) -> FloatArray:
        """Premultiplied RGBA `layer` (coverage 0..1) over `picture`."""
        result: FloatArray = picture * (1 - layer[..., 3:]) + layer[..., :3]
        return result

    def frame(
        self,
        angle_deg: float,
        pressure: float | None = None,
        *,
        sweep_deg: float = 0.0,
        gain: float = 1.0,
        rng: np.random.Generator | None = None,
    ) -> RenderedFrame:
        """Draw the actuator at an angle.

        Parameters
        ----------
        angle_deg : bending angle
        pressure : relative to the full one, swells the chambers; None takes the angle over 200 degrees
        sweep_deg : how far the angle moves while the shutter is open; the truth is the middle
        gain : exposure
        rng : where this frame's noise comes from; None draws no noise
        """
        look = self.look
        if pressure is None:
            pressure = float(np.clip(angle_deg / 200.0, 0, 1))
        middle = Midline(look.body, look.pose, angle_deg)
        travel = abs(np.radians(sweep_deg)) * look.body.end_s * 0.6
        steps = int(np.clip(np.ceil(travel), 1, 6))
        offsets = (np.arange(steps) + 0.5) / steps - 0.5
        lines = (
            [Midline(look.body, look.pose, angle_deg + sweep_deg * o) for o in offsets]
            if steps > 1
            else [middle]
        )
        picture = self._composed(lines, pressure)
        noise = self._noise.cut(rng) if rng is not None else None
        xy = middle.point(np.array(look.body.keypoint_s), look.body.keypoint_t)
        width, height = look.size_wh
        inside = (xy >= -0.5).all(axis=1) & (xy[:, 0] <= width - 0.5) & (xy[:, 1] <= height - 0.5)
        return RenderedFrame(
            image=developed(picture, look.camera, gain, noise),
            keypoints=KEYPOINTS,
            xy=xy,
            visible=inside,
            angle_deg=float(angle_deg),
            midline=middle.point(np.linspace(0, look.body.end_s, 100)),
        )

    def _composed(self, lines: list[Midline], pressure: float) -> FloatArray:
        """Still scene with the body in it, blurred, grey levels as float32."""
        look = self.look
        box = self._body_box(lines)
        if box is None:
            return self._still
        x0, y0, x1, y1 = box
        body = self._body(lines[0], pressure, box)
        for line in lines[1:]:
            body = body + self._body(line, pressure, box)
        body = body * np.float32(1 / (255 * len(lines)))
        area = np.s_[y0:y1, x0:x1]
        picture = (
            self._behind[area] * shadow_factor(np.ascontiguousarray(body[..., 3]), look.light)[..., None]
        )
        picture *= 1 - body[..., 3:]
        picture += body[..., :3] * (255 * self._lit[area])
        picture = blurred(self._over(picture, self._front[area]), look.camera)
        result = self._still.copy()
        # The box has room for blur and shadow all round; its rim is the still scene again.
        rim = blur_reach_px(look.camera)
        height, width = result.shape[:2]
        top, left = (0 if y0 == 0 else rim), (0 if x0 == 0 else rim)
        bottom, right = (y1 - y0) - (0 if y1 == height else rim), (x1 - x0) - (0 if x1 == width else rim)
        result[y0 + top : y0 + bottom, x0 + left : x0 + right] = picture[top:bottom, left:right]
        return result

    def _body_box(self, lines: list[Midline]) -> tuple[int, int, int, int] | None:
        """Pixels that the body, its shadow and its blur can touch: x0, y0, x1, y1; None if out of the picture."""
        look = self.look
        s = np.linspace(-HIDDEN_PX, look.body.end_s, 60)
        edges = np.concatenate(
            [
                line.point(s, t)
                for line in (lines[0], lines[-1])
                for t in (-look.body.layer_px, self._skin.reach_px)
            ]
        )
        lx, ly, _ = look.light.direction
        shift = -look.light.shadow_length_px / max(np.hypot(lx, ly), 1e-6) * np.array([lx, ly])
        around = 3.2 * max(look.light.shadow_softness_px, 3.0) + blur_reach_px(look.camera) + 4
        low = np.minimum(edges.min(axis=0), (edges + shift).min(axis=0)) - around
        high = np.maximum(edges.max(axis=0), (edges + shift).max(axis=0)) + around
        x0, y0 = (max(int(v), 0) for v in np.floor(low))
        x1, y1 = (min(int(v) + 1, size) for v, size in zip(np.ceil(high), look.size_wh, strict=True))
        return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None

    def _body(self, line: Midline, pressure: float, box: tuple[int, int, int, int]) -> FloatArray:
        """Premultiplied RGBA of the lit body in the box, float32 0..255."""
        look, skin = self.look, self._skin
        texture = skin.shaded(line.heading_at(skin.s), look.pose.side, pressure)
        last = SEGMENTS + 1
        if abs(np.degrees(line.heading[-1] - line.heading[0])) < _OVERLAP_DEG:
            return self._placed(line, texture, pressure, box, (0, last), None)
        half = SEGMENTS // 2 + 1
        cut = float(line.s[half])
        lower = self._placed(line, texture, pressure, box, (0, half), (-np.inf, cut))
        upper = self._placed(line, texture, pressure, box, (half - 1, last), (cut, np.inf))
        # At the cut the two halves share pixels and add up; elsewhere the upper one hides the lower.
        together = lower[..., 3] + upper[..., 3]
        cover = np.where(self._near_cut(line, cut, box), 1.0, 1 - upper[..., 3] / 255)
        del together
        result: FloatArray = upper + lower * cover[..., None].astype(np.float32)
        return result

    def _near_cut(self, line: Midline, cut: float, box: tuple[int, int, int, int]) -> FloatArray:
        """Pixels within 2 px of the cross-section at s = cut, as a mask."""
        x0, y0, x1, y1 = box
        ends = line.point(np.array([cut, cut]), np.array([-self.look.body.layer_px - 2, self._skin.reach_px]))
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        a, b = (tuple(int(v) for v in np.round((end - (x0, y0)) * 16)) for end in ends)
        cv2.line(mask, a, b, 1, 4, cv2.LINE_8, 4)
        return mask.astype(bool)

    def _placed(
        self,
        line: Midline,
        texture: ImageArray,
        pressure: float,
        box: tuple[int, int, int, int],
        pieces: tuple[int, int],
        keep_s: tuple[float, float] | None,
    ) -> FloatArray:
        """The texture, bent along some pieces of the midline; premultiplied RGBA of the box, float32 0..255."""
        body, skin = self.look.body, self._skin
        x0, y0, x1, y1 = box
        # Which piece of the midline each pixel belongs to: 0 none, else index + 1.
        owner = np.zeros((y1 - y0, x1 - x0), np.uint8)
        bounds = np.append(line.s, body.end_s + 4)
        bounds[0] = -HIDDEN_PX - 2
        low, high = -body.layer_px - 4, skin.reach_px + 4
        for piece in range(pieces[0], pieces[1] + 1):
            a, b = bounds[piece], bounds[piece + 1]
            quad = line.point(np.array([a, b, b, a]), np.array([low, low, high, high])) - (x0, y0)
            cv2.fillConvexPoly(owner, np.round(quad * 16).astype(np.int32), piece + 1, cv2.LINE_8, 4)
        rows, columns = np.nonzero(owner)
        piece_of = owner[rows, columns].astype(np.intp) - 1
        s, t = line.body_coordinates(
            (columns + x0).astype(np.float32), (rows + y0).astype(np.float32), piece_of
        )
        # The outer side stands higher under pressure: look up what stood there at rest.
        t = np.where(t > 0, t / skin.rise(s, pressure), t)
        maps = np.full((2, y1 - y0, x1 - x0), _FAR, np.float32)
        maps[0][rows, columns] = (s - skin.origin_s) * TEXELS
        maps[1][rows, columns] = (t - skin.origin_t) * TEXELS
        size = (2 * (x1 - x0), 2 * (y1 - y0))
        # Both maps are smooth, so two samples a px can be interpolated from one; `_FAR` stays outside.
        u, v = (cv2.resize(m, size, interpolation=cv2.INTER_LINEAR) for m in maps)
        fine = cv2.remap(
            texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0, 0)
        )
        if keep_s is not None:
            at = u / TEXELS + skin.origin_s
            keep = np.clip(at - keep_s[0] + 0.5, 0, 1) * np.clip(keep_s[1] - at + 0.5, 0, 1)
            fine = fine * keep[..., None].astype(np.float32)
        coarse = cv2.resize(fine.astype(np.float32), (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        return coarse


@lru_cache(maxsize=4)
def _renderer(look: Look) -> Renderer:
    return Renderer(look)


def render_frame(
    look: Look,
    angle_deg: float,
    pressure: float | None = None,
    *,
    seed: int | None = 0,
    sweep_deg: float = 0.0,
    gain: float = 1.0,
) -> RenderedFrame:
    """Draw one picture of a look; for many of one look, `Renderer` says it plainly and is as quick.

    `seed` draws the sensor noise (None: no noise); the other parameters are those of `Renderer.frame`.
    """
    rng = None if seed is None else np.random.default_rng([look.seed, 5, seed])
    return _renderer(look).frame(angle_deg, pressure, sweep_deg=sweep_deg, gain=gain, rng=rng)
