"""From a look and an angle to a picture with its truth: the skin, placed in the scene, photographed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ..types import BoolArray, FloatArray, ImageArray
from .camera import NoisePool, blur_reach_px, blurred, developed
from .geometry import HIDDEN_PX, SEGMENTS, Midline
from .looks import KEYPOINTS, Look
from .scene import light_map, shadow_factor, still_scene, thrice
from .skin import TEXELS, Skin

# From this turn on the tip's half may come over the base's half and is laid over it.
_OVERLAP_DEG = 120.0
_FAR = np.float32(1e5)

Box = tuple[int, int, int, int]  # x0, y0, x1, y1; the last two excluded


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
    visible: BoolArray
    angle_deg: float
    midline: FloatArray


class Renderer:
    """Draws one look at any angle. Everything that does not move is drawn once, here."""

    def __init__(self, look: Look) -> None:
        self.look = look
        self._skin = Skin(look)
        self._behind, self._front = still_scene(look)
        rows, columns = np.nonzero(self._front[..., 3])
        self._front_box = (0, 0, 0, 0)
        if len(rows):
            self._front_box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
        still = self._behind.copy()
        self._put_front(still, (0, 0, *look.size_wh))
        self._still = blurred(still, look.camera)
        self._lit = 255 * thrice(light_map(look.light, look.size_wh))
        self._noise = NoisePool(look.camera, look.size_wh, look.seed)

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
        steps = int(np.clip(np.ceil(travel / 1.5), 1, 4))
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
        result = self._still.copy()
        tight, box = self._boxes(lines)
        if tight is None or box is None:
            return result
        middle = lines[len(lines) // 2]
        texture = self._skin.shaded(middle.heading_at(self._skin.s), look.pose.side, pressure)
        body = self._body(lines[0], texture, pressure, tight)
        for line in lines[1:]:
            body += self._body(line, texture, pressure, tight)
        body *= np.float32(1 / (255 * len(lines)))
        x0, y0, x1, y1 = box
        within = np.s_[tight[1] - y0 : tight[3] - y0, tight[0] - x0 : tight[2] - x0]
        cover = np.zeros((y1 - y0, x1 - x0), np.float32)
        cover[within] = body[..., 3]
        picture: FloatArray = self._behind[y0:y1, x0:x1] * thrice(shadow_factor(cover, look.light))
        part = picture[within]
        part *= thrice(1 - body[..., 3])
        part += cv2.cvtColor(body, cv2.COLOR_RGBA2RGB) * self._lit[tight[1] : tight[3], tight[0] : tight[2]]
        self._put_front(picture, box)
        picture = blurred(picture, look.camera)
        # The box has room for blur and shadow all round; its rim is the still scene again.
        rim = blur_reach_px(look.camera)
        height, width = result.shape[:2]
        top, left = (0 if y0 == 0 else rim), (0 if x0 == 0 else rim)
        bottom, right = (y1 - y0) - (0 if y1 == height else rim), (x1 - x0) - (0 if x1 == width else rim)
        result[y0 + top : y0 + bottom, x0 + left : x0 + right] = picture[top:bottom, left:right]
        return result

    def _put_front(self, picture: FloatArray, box: Box) -> None:
        """Lay the clamp over a part of the picture, in place."""
        fx0, fy0, fx1, fy1 = self._front_box
        x0, y0, x1, y1 = max(fx0, box[0]), max(fy0, box[1]), min(fx1, box[2]), min(fy1, box[3])
        if x1 > x0 and y1 > y0:
            front = self._front[y0:y1, x0:x1]
            part = picture[y0 - box[1] : y1 - box[1], x0 - box[0] : x1 - box[0]]
            part *= 1 - front[..., 3:]
            part += front[..., :3]

    def _boxes(self, lines: list[Midline]) -> tuple[Box | None, Box | None]:
        """Pixels that the body can touch, and that its shadow and blur can; None if out of the picture."""
        look = self.look
        s = np.linspace(-HIDDEN_PX, look.body.end_s, 60)
        t = np.array([[-look.body.layer_px], [self._skin.reach_px]])
        edges = np.concatenate([line.point(s, t).reshape(-1, 2) for line in (lines[0], lines[-1])])
        lx, ly, _ = look.light.direction
        shift: FloatArray = -look.light.shadow_length_px / max(np.hypot(lx, ly), 1e-6) * np.array([lx, ly])
        around = 3.2 * max(look.light.shadow_softness_px, 3.0) + blur_reach_px(look.camera) + 4
        low, high = edges.min(axis=0), edges.max(axis=0)
        return self._clipped(low - 3, high + 3), self._clipped(
            np.minimum(low, low + shift) - around, np.maximum(high, high + shift) + around
        )

    def _clipped(self, low: FloatArray, high: FloatArray) -> Box | None:
        """Whole pixels of the picture between two corners."""
        x0, y0 = (max(int(v), 0) for v in np.floor(low))
        x1, y1 = (min(int(v) + 1, size) for v, size in zip(np.ceil(high), self.look.size_wh, strict=True))
        return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None

    def _body(self, line: Midline, texture: ImageArray, pressure: float, box: Box) -> FloatArray:
        """Premultiplied RGBA of the lit body in the box, (h, w, 4) float32 0..255."""
        last = SEGMENTS + 1
        if abs(np.degrees(line.heading[-1] - line.heading[0])) < _OVERLAP_DEG:
            return self._placed(line, texture, pressure, box, (0, last))[0]
        half = SEGMENTS // 2 + 1
        cut = float(line.s[half])
        lower, below = self._placed(line, texture, pressure, box, (0, half))
        upper, above = self._placed(line, texture, pressure, box, (half - 1, last))
        # Around the cut the halves share pixels and add up to the whole; elsewhere the upper hides the lower.
        # Both see the same s there, so the two weights add up to 1.
        upper_weight = np.clip(above - cut + 0.5, 0, 1)
        upper *= upper_weight[..., None]
        lower *= (np.clip(cut - below + 0.5, 0, 1) * (1 - upper[..., 3] / 255 * (upper_weight == 1)))[
            ..., None
        ]
        upper += lower
        return upper

    def _placed(
        self,
        line: Midline,
        texture: ImageArray,
        pressure: float,
        box: Box,
        pieces: tuple[int, int],
    ) -> tuple[FloatArray, FloatArray]:
        """The texture, bent along some pieces of the midline.

        Returns
        -------
        rgba : premultiplied, of the box, (h, w, 4) float32 0..255
        s : (h, w) float32 px, `_FAR` where the pieces do not reach
        """
        body, skin = self.look.body, self._skin
        x0, y0, x1, y1 = box
        # Which piece of the midline each pixel belongs to: 0 none, else index + 1.
        owner = np.zeros((y1 - y0, x1 - x0), np.uint8)
        bounds = np.append(line.s, body.end_s + 4)
        bounds[0] = -HIDDEN_PX - 2
        inner = np.round((line.point(bounds, -body.layer_px - 4) - (x0, y0)) * 16).astype(np.int32)
        outer = np.round((line.point(bounds, skin.reach_px + 4) - (x0, y0)) * 16).astype(np.int32)
        for piece in range(pieces[0], pieces[1] + 1):
            quad = np.stack([inner[piece], inner[piece + 1], outer[piece + 1], outer[piece]])
            cv2.fillConvexPoly(owner, quad, piece + 1, cv2.LINE_8, 4)
        index = np.flatnonzero(owner)
        rows, columns = np.divmod(index.astype(np.int32), np.int32(x1 - x0))
        s, t = line.body_coordinates(
            (columns + x0).astype(np.float32),
            (rows + y0).astype(np.float32),
            owner.ravel()[index].astype(np.intp) - 1,
        )
        # The outer side stands higher under pressure: look up what stood there at rest.
        t = np.where(t > 0, t / skin.rise(s, pressure), t)
        maps = np.full((2, y1 - y0, x1 - x0), _FAR, np.float32)
        maps[0].ravel()[index] = s
        maps[1].ravel()[index] = t
        # Both maps are smooth, so two samples a px can be interpolated from one; `_FAR` stays outside.
        size = (2 * (x1 - x0), 2 * (y1 - y0))
        u = cv2.resize((maps[0] - skin.origin_s) * TEXELS, size, interpolation=cv2.INTER_LINEAR)
        v = cv2.resize((maps[1] - skin.origin_t) * TEXELS, size, interpolation=cv2.INTER_LINEAR)
        fine = cv2.remap(
            texture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0, 0)
        )
        coarse = cv2.resize(fine, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        return coarse.astype(np.float32), maps[0]


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
