"""Extras sampled at random on top of a look: which kinds an image shows, how large and where."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from ...errors import BendtrackError
from .extras import KINDS, Bystander, Extras
from .families import TRAINING, Families
from .finish import TIE_HEAD_V, Finish, Tape, Tie
from .look import Colour, Look
from .look_alike import second_arm, thick_tube
from .look_sampling import SEEN, background_colour, contrast
from .rng import Rng
from .sheets import Sheet

SHARES = {
    "wrinkled silicone": 0.18,
    "rounded tip": 0.15,
    "frayed tip": 0.06,
    "taped tip": 0.08,
    "zip ties": 0.09,
    "thick tube": 0.13,
    "bare metal": 0.16,
    "ruled paper": 0.10,
    "tape glare": 0.09,
    "cut two-armed body": 0.16,
}
"""How often each kind is tried; a third of the images have none. Tubes and arms do not fit everywhere: about 8 of 10
tubes and 6 of 10 arms do. Nearly half of the images with metal have a bracket, half of the arms leave a hub."""

_TIPS = ("rounded tip", "frayed tip", "taped tip")
# Clamps that a bracket may stand in for: what holds without being metal itself, such as fingers, stays.
_FOR_A_BRACKET = ("block", "vice", "printed holder", "clip")
# Inks of ruled and graph paper.
_INKS: tuple[Colour, ...] = (
    *((0.55, 0.66, 0.82), (0.62, 0.63, 0.66), (0.45, 0.66, 0.52), (0.85, 0.60, 0.42)),
    *((0.40, 0.48, 0.66), (0.78, 0.52, 0.55)),
)
_PAPERS: tuple[Colour, ...] = ((0.95, 0.95, 0.94), (0.93, 0.91, 0.85), (0.96, 0.92, 0.62), (0.82, 0.88, 0.80))


def check_kinds(kinds: Collection[str], families: Families) -> None:
    """Check that extras can be drawn.

    Raises
    ------
    BendtrackError
        A kind is not known, or the families hold a word that pretraining does not see: looks that are held out are
        drawn without extras.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise BendtrackError(f"kinds: expected one of {', '.join(KINDS)}, got {kind!r}")
    for name, words in vars(families).items():
        for word in words if kinds else ():
            if word not in getattr(TRAINING, name):
                raise BendtrackError(f"kinds: expected words of the training families only, got {word!r}")


def drawn_extras(look: Look, bend_deg: float, kinds: Collection[str], rng: Rng) -> tuple[Look, Extras]:
    """Draw extras for a look.

    Parameters
    ----------
    look : Look
        Of the training families.
    bend_deg : float
        That it is shown at.
    kinds : collection of str
        Those of `KINDS` that may be drawn. Leaving one out changes none of the others.
    rng : Rng
        Says which kinds there are. Each kind is drawn from a generator of its own, spawned from this one.

    Returns
    -------
    look : Look
        With the body and surface that the extras ask for; where it lies is as before.
    extras : Extras
    """
    shown = [kind for kind in KINDS if rng.bernoulli(SHARES[kind]) and kind in kinds]
    own = {kind: rng.spawn(KINDS.index(kind)) for kind in shown}
    # A tip is of one kind.
    for kind in [kind for kind in shown if kind in _TIPS][1:]:
        shown.remove(kind)
    extras = Extras(seed=rng.seed())
    if "wrinkled silicone" in shown:
        look, finish = _silicone(look, own["wrinkled silicone"])
        extras = replace(extras, finish=finish)
    if "cut two-armed body" in shown:
        look, extras, fits = _two_armed(look, bend_deg, extras, own["cut two-armed body"])
        if not fits:
            shown.remove("cut two-armed body")
    for kind in shown:
        if kind in _TIPS:
            look, extras = _tip(kind, look, extras, own[kind])
    if "zip ties" in shown:
        extras = replace(extras, finish=replace(extras.finish, ties=_ties(own["zip ties"])))
    if "thick tube" in shown:
        tube = thick_tube(look, bend_deg, own["thick tube"])
        if tube is None:
            shown.remove("thick tube")
        else:
            other, own_deg, fittings = tube
            finish = replace(extras.finish, ties=(), fray=0.0, tape=None)
            laid = Bystander(other, own_deg, finish)
            extras = replace(extras, bystanders=(*extras.bystanders, laid), fittings=fittings)
    if "bare metal" in shown:
        extras = _metal(look, extras, own["bare metal"])
    if "ruled paper" in shown:
        extras = replace(extras, sheet=_sheet(look, own["ruled paper"]))
    if "tape glare" in shown:
        extras = replace(extras, tapes=own["tape glare"].integer(1, 2))
    return look, replace(extras, kinds=tuple(shown))


def _silicone(look: Look, rng: Rng) -> tuple[Look, Finish]:
    """The same body of white silicone, cloudy to clear, without any tint; what it is before and held by stays clear."""
    surface, coloured = look.surface, look.sensor.kind == "colour"
    level = rng.uniform(0.72, 0.94)
    warm = rng.normal(0, 0.012)
    surface = replace(
        surface,
        colour=(level + warm, level, level - 0.02 - warm),
        # As cloudy and as glossy as translucent white is without extras: clearer bodies are held out.
        opacity=rng.uniform(0.72, 0.96),
        cavity=rng.uniform(0.03, 0.30),
        wrap=rng.uniform(0.5, 0.7),
        gloss=rng.uniform(0.1, 0.7),
        shininess=rng.log_uniform(15, 60),
        grain=rng.uniform(0.01, 0.03),
        roughness=rng.uniform(0.0, 0.6),
        pattern="none",
    )
    scene = look.scene
    if contrast(scene.colour, surface.colour, coloured) < SEEN:
        colours = [background_colour(look.words.background, rng) for _ in range(6)]
        best = max(colours, key=lambda colour: contrast(colour, surface.colour, coloured))
        scene = replace(scene, colour=best)
    if contrast(scene.clamp_colour, surface.colour, coloured) < SEEN:
        scene = replace(scene, clamp_colour=rng.jittered((0.35, 0.36, 0.38)))
    words = replace(look.words, material="translucent white")
    finish = Finish(
        crease_px=rng.uniform(0.02, 0.09) * look.body.half_px if rng.bernoulli(0.75) else 0.0,
        streak=rng.uniform(0.4, 1.0) if rng.bernoulli(0.8) else 0.0,
    )
    return replace(look, words=words, surface=surface, scene=scene), finish


def _tip(kind: str, look: Look, extras: Extras, rng: Rng) -> tuple[Look, Extras]:
    """The same body with another tip; its end lies where it was."""
    body, finish = replace(look.body, cap="none"), extras.finish
    if kind == "rounded tip":
        # From a half circle to a finger's end, which is longer.
        body = replace(body, tip_round=rng.uniform(0.9, 1.8))
    elif kind == "frayed tip":
        body = replace(body, tip_round=rng.uniform(0.0, 0.3))
        finish = replace(finish, fray=rng.uniform(0.05, 0.14))
    else:
        body = replace(body, tip_round=rng.uniform(0.05, 0.4))
        colours: tuple[Colour, ...] = (
            *((0.93, 0.94, 0.95), (0.90, 0.89, 0.86), (0.20, 0.42, 0.75), (0.10, 0.10, 0.11)),
            *((0.86, 0.78, 0.55), (0.72, 0.73, 0.75), (0.80, 0.22, 0.18)),
        )
        colour = rng.choice(colours)
        coloured = look.sensor.kind == "colour"
        opacity = rng.uniform(0.85, 1.0)
        if contrast(colour, look.scene.colour, coloured) < SEEN:
            # Clear tape: what looks like the background would seem to shorten the body.
            colour, opacity = (0.93, 0.94, 0.95), 0.25
        tape = Tape(
            share=rng.uniform(0.06, 0.18),
            colour=colour,
            opacity=opacity,
            glare=rng.uniform(0.3, 1.0) if rng.bernoulli(0.75) else 0.0,
            outline=rng.uniform(1.02, 1.12),
            flag=rng.uniform(0.1, 0.35) if rng.bernoulli(0.35) else 0.0,
        )
        finish = replace(finish, tape=tape)
    return replace(look, body=body), replace(extras, finish=finish)


def _ties(rng: Rng) -> tuple[Tie, ...]:
    """One to three ties, mostly near an end, where they hold a tube or a sleeve."""
    colours: tuple[Colour, ...] = (
        (0.07, 0.07, 0.08),
        (0.90, 0.90, 0.87),
        (0.07, 0.07, 0.08),
        rng.any_hue(0.8, 0.7),
    )
    colour, width = rng.choice(colours), rng.uniform(0.22, 0.5)
    places: list[float] = []
    for _ in range(rng.integer(1, 3)):
        near = rng.uniform(0, 1)
        at = (
            rng.uniform(0.04, 0.22)
            if near < 0.5
            else rng.uniform(0.22, 0.8)
            if near < 0.8
            else rng.uniform(0.8, 0.93)
        )
        if all(abs(at - other) > 0.06 for other in places):
            places.append(at)
    return tuple(
        Tie(
            at=at,
            width=width,
            colour=colour,
            head_v=TIE_HEAD_V if rng.bernoulli(0.5) else rng.uniform(-0.6, 0.6),
            tail=rng.uniform(0.3, 1.6) if rng.bernoulli(0.3) else 0.0,
        )
        for at in places
    )


def _metal(look: Look, extras: Extras, rng: Rng) -> Extras:
    """Metal behind the body, or a bracket that holds it, or both."""
    holds = look.words.clamp in _FOR_A_BRACKET and extras.base == "clamp" and look.place.second_arm is None
    holds = rng.bernoulli(0.6) and holds
    pieces = rng.integer(0, 1) if holds else rng.integer(1, 2)
    return replace(extras, base="bracket" if holds else extras.base, metals=pieces)


def _sheet(look: Look, rng: Rng) -> Sheet:
    """Paper that fills much of the image, of a colour that the body stands out from."""
    unit, coloured = max(look.size_wh) / 256, look.sensor.kind == "colour"
    papers = [rng.jittered(rng.choice(_PAPERS), 0.06) for _ in range(4)]
    colour = max(papers, key=lambda paper: min(contrast(paper, look.surface.colour, coloured), 0.3))
    ruling = rng.choice(("lines", "lines", "squares", "graph"))
    ranges = {"lines": (7, 18), "squares": (4, 13), "graph": (2.2, 5)}
    width, height = look.size_wh
    return Sheet(
        xy=(width * rng.uniform(0.25, 0.75), height * rng.uniform(0.25, 0.75)),
        heading_deg=rng.normal(0, 12) if rng.bernoulli(0.6) else rng.uniform(0, 180),
        size_px=(rng.uniform(0.7, 1.5) * 256 * unit, rng.uniform(0.7, 1.5) * 256 * unit),
        colour=colour,
        ink=rng.jittered(rng.choice(_INKS)),
        pitch_px=rng.log_uniform(*ranges[ruling]) * unit,
        ruling=ruling,
    )


def _two_armed(look: Look, bend_deg: float, extras: Extras, rng: Rng) -> tuple[Look, Extras, bool]:
    """The same body with a second arm that the image's edge cuts; whether one fits."""
    alone = replace(look, place=replace(look.place, second_arm=None))
    arm = second_arm(alone, bend_deg, rng)
    if arm is None:
        return look, extras, False
    other, own_deg = arm
    hub = rng.bernoulli(0.5)
    bystander = Bystander(other, own_deg, extras.finish)
    scene = replace(alone.scene, tube_px=0.0) if hub else alone.scene
    extras = replace(extras, base="hub" if hub else "clamp", bystanders=(bystander,))
    return replace(alone, scene=scene), extras, True
