"""What a rendered actuator looks like: frozen dataclasses of plain numbers and words.

A `Look` is everything that does not change within a trial, JSON-ready through `dataclasses.asdict`.
How a look is drawn by chance is in `sampling.py`; how it becomes a picture, in the other modules.

Body coordinates: s runs along the strain-limiting line from the clamp's face (s = 0) to the tip, t across
it, outward (toward the chambers) positive; both in px. The bend's inner side has t < 0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Colour = tuple[float, float, float]  # display RGB in [0, 1]

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


@dataclass(frozen=True)
class Pose:
    """Where the actuator is clamped.

    Attributes
    ----------
    base_xy : image position of the strain line at the clamp's face, px
    direction_deg : where the base points, from +x toward +y (clockwise on the screen)
    side : +1 bends clockwise on the screen under pressure, -1 counterclockwise
    """

    base_xy: tuple[float, float]
    direction_deg: float
    side: int


@dataclass(frozen=True)
class Body:
    """Shape of the actuator, all lengths in px.

    Attributes
    ----------
    end_vector_px : distance base_1 - base_2 and tip_1 - tip_2
    marks : what the keypoints sit on: "pins" (moulded dimples), "seams" (where a transverse seam meets the
        strain layer's line) or "steps" (corners of the outline)
    mark_radius_px : of a pin
    margin_px : clamp's face to base_1
    bend_length_px : the part that bends, along the strain line
    height_px, cap_height_px, layer_px : of chambers and end caps above the strain line, of the layer below
    chambers : their number
    gap_depth, gap_width : of the gaps between them, over height and pitch
    centre_factor : length of the middle chambers over that of the end ones
    roundness : corner radius of a chamber over its length
    swell : how far a chamber rises at full pressure, over its height
    unevenness : relative spread of the chambers' swelling
    curvature_peak, curvature_tilt : curvature goes as 1 + peak cos(2 pi u) + tilt cos(pi u), u in [0, 1]
        along the bend
    """

    end_vector_px: float
    marks: str
    mark_radius_px: float
    margin_px: float
    bend_length_px: float
    height_px: float
    cap_height_px: float
    layer_px: float
    chambers: int
    gap_depth: float
    gap_width: float
    centre_factor: float
    roundness: float
    swell: float
    unevenness: float
    curvature_peak: float
    curvature_tilt: float

    @property
    def chamber_margin_px(self) -> float:
        """From base_2 to the first chamber, and from the last chamber to tip_1."""
        return self.mark_radius_px + 4.0 if self.marks == "pins" else 0.0

    @property
    def keypoint_s(self) -> tuple[float, float, float, float]:
        """s of base_1, base_2, tip_1, tip_2."""
        base_2 = self.margin_px + self.end_vector_px
        tip_1 = base_2 + 2 * self.chamber_margin_px + 2.0 + self.bend_length_px
        return self.margin_px, base_2, tip_1, tip_1 + self.end_vector_px

    @property
    def keypoint_t(self) -> float:
        """t of all four keypoints: equal, so that the end vectors are parallel to the ends."""
        return {"pins": 0.55 * self.cap_height_px, "seams": 0.0, "steps": self.cap_height_px}[self.marks]

    @property
    def chambers_s(self) -> tuple[float, float]:
        """Where the row of chambers begins and ends."""
        _, base_2, tip_1, _ = self.keypoint_s
        return base_2 + self.chamber_margin_px, tip_1 - self.chamber_margin_px

    @property
    def bend_s(self) -> tuple[float, float]:
        """Where the bending part begins and ends; outside it the body is straight."""
        start, end = self.chambers_s
        return start + 1.0, end - 1.0

    @property
    def end_s(self) -> float:
        """Where the body ends."""
        return self.keypoint_s[3] + (self.mark_radius_px + 5.0 if self.marks == "pins" else 0.0)


@dataclass(frozen=True)
class Material:
    """Surface: "translucent", "pigmented" or "rubber", its colours, gloss and flaws."""

    kind: str
    colour: Colour
    layer_colour: Colour
    mark_colour: Colour
    opacity: float
    gloss: float
    shininess: float
    roughness: float
    bubbles: int


@dataclass(frozen=True)
class Scene:
    """What is around the body: "paper", "lined", "grid", "bench", "wood" or "clutter"; clamp and tube."""

    background: str
    colour: Colour
    line_colour: Colour
    pitch_px: float
    turn_deg: float
    contrast: float
    clamp_colour: Colour
    clamp_length_px: float
    clamp_overhang_px: tuple[float, float]  # inner side, outer side
    screws: int
    tube_colour: Colour
    tube_radius_px: float
    tube_bend: tuple[float, float]


@dataclass(frozen=True)
class Light:
    """A key light over ambient light. `azimuth_deg`: where it comes from, in the image, from +x toward +y."""

    azimuth_deg: float
    elevation_deg: float
    ambient: float
    tint: Colour
    gradient: float
    vignette: float
    shadow: float
    shadow_softness_px: float
    shadow_length_px: float

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector toward the light: image x, image y, toward the camera."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        level = math.cos(elevation)
        return level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)


@dataclass(frozen=True)
class Camera:
    """Blur (Gaussian sigma, px), noise (standard deviation in grey levels), sharpening, exposure, JPEG.

    `jpeg_quality` 0 leaves the picture as it is. `exposure_s` blurs moving parts. `flicker` and `drift` are
    relative amplitudes of brightness within a trial.
    """

    blur_px: float
    sharpening: float
    noise: float
    colour_noise: float
    jpeg_quality: int
    exposure_s: float
    flicker: float
    drift: float


@dataclass(frozen=True)
class Look:
    """Everything that stays the same within a trial. The same look draws the same picture."""

    seed: int
    size_wh: tuple[int, int]
    pose: Pose
    body: Body
    material: Material
    scene: Scene
    light: Light
    camera: Camera

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Look:
        """The look that `dataclasses.asdict` took apart, also after a journey through JSON."""
        parts = {
            "pose": Pose,
            "body": Body,
            "material": Material,
            "scene": Scene,
            "light": Light,
            "camera": Camera,
        }
        plain = {name: _tuples(value) for name, value in settings.items() if name not in parts}
        return cls(**plain, **{name: part(**_tuples(settings[name])) for name, part in parts.items()})


def _tuples(value: Any) -> Any:
    """JSON knows no tuples; a look has no lists."""
    if isinstance(value, Mapping):
        return {name: _tuples(item) for name, item in value.items()}
    return tuple(value) if isinstance(value, list) else value
