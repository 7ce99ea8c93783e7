"""Bodies and their surfaces sampled at random, by the words of `families`.

How large a body is and where it lies is decided in `look_sampling.py`."""

from __future__ import annotations

from dataclasses import dataclass

from .look import Body, Colour, Surface
from .rng import Rng

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


def drawn_body(word: str, rng: Rng, bend_deg: Range) -> Body:
    """A body of length 1; `look_sampling` scales it to the image."""
    shape = _SHAPES[word]
    aspect = rng.log_uniform(*shape.aspect)
    windings = rng.integer(*shape.windings)
    largest = max(map(abs, bend_deg))
    evenly = rng.bernoulli(0.45)
    return Body(
        seed=rng.seed(),
        length_px=1.0,
        stretch=rng.uniform(0, 1),
        half_px=0.5 / aspect,
        taper=rng.uniform(*shape.taper),
        base_share=rng.uniform(0.08, 0.2),
        tip_share=rng.uniform(0.08, 0.2),
        centre=rng.uniform(0.05, 0.95),
        # The sharper the turn, the less of it fits into one place.
        focus=0.0 if evenly else rng.uniform(0.5, 4.0) * min(1.0, 120 / max(largest, 1)),
        spread=rng.uniform(0.15, 0.35),
        s_turn_deg=rng.normal(0, 60) if rng.bernoulli(0.15) else rng.normal(0, 8),
        valley=shape.valley,
        chambers=rng.integer(*shape.chambers),
        depth=rng.uniform(*shape.depth),
        gap=rng.uniform(*shape.gap),
        two_sided=rng.bernoulli(shape.two_sided),
        swell=rng.uniform(*shape.swell),
        uneven=rng.uniform(0, 0.5),
        rim=rng.uniform(*shape.rim),
        windings=windings,
        slant=rng.uniform(0.1, 0.9) * (1 if rng.bernoulli(0.5) else -1),
        crossed=rng.bernoulli(0.35),
        layer=rng.uniform(0.08, 0.22) if rng.bernoulli(shape.layer) else 0.0,
        tip_round=rng.uniform(*shape.tip_round),
        cap=rng.choice(("none", "none", "none", "cap", "tape")),
        cap_share=rng.uniform(0.06, 0.14),
        tip_over=rng.bernoulli(0.6),
    )


def drawn_surface(word: str, rng: Rng) -> Surface:
    """Colours and gloss."""
    pale: Colour = (0.90, 0.89, 0.86)
    vivid = rng.any_hue(rng.uniform(0.35, 0.95), rng.uniform(0.45, 0.95))
    dark = rng.uniform(0.05, 0.17)
    grey = rng.jittered((0.55, 0.55, 0.55), 0.1)
    prints: tuple[Colour, ...] = (vivid, pale, grey, (0.16, 0.16, 0.17))
    cloths: tuple[Colour, ...] = (vivid, (0.2, 0.2, 0.22), (0.55, 0.55, 0.5), (0.78, 0.75, 0.68))
    clear, cloudy = rng.uniform(0.62, 0.85), rng.uniform(0.72, 0.96)
    tint = rng.any_hue(rng.uniform(0.25, 0.6), rng.uniform(0.7, 0.95))
    # Colour, opacity, cavities, wrap of light, gloss, shininess, pattern.
    colour, opacity, cavity, wrap, gloss, shininess, pattern = {
        "translucent white": (
            rng.jittered((0.86, 0.86, 0.83)),
            cloudy,
            0.30,
            0.60,
            (0.1, 0.7),
            (15, 60),
            "none",
        ),
        "white": (rng.jittered(pale, 0.04), 1.0, 0.0, 0.35, (0.0, 0.35), (8, 40), "none"),
        "pigmented": (vivid, 1.0, 0.0, 0.25, (0.02, 0.5), (8, 50), "none"),
        "dark rubber": (
            rng.jittered((dark, dark, 1.05 * dark)),
            1.0,
            0.0,
            0.10,
            (0.05, 0.45),
            (6, 30),
            "none",
        ),
        "printed": (rng.choice(prints), 1.0, 0.0, 0.15, (0.0, 0.25), (6, 25), "layers"),
        "fabric": (rng.choice(cloths), 1.0, 0.0, 0.30, (0.0, 0.02), (5, 8), "weave"),
        "graded": (vivid, 1.0, 0.0, 0.30, (0.0, 0.4), (8, 40), "grade"),
        "banded": (pale if vivid[0] > vivid[2] else vivid, 1.0, 0.0, 0.25, (0.0, 0.3), (8, 30), "bands"),
        "tinted translucent": (tint, clear, 0.35, 0.55, (0.2, 0.8), (20, 60), "none"),
        "speckled": (rng.jittered((0.45, 0.45, 0.44), 0.15), 1.0, 0.0, 0.25, (0.0, 0.3), (8, 30), "specks"),
    }[word]
    layers: tuple[Colour, ...] = (
        pale,
        (0.25, 0.25, 0.27),
        (0.78, 0.72, 0.58),
        (0.45, 0.40, 0.33),
        rng.any_hue(0.7, 0.7),
    )
    threads: tuple[Colour, ...] = (
        (0.92, 0.91, 0.88),
        (0.12, 0.12, 0.13),
        (0.75, 0.70, 0.50),
        rng.any_hue(0.8, 0.7),
    )
    caps: tuple[Colour, ...] = (
        (0.08, 0.08, 0.09),
        (0.85, 0.84, 0.80),
        (0.80, 0.66, 0.25),
        rng.any_hue(0.8, 0.8),
    )
    return Surface(
        colour=colour,
        layer_colour=rng.jittered(rng.choice(layers)),
        thread_colour=rng.jittered(rng.choice(threads)),
        cap_colour=rng.jittered(rng.choice(caps)),
        opacity=opacity,
        cavity=cavity * rng.uniform(0.2, 1),
        wrap=wrap,
        gloss=rng.uniform(*gloss),
        shininess=rng.log_uniform(*shininess),
        grain=rng.uniform(0.01, 0.06),
        roughness=0.15 if pattern in ("layers", "weave", "specks") else rng.uniform(0.0, 1.0),
        pattern=pattern,
    )
