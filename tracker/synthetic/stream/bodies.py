"""How bodies and their surfaces are drawn by chance, by the words of `families`."""

from __future__ import annotations

from dataclasses import dataclass

from .dice import Dice
from .look import Body, Colour, Surface

Range = tuple[float, float]


@dataclass(frozen=True)
class _Shape:
    """Ranges that a shape is drawn from; the fields are those of `Body`. `aspect`: length over thickness."""

    aspect: Range
    valley: str = "none"
    chambers: tuple[int, int] = (3, 8)
    depth: Range = (0.0, 0.0)
    gap: Range = (0.1, 0.3)
    two_sided: float = 0.0
    swell: Range = (0.0, 0.25)
    rim: Range = (0.15, 0.4)
    windings: tuple[int, int] = (0, 0)
    taper: Range = (0.0, 0.1)
    layer: float = 0.5
    tip_round: Range = (0.05, 0.5)


_SHAPES = {
    "separated chambers": _Shape(
        (3.5, 9), "gap", (4, 11), (0.25, 0.72), (0.15, 0.4), swell=(0.0, 0.4), layer=0.65
    ),
    "fast chambers": _Shape(
        (3.5, 9),
        "gap",
        (8, 17),
        (0.5, 0.82),
        (0.12, 0.35),
        swell=(0.0, 0.3),
        layer=0.7,
        tip_round=(0.02, 0.3),
    ),
    "smooth chambers": _Shape((3.5, 10), "none", (4, 14), swell=(0.0, 0.3), taper=(0.0, 0.2), layer=0.5),
    "bellows": _Shape(
        (3, 9), "wave", (5, 14), (0.12, 0.35), two_sided=0.6, rim=(0.4, 1.0), swell=(0.0, 0.3), layer=0.15
    ),
    "fibre tube": _Shape(
        (5, 12), "none", rim=(0.9, 1.0), windings=(14, 50), swell=(0.0, 0.1), layer=0.1, tip_round=(0.1, 1.0)
    ),
    "PneuFlex": _Shape(
        (4.5, 10), "none", rim=(0.5, 1.0), windings=(12, 36), taper=(0.2, 0.55), swell=(0.0, 0.2), layer=0.7
    ),
    "flat strip": _Shape(
        (7, 12), "none", rim=(0.1, 0.3), swell=(0.0, 0.15), layer=0.35, tip_round=(0.0, 1.0)
    ),
    "ribbed tentacle": _Shape(
        (4.5, 11),
        "wave",
        (9, 22),
        (0.05, 0.16),
        two_sided=1.0,
        rim=(0.6, 1.0),
        taper=(0.3, 0.65),
        layer=0.1,
        tip_round=(0.5, 1.0),
    ),
    "sawtooth": _Shape((3.5, 9), "saw", (5, 11), (0.25, 0.5), swell=(0.0, 0.3), layer=0.6),
    "knuckled": _Shape(
        (3.5, 8),
        "joint",
        (3, 4),
        (0.15, 0.35),
        two_sided=0.5,
        rim=(0.4, 1.0),
        swell=(0.0, 0.25),
        layer=0.3,
        tip_round=(0.4, 1.0),
    ),
}


def drawn_body(word: str, dice: Dice, bend_deg: Range) -> Body:
    """A body of length 1; `chance` makes it as large as the picture wants it."""
    shape = _SHAPES[word]
    aspect = dice.steeply(*shape.aspect)
    windings = dice.whole(*shape.windings)
    largest = max(map(abs, bend_deg))
    evenly = dice.maybe(0.45)
    return Body(
        seed=dice.seed(),
        length_px=1.0,
        stretch=dice.between(0, 1),
        half_px=0.5 / aspect,
        taper=dice.between(*shape.taper),
        base_share=dice.between(0.08, 0.2),
        tip_share=dice.between(0.08, 0.2),
        centre=dice.between(0.05, 0.95),
        # The sharper the turn, the less of it fits into one place.
        focus=0.0 if evenly else dice.between(0.5, 4.0) * min(1.0, 120 / max(largest, 1)),
        spread=dice.between(0.15, 0.35),
        s_turn_deg=dice.about(0, 60) if dice.maybe(0.15) else dice.about(0, 8),
        valley=shape.valley,
        chambers=dice.whole(*shape.chambers),
        depth=dice.between(*shape.depth),
        gap=dice.between(*shape.gap),
        two_sided=dice.maybe(shape.two_sided),
        swell=dice.between(*shape.swell),
        uneven=dice.between(0, 0.5),
        rim=dice.between(*shape.rim),
        windings=windings,
        slant=dice.between(0.1, 0.9) * (1 if dice.maybe(0.5) else -1),
        crossed=dice.maybe(0.35),
        layer=dice.between(0.08, 0.22) if dice.maybe(shape.layer) else 0.0,
        tip_round=dice.between(*shape.tip_round),
        cap=dice.one_of(("none", "none", "none", "cap", "tape")),
        cap_share=dice.between(0.06, 0.14),
        tip_over=dice.maybe(0.6),
    )


def drawn_surface(word: str, dice: Dice) -> Surface:
    """Colours and gloss."""
    pale: Colour = (0.90, 0.89, 0.86)
    vivid = dice.hue(dice.between(0.35, 0.95), dice.between(0.45, 0.95))
    dark = dice.between(0.05, 0.17)
    grey = dice.near((0.55, 0.55, 0.55), 0.1)
    prints: tuple[Colour, ...] = (vivid, pale, grey, (0.16, 0.16, 0.17))
    cloths: tuple[Colour, ...] = (vivid, (0.2, 0.2, 0.22), (0.55, 0.55, 0.5), (0.78, 0.75, 0.68))
    clear, cloudy = dice.between(0.62, 0.85), dice.between(0.72, 0.96)
    tint = dice.hue(dice.between(0.25, 0.6), dice.between(0.7, 0.95))
    # Colour, opacity, cavities, wrap of light, gloss, shininess, pattern.
    colour, opacity, cavity, wrap, gloss, shininess, pattern = {
        "translucent white": (
            dice.near((0.86, 0.86, 0.83)),
            cloudy,
            0.30,
            0.60,
            (0.1, 0.7),
            (15, 60),
            "none",
        ),
        "white": (dice.near(pale, 0.04), 1.0, 0.0, 0.35, (0.0, 0.35), (8, 40), "none"),
        "pigmented": (vivid, 1.0, 0.0, 0.25, (0.02, 0.5), (8, 50), "none"),
        "dark rubber": (dice.near((dark, dark, 1.05 * dark)), 1.0, 0.0, 0.10, (0.05, 0.45), (6, 30), "none"),
        "printed": (dice.one_of(prints), 1.0, 0.0, 0.15, (0.0, 0.25), (6, 25), "layers"),
        "fabric": (dice.one_of(cloths), 1.0, 0.0, 0.30, (0.0, 0.02), (5, 8), "weave"),
        "graded": (vivid, 1.0, 0.0, 0.30, (0.0, 0.4), (8, 40), "grade"),
        "banded": (pale if vivid[0] > vivid[2] else vivid, 1.0, 0.0, 0.25, (0.0, 0.3), (8, 30), "bands"),
        "tinted translucent": (tint, clear, 0.35, 0.55, (0.2, 0.8), (20, 60), "none"),
        "speckled": (dice.near((0.45, 0.45, 0.44), 0.15), 1.0, 0.0, 0.25, (0.0, 0.3), (8, 30), "specks"),
    }[word]
    layers: tuple[Colour, ...] = (
        pale,
        (0.25, 0.25, 0.27),
        (0.78, 0.72, 0.58),
        (0.45, 0.40, 0.33),
        dice.hue(0.7, 0.7),
    )
    threads: tuple[Colour, ...] = (
        (0.92, 0.91, 0.88),
        (0.12, 0.12, 0.13),
        (0.75, 0.70, 0.50),
        dice.hue(0.8, 0.7),
    )
    caps: tuple[Colour, ...] = (
        (0.08, 0.08, 0.09),
        (0.85, 0.84, 0.80),
        (0.80, 0.66, 0.25),
        dice.hue(0.8, 0.8),
    )
    return Surface(
        colour=colour,
        layer_colour=dice.near(dice.one_of(layers)),
        thread_colour=dice.near(dice.one_of(threads)),
        cap_colour=dice.near(dice.one_of(caps)),
        opacity=opacity,
        cavity=cavity * dice.between(0.2, 1),
        wrap=wrap,
        gloss=dice.between(*gloss),
        shininess=dice.steeply(*shininess),
        grain=dice.between(0.01, 0.06),
        roughness=0.15 if pattern in ("layers", "weave", "specks") else dice.between(0.0, 1.0),
        pattern=pattern,
    )
