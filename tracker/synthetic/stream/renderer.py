"""The renderer: from a look and a bend to an image with its exact truth.

Its parts (background, clamp, body texture, warp, exposure) live in modules of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ...types import BoolArray, FloatArray, ImageArray
from .backgrounds import background
from .body_texture import draw_texture
from .chain import DENSE, KEYPOINTS, Chain, Projection, opposite, turn_in_image_deg
from .clamps import clamp, hub, reach
from .distractors import Painter
from .disturbances import CALM, Disturbances, load
from .exposure import expose, light_map
from .extras import NO_EXTRAS, Extras
from .finish import BARE, Finish, draw_loose_ends
from .look import Body, Light, Look, Place
from .metal import bracket
from .paint import Shade, axes, curve
from .warp import Layer, warped

# Bodies that cover more than this many px are not supersampled.
_LARGE_PX = 2500
# A tip moves about this share of the body's length for each radian of bend.
_TIP_TRAVEL = 0.5
# A way of the tip during the exposure, px: a shorter one cannot be seen, and its blur costs two more bends to draw.
_SHARP_PX = 2.0


@dataclass(frozen=True)
class Sample:
    """An image and its exact truth.

    Attributes
    ----------
    image : ndarray
        RGB uint8 (H, W, 3).
    midline_xy : ndarray
        (96, 2) px of the image, evenly along the body from where it leaves the clamp to its end.
    keypoints_xy : ndarray
        (9, 2) px, in the order of `KEYPOINTS`.
    visible : ndarray
        (9,) bool; within the image, and nothing lies before it.
    angle_deg : float
        Turn from base_2 - base_1 to tip_2 - tip_1 in the image, followed along the body, clockwise on
        the screen positive; of a tilted plane not the bend that was asked for.
    look : Look
        What is shown; `look.words` are its families.
    kinds : tuple of str
        Kinds of extras that are shown, see `extras.KINDS`.
    """

    image: ImageArray
    midline_xy: FloatArray
    keypoints_xy: FloatArray
    visible: BoolArray
    angle_deg: float
    look: Look
    kinds: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Shot:
    """What is in front of the camera at one bend.

    Attributes
    ----------
    image : ndarray
        RGB uint8 (H, W, 3), not exposed yet.
    chain : Chain
        Of the labelled arm.
    behind, front : Layer or None
        Halves of the labelled arm, see `warp.warped`.
    occluded, clamped : ndarray
        Coverage by occluders and by the labelled arm's clamp, uint8 (H, W).
    """

    image: ImageArray
    chain: Chain
    behind: Layer | None
    front: Layer | None
    occluded: ImageArray
    clamped: ImageArray


class Renderer:
    """Draws one look at any angle. What does not move is drawn once, here.

    Parameters
    ----------
    look : Look
    bystanders : sequence of (Look, float), optional
        Bodies that lie about and do not move, such as a tube that looks like an actuator: of each its body, surface and
        place, and its bend in degrees.
    disturbances : Disturbances, optional
        What else goes on during the film, and whether clamp and camera give way.
    extras : Extras, optional
        What the body has on it and what is about it besides the look.
    """

    def __init__(
        self,
        look: Look,
        bystanders: Sequence[tuple[Look, float]] = (),
        disturbances: Disturbances = CALM,
        extras: Extras = NO_EXTRAS,
    ) -> None:
        self.look = look
        self._bystanders = bystanders
        self._disturbances = disturbances
        self._extras = extras
        self._unit = max(look.size_wh) / 256
        self._projection = Projection(look.view, look.size_wh)
        self._background, self._texture = background(look.words.background, look.scene, look.size_wh)
        self._lit = light_map(look.light, look.size_wh)
        light = look.light
        toward = np.array([np.cos(np.radians(light.azimuth_deg)), np.sin(np.radians(light.azimuth_deg))])
        x, y = (-light.shadow_px * toward).tolist()
        self._shade = Shade((x, y), light.softness_px, light.shadow)
        second = opposite(look.place)
        self._places = (look.place,) if second is None else (second, look.place)
        self._draw_behind()

    def frame(
        self,
        bend_deg: float,
        pressure: float | None = None,
        noise_seed: int = 0,
        moment: float | None = None,
        sweep_deg: float = 0.0,
    ) -> Sample:
        """Draw the actuator.

        Parameters
        ----------
        bend_deg : float
            Bend in the plane of the body, toward the side to which it bends under pressure.
        pressure : float or None
            Relative to the full one, swells the chambers. None: in proportion to the bend.
        noise_seed : int
            Of the sensor's noise.
        moment : float or None
            Place in the film, from 0 to 1, at which the exposure has drifted and disturbances are as far as they are
            then. None: the exposure as the look sets it.
        sweep_deg : float
            How far the bend moves while the shutter is open. The truth is that of the middle.

        Returns
        -------
        Sample
            The image and its truth.
        """
        look = self.look
        if pressure is None:
            pressure = float(np.clip(bend_deg / max(look.bend_deg[1], 90.0), 0, 1))
        travel_px = abs(np.radians(sweep_deg)) * _TIP_TRAVEL * look.body.length_px
        # An odd number: the middle one is at `bend_deg` exactly.
        steps = 1 + 2 * min(int(travel_px / _SHARP_PX), 2)
        shots = [
            self._composed(bend_deg + sweep_deg * ((k + 0.5) / steps - 0.5), pressure, moment)
            for k in range(steps)
        ]
        middle = shots[steps // 2]
        rng = np.random.default_rng([look.scene.seed, 9, noise_seed])
        seen = self._disturbances.shadowed(_averaged([shot.image for shot in shots]), moment)
        shake_xy = self._disturbances.shake_xy(moment)
        image = expose(_shifted(seen, shake_xy), self._lit, self._light_at(moment), look.sensor, rng)
        return self._with_truth(image, middle, shake_xy)

    def _composed(self, bend_deg: float, pressure: float, moment: float | None) -> _Shot:
        """Background, shadow, body, clamps and occluders at one bend, before the camera."""
        look = self.look
        own = self._disturbances.place(look, bend_deg)
        places = (*self._places[:-1], own)
        chains = [Chain(look.body, place, bend_deg) for place in places]
        image = self._background.copy()
        self._disturb_behind(image, bend_deg, moment)
        fine = _samples_a_px(look.body)
        layers: list[tuple[Layer | None, Layer | None]] = []
        for chain in chains:
            texture = draw_texture(
                look.body, look.surface, look.light, chain, pressure, 0.6 + 0.7 * fine, self._extras.finish
            )
            layers.append(warped(texture, chain, self._projection, look.size_wh, look.body.tip_over, fine))
        shadow = self._texture * self._shadow([layer for pair in layers for layer in pair if layer], places)
        image = cv2.multiply(image, cv2.cvtColor(shadow, cv2.COLOR_GRAY2RGB), dtype=cv2.CV_8U)
        clamped, cover = np.zeros((2, *image.shape[:2]), np.uint8)
        # The labelled arm comes last and lies over the other.
        for place, (behind, front) in zip(places, layers, strict=True):
            for layer in (behind, front):
                if layer is not None:
                    _blend(image, layer, self._shade if layer is front and behind is not None else None)
            if place is own and self._extras.finish is not BARE:
                finish, colour = self._extras.finish, look.surface.colour
                draw_loose_ends(finish, look.body, colour, image, chains[-1], self._projection)
            self._clamp(image, place, clamped if place is own else None)
        self._occlude(image, cover)
        hand_rng = np.random.default_rng([look.scene.seed, 11])
        self._disturbances.draw_hand(Painter(image, hand_rng, self._unit, self._shade, cover), moment)
        return _Shot(image, chains[-1], *layers[-1], cover, clamped)

    def _light_at(self, moment: float | None) -> Light:
        """The look's light, its exposure up and down a few times during the film."""
        light = self.look.light
        if moment is None:
            return light
        times, phase = np.random.default_rng([self.look.scene.seed, 10]).uniform((0.7, 0.0), (3.0, 1.0))
        wander = 1 + light.drift * np.sin(2 * np.pi * (times * moment + phase))
        return replace(light, gain=light.gain * float(wander))

    def _with_truth(self, image: ImageArray, shot: _Shot, shake_xy: FloatArray) -> Sample:
        """The image that the camera hands over, and the truth of what was in front of it."""
        chain, behind, front = shot.chain, shot.behind, shot.front
        s = np.concatenate([np.linspace(0, chain.length_px, DENSE), chain.keypoint_s])
        midline, keypoints = np.split(self._projection.to_image(chain.point(s)), [DENSE])
        width, height = self.look.size_wh
        x_px, y_px = keypoints.T
        visible = (x_px >= -0.5) & (x_px <= width - 0.5) & (y_px >= -0.5) & (y_px <= height - 0.5)
        # Where the body overlaps itself, the hinder half's points may lie under the front half.
        hinder = (
            slice(0, len(KEYPOINTS) // 2) if self.look.body.tip_over else slice(len(KEYPOINTS) // 2 + 1, None)
        )
        for index in np.flatnonzero(visible):
            x, y = min(max(round(x_px[index]), 0), width - 1), min(max(round(y_px[index]), 0), height - 1)
            # The body leaves the clamp at its edge: that point is seen.
            if shot.occluded[y, x] > 127 or (index > 0 and shot.clamped[y, x] > 127):
                visible[index] = False
            if behind is not None and front is not None and index in range(len(KEYPOINTS))[hinder]:
                u, v = x - front.x0, y - front.y0
                inside = 0 <= v < front.rgba.shape[0] and 0 <= u < front.rgba.shape[1]
                if inside and front.rgba[v, u, 3] > 127:
                    visible[index] = False
        angle = turn_in_image_deg(keypoints, midline)
        if shake_xy.any():
            midline, keypoints = midline + shake_xy, keypoints + shake_xy
            visible &= ((keypoints >= -0.5) & (keypoints <= np.array([width, height]) - 0.5)).all(axis=1)
        return Sample(image, midline, keypoints, visible, angle, self.look, self._extras.kinds)

    def _disturb_behind(self, image: ImageArray, bend_deg: float, moment: float | None) -> None:
        """Tubes and cables that move a little, drawn in place over the background."""
        look = self.look
        for tube in self._disturbances.tubes:
            rest_deg, full_deg = tube.bend_deg
            own_deg = rest_deg + (full_deg - rest_deg) * load(look, bend_deg)
            self._lay_down(image, tube.look, own_deg)
        # A hose is drawn without any random number.
        painter = Painter(image, np.random.default_rng(0), self._unit, self._shade)
        self._disturbances.draw_cable(painter, moment)

    def _lay_down(
        self, image: ImageArray, other: Look, bend_deg: float, finish: Finish = BARE, fine: int = 2
    ) -> None:
        """Another look's body, drawn in place in this look's light."""
        chain = Chain(other.body, other.place, bend_deg)
        light, size_wh = self.look.light, self.look.size_wh
        texture = draw_texture(other.body, other.surface, light, chain, 0.0, 0.95 * fine, finish)
        for layer in warped(texture, chain, self._projection, size_wh, other.body.tip_over, fine):
            if layer is not None:
                _blend(image, layer, self._shade)

    def _draw_behind(self) -> None:
        """Things that lie about and the tubes: into the background."""
        look, scene = self.look, self.look.scene
        rng = np.random.default_rng([scene.seed, 4])
        painter = Painter(self._background, rng, self._unit, self._shade)
        # Extras draw from a generator of their own: without any, a look's images stay what they are.
        own = Painter(
            self._background, np.random.default_rng([self._extras.seed, 16]), self._unit, self._shade
        )
        self._extras.draw_sheet(own)
        for _ in range(scene.distractors):
            painter.any_distractor(rng.random(2) * look.size_wh, rng.uniform(0, 2 * np.pi))
        for place in self._places:
            turn = rng.normal(0, 0.25, 6).cumsum()
            if not scene.tube_px:
                continue
            heading = np.radians(place.direction_deg) + np.pi + turn
            along, _ = axes(np.radians(place.direction_deg))
            start = (
                np.asarray(place.base_xy) - 2 * look.body.half_px * (reach(look.words.clamp) - 0.4) * along
            )
            steps = 40 * self._unit * np.stack([np.cos(heading), np.sin(heading)], axis=1)
            knots = np.concatenate([start[None], start + np.cumsum(steps, axis=0)])
            painter.hose(self._projection.to_image(curve(knots)), scene.tube_colour, scene.tube_px)
        if len(self._places) == 2:
            self._mount(painter, rng)
        self._extras.draw_things(own)
        for other, bend_deg in self._bystanders:
            self._lay_down(self._background, other, bend_deg)
        for bystander in self._extras.bystanders:
            fine = _samples_a_px(bystander.look.body)
            self._lay_down(self._background, bystander.look, bystander.bend_deg, bystander.finish, fine)
        self._extras.draw_fittings(own, self._projection)

    def _mount(self, painter: Painter, rng: np.random.Generator) -> None:
        """What joins the clamps of two arms."""
        ends = []
        for place in self._places:
            heading = np.radians(place.direction_deg)
            along, across = axes(heading)
            thick = 2 * self.look.body.half_px
            base = np.asarray(place.base_xy)
            ends += [
                base - along * back * thick + across * side * thick
                for back in (0.4, 1.6)
                for side in (-0.7, 0.7)
            ]
        hull = cv2.convexHull(np.asarray(ends, np.float32)).reshape(-1, 2).astype(float)
        painter.fill(self._projection.to_image(hull), self.look.scene.clamp_colour)

    def _clamp(self, image: ImageArray, place: Place, cover: ImageArray | None) -> None:
        look = self.look
        thick = max(2 * look.body.half_px, 7 * self._unit)
        heading = np.radians(place.direction_deg)
        along, across = axes(heading)
        unit = thick * np.array([along, across])

        def local(st: FloatArray) -> FloatArray:
            # OpenCV fills a polygon about half a px beyond its outline; the face is to lie at the base.
            return self._projection.to_image(np.asarray(place.base_xy) - 0.45 * along + st @ unit)

        rng = np.random.default_rng([look.scene.clamp_seed, 5])
        painter = Painter(image, rng, self._unit, None, cover)
        if self._extras.base == "bracket":
            bracket(local, painter, heading)
        elif self._extras.base == "hub":
            hub(look.surface.colour, local, thick, painter)
        else:
            clamp(look.words.clamp, look.scene.clamp_colour, local, thick, painter)

    def _occlude(self, image: ImageArray, cover: ImageArray) -> None:
        """Things that lie over the body halfway through its bends, and do not move with it."""
        look, scene = self.look, self.look.scene
        if not scene.occluders:
            return
        chain = Chain(look.body, look.place, sum(look.bend_deg) / 2)
        rng = np.random.default_rng([scene.seed, 6])
        painter = Painter(image, rng, self._unit, self._shade, cover)
        for _ in range(scene.occluders):
            s = rng.uniform(0.15, 1.0) * chain.length_px
            place = self._projection.to_image(chain.point(s))
            across = float(chain.heading_at(np.array(s))) + np.pi / 2 + rng.normal(0, 0.5)
            painter.any_occluder(place, across + np.pi * int(rng.integers(2)))

    def _shadow(self, layers: list[Layer], places: Sequence[Place]) -> FloatArray:
        """What the bodies' and clamps' shadow leaves of the light on the background, (H, W) float32."""
        light, (width, height) = self.look.light, self.look.size_wh
        mask = np.zeros((height, width), np.uint8)
        for layer in layers:
            rows, columns = layer.rgba.shape[:2]
            part = mask[layer.y0 : layer.y0 + rows, layer.x0 : layer.x0 + columns]
            np.maximum(part, layer.rgba[..., 3], out=part)
        for place in places:
            heading, thick = np.radians(place.direction_deg), 2 * self.look.body.half_px
            along, _ = axes(heading)
            ends = np.array([place.base_xy, np.asarray(place.base_xy) - 1.2 * thick * along])
            corners = np.round(self._projection.to_image(ends)).astype(np.int32)
            cv2.line(
                mask, tuple(corners[0].tolist()), tuple(corners[1].tolist()), 255, max(1, int(1.2 * thick))
            )
        small = cv2.resize(mask, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
        move = np.array([[1, 0, 0.5 * self._shade.offset_xy[0]], [0, 1, 0.5 * self._shade.offset_xy[1]]])
        moved = cv2.warpAffine(small, move, (small.shape[1], small.shape[0]))
        soft = cv2.GaussianBlur(moved, (0, 0), max(0.5 * light.softness_px, 0.6))
        contact = cv2.GaussianBlur(small, (0, 0), 1.2 * self._unit)
        left = cv2.addWeighted(soft, -0.75 * light.shadow, contact, -0.25 * light.shadow, 255)
        return cv2.resize(left, (width, height), interpolation=cv2.INTER_LINEAR) * np.float32(1 / 255)


def _averaged(images: list[ImageArray]) -> ImageArray:
    """Mean of images, as a shutter that stays open sees them."""
    if len(images) == 1:
        return images[0]
    total = np.zeros(images[0].shape, np.float32)
    for image in images:
        cv2.accumulate(image, total)
    return np.asarray(cv2.convertScaleAbs(total, alpha=1 / len(images)), np.uint8)


def _shifted(image: ImageArray, shift_xy: FloatArray) -> ImageArray:
    """An image as a camera that has moved sees it; what comes in at the border mirrors what lies next to it."""
    if not shift_xy.any():
        return image
    matrix = np.column_stack([np.eye(2), shift_xy])
    size = image.shape[1], image.shape[0]
    moved = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    return np.asarray(moved, np.uint8)


def _samples_a_px(body: Body) -> int:
    """Layer px for a px: a large body is sharp enough with one, since the texture's own edge is smooth."""
    return 2 if 2 * body.half_px * body.length_px < _LARGE_PX else 1


def _blend(image: ImageArray, layer: Layer, shade: Shade | None) -> None:
    """Blend a layer over the image, in place, with its shadow on what lies just behind."""
    rows, columns = layer.rgba.shape[:2]
    part = image[layer.y0 : layer.y0 + rows, layer.x0 : layer.x0 + columns]
    alpha = layer.rgba[..., 3]
    through = 255 - alpha
    if shade is not None:
        near = cv2.GaussianBlur(alpha, (0, 0), 2.5)
        through = cv2.multiply(
            through, 255 - cv2.convertScaleAbs(near, alpha=0.6 * shade.depth), scale=1 / 255
        )
    dimmed = cv2.multiply(part, cv2.cvtColor(through, cv2.COLOR_GRAY2RGB), scale=1 / 255)
    part[:] = cv2.add(dimmed, cv2.cvtColor(layer.rgba, cv2.COLOR_RGBA2RGB))


def inflation_deg(look: Look, frames: int) -> FloatArray:
    """Bend at each frame of a slow inflation: from rest to the largest bend and back, (frames,)."""
    bend: FloatArray = look.bend_deg[1] * 0.5 * (1 - np.cos(np.linspace(0, 2 * np.pi, frames)))
    return bend
