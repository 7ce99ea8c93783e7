"""What one drawn actuator and its surroundings look like: frozen dataclasses of plain numbers and words.

Body coordinates: s runs along the midline from where the body leaves the clamp, in px; v across it in half
thicknesses, outward (away from the side to which the body bends under pressure) positive, so that the body
at rest reaches from v = -1 to v = 1. The *plane* is where the body lies: px of the image as it would be
without tilt and lens. Looks are sampled at random in `look_sampling.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from .families import Families, Words

Colour = tuple[float, float, float]  # display RGB in [0, 1]


@dataclass(frozen=True)
class Body:
    """Shape of the body.

    Attributes
    ----------
    seed : int
        Of unevenness, grain and flaws.
    length_px : float
        Along the midline at rest, and how far it grows when bent: `stretch` x turn x half thickness.
    half_px, taper : float
        Half thickness at the base, and the share of it that is lost toward the tip.
    base_share, tip_share : float
        Of the straight ends in the length.
    centre, focus, spread : float
        Curvature goes as 1 + focus exp(-((u - centre) / spread)^2) along the bend, u in [0, 1].
    s_turn_deg : float
        Turned one way in the first half and back in the second.
    valley : str
        What lies between chambers: "gap", "wave", "saw", "joint" or "none".
    chambers, depth, gap : int or float
        Their number; depth of a valley in v / 2, its width over the pitch.
    two_sided : bool
        Valleys on the inner side too.
    swell, uneven : float
        How far a chamber rises at full pressure in v, and the spread of that.
    rim : float
        Radius of the rounded edge over the half thickness; 1 is a round tube.
    windings, slant, crossed : int or float or bool
        Fibres wound about it, their number, slant and whether they cross.
    layer : float
        Height of the strain layer in v / 2, 0 for none to be seen.
    tip_round : float
        Of the tip's corners over the half thickness.
    cap, cap_share : str or float
        "none", "cap" or "tape" about the tip, and its length over the body's.
    tip_over : bool
        Where the body overlaps itself the tip's half lies in front.
    """

    seed: int
    length_px: float
    stretch: float
    half_px: float
    taper: float
    base_share: float
    tip_share: float
    centre: float
    focus: float
    spread: float
    s_turn_deg: float
    valley: str
    chambers: int
    depth: float
    gap: float
    two_sided: bool
    swell: float
    uneven: float
    rim: float
    windings: int
    slant: float
    crossed: bool
    layer: float
    tip_round: float
    cap: str
    cap_share: float
    tip_over: bool


@dataclass(frozen=True)
class Surface:
    """What the body is made of.

    Attributes
    ----------
    colour, layer_colour, thread_colour, cap_colour : Colour
        Of the body, its strain layer, windings and cap.
    opacity : float
        1 hides what is behind.
    cavity : float
        How much darker the chambers' cavities shine through.
    wrap : float
        How far light reaches around an edge: 0.1 rubber, 0.6 translucent silicone.
    gloss, shininess : float
        Height and exponent of the highlight.
    grain, roughness : float
        Of colour (relative) and of the relief (px).
    pattern : str
        "none", "weave", "layers", "specks", "grade" or "bands"; the last three in the threads' colour.
    """

    colour: Colour
    layer_colour: Colour
    thread_colour: Colour
    cap_colour: Colour
    opacity: float
    cavity: float
    wrap: float
    gloss: float
    shininess: float
    grain: float
    roughness: float
    pattern: str


@dataclass(frozen=True)
class Place:
    """Where the body leaves the clamp and points, in the plane; `side` +1 bends clockwise on the screen.

    `second_arm` : None, or how far (px, along and across the base) and how much turned (deg) a mirrored arm begins
    """

    base_xy: tuple[float, float]
    direction_deg: float
    side: int
    second_arm: tuple[float, float, float] | None


@dataclass(frozen=True)
class View:
    """From the plane to the image: tilt about the image's axes, nearness (0: from afar), lens."""

    tilt_x_deg: float
    tilt_y_deg: float
    nearness: float
    lens: float


@dataclass(frozen=True)
class Scene:
    """What is around the body; `seed` draws the details.

    Attributes
    ----------
    colour, ink, pitch_px, turn_deg, texture : Colour or float
        Of the background, where it has such.
    distractors, occluders : int
        How many objects lie about, and how many in front of the body.
    clamp_colour, clamp_seed : Colour or int
        Of the clamp.
    tube_colour, tube_px : Colour or float
        Of the supply tube; 0 px for none.
    """

    seed: int
    colour: Colour
    ink: Colour
    pitch_px: float
    turn_deg: float
    texture: float
    distractors: int
    occluders: int
    clamp_colour: Colour
    clamp_seed: int
    tube_colour: Colour
    tube_px: float


@dataclass(frozen=True)
class Light:
    """A key light over ambient light. `azimuth_deg`: where it comes from, from +x toward +y.

    `gradient` : relative fall of the light across the image; `vignette` : toward its corners.
    `shadow`, `shadow_px`, `softness_px` : depth, offset and blur of the body's shadow.
    `gain`, `gamma` : exposure; 1 is right. `drift` : by how much of it the exposure wanders up and down during a film.
    """

    azimuth_deg: float
    elevation_deg: float
    ambient: float
    tint: Colour
    gradient: float
    vignette: float
    shadow: float
    shadow_px: float
    softness_px: float
    gain: float
    gamma: float
    drift: float


@dataclass(frozen=True)
class Sensor:
    """What the camera does to the image.

    `kind` : "colour", "grey" or "infrared". Blur in px (Gaussian sigma; length and direction of a movement),
    noise in grey levels, `jpeg_quality` and `h264_crf` 0 for none, of which at most one codes, `shrink` the factor of a
    low-resolution stream.
    """

    kind: str
    blur_px: float
    motion_px: float
    motion_deg: float
    sharpening: float
    noise: float
    noise_cell: float
    jpeg_quality: int
    subsampled: bool
    h264_crf: int
    shrink: float


@dataclass(frozen=True)
class Look:
    """Everything that stays the same within a video. The same look draws the same image.

    Attributes
    ----------
    size_wh : tuple of int
        Of the image, px.
    families : Families
        That it was drawn from.
    words : Words
        What it shows.
    bend_deg : tuple of float
        The range that it can be drawn at, toward the side to which it bends under pressure.
    """

    size_wh: tuple[int, int]
    families: Families
    words: Words
    bend_deg: tuple[float, float]
    body: Body
    surface: Surface
    place: Place
    view: View
    scene: Scene
    light: Light
    sensor: Sensor

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Look:
        """Rebuild the look that `dataclasses.asdict` took apart, also from JSON.

        Raises
        ------
        KeyError, TypeError
            The settings are not those of a look.
        """
        fields = {
            name: _PARTS[name](**_tuples(value)) if name in _PARTS else _tuples(value)
            for name, value in settings.items()
        }
        return cls(**fields)


_PARTS: dict[str, Any] = {
    "families": Families,
    "words": Words,
    "body": Body,
    "surface": Surface,
    "place": Place,
    "view": View,
    "scene": Scene,
    "light": Light,
    "sensor": Sensor,
}


def _tuples(value: Any) -> Any:
    """JSON knows no tuples; a look has no lists."""
    if isinstance(value, Mapping):
        return {name: _tuples(item) for name, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
