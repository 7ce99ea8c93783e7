"""The stream itself: sample number `index` of stream number `seed`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from .camera_sampling import as_of_a_film
from .extras import NO_EXTRAS
from .extras_sampling import check_kinds, drawn_extras
from .families import TRAINING, Families
from .look_sampling import drawn_look
from .renderer import Renderer, Sample
from .rng import Rng

# Bends are drawn evenly from here to there, but as often as this near the straight rest.
BEND_DEG = (-60.0, 270.0)
_NEAR_REST = 0.15
# One body in so many reaches out of the image.
_PARTLY_OUT = 0.15
# And one image in so many is of a film in H.264: looks know nothing of it, for their films are coded when written.
_OF_A_FILM = 0.12


def draw(
    seed: int,
    index: int,
    *,
    size_wh: tuple[int, int] = (256, 256),
    families: Families = TRAINING,
    kinds: Collection[str] = (),
) -> Sample:
    """A random look at a random bend.

    The same arguments give the same sample, whatever was drawn before; samples of one stream have nothing to
    do with each other.

    Parameters
    ----------
    seed : int
        Of the stream.
    index : int
        Number of the sample in it.
    size_wh : tuple of int
        Of the image, px.
    families : Families
        The words that it may be drawn from: `TRAINING` or `HELD_OUT`.
    kinds : collection of str, optional
        Kinds of extras that may be drawn on top, of `KINDS`. Without any the sample is what it always was.

    Raises
    ------
    BendtrackError
        A kind that is not known, or kinds with words that are held out.

    Examples
    --------
    >>> sample = draw(seed=1, index=0)
    >>> sample.image.shape, sample.keypoints_xy.shape
    ((256, 256, 3), (9, 2))
    """
    check_kinds(kinds, families)
    rng = Rng(seed, index, 6)
    bend = rng.normal(0, 12) if rng.bernoulli(_NEAR_REST) else rng.uniform(*BEND_DEG)
    if rng.bernoulli(0.5):
        bend = min(bend, rng.uniform(0, BEND_DEG[1]))
    pressure = min(max(bend / rng.uniform(90, 250), 0.0), 1.0) * rng.uniform(0.5, 1.0)
    look = drawn_look(
        seed, index, size_wh=size_wh, families=families, bend_deg=(bend, bend), partly_out=_PARTLY_OUT
    )
    film = rng.spawn(1)
    if film.bernoulli(_OF_A_FILM):
        look = replace(look, sensor=as_of_a_film(look.sensor, film))
    extras = NO_EXTRAS
    if kinds:
        look, extras = drawn_extras(look, bend, kinds, Rng(seed, index, 16))
    return Renderer(look, extras=extras).frame(bend, pressure)
