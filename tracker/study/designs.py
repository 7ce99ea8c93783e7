"""Designs of a study: their labels in figures and tables, and one colour for each in all of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

# The study's own (its figures' legends); yellow darkened so that a line of it can be seen on white.
STUDY_COLOURS = {
    "original": "#d62728",
    "mid-side walls thicker": "#f06eaa",
    "mid-top wall thicker": "#e0b000",
    "mid-length smaller": "#2ca02c",
    "mid-length larger": "#1f77b4",
    "mid-width smaller": "#7b3fb5",
    "mid-width larger": "#222222",
    "mid-height smaller": "#8c564b",
    "mid-height larger": "#ff7f0e",
}
# For designs of other studies: Okabe and Ito's palette, then Tol's muted one, distinguishable with any colour vision.
OTHER_COLOURS = (
    *("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#332288", "#117733"),
    *("#882255", "#88ccee", "#999933", "#aa4499", "#44aa99", "#661100", "#6699cc", "#777777"),
)


@dataclass(frozen=True)
class DesignSettings:
    """How a design is shown: its label, and its colour as "#rrggbb".

    Attributes
    ----------
    label : str
        Name in figures and tables.
    colour : str
        Hexadecimal RGB, "#rrggbb".
    """

    label: str
    colour: str


def plain_name(name: str) -> str:
    """A design's name in lower case, with every other character as a space.

    Parameters
    ----------
    name : str
        Name as written.

    Returns
    -------
    str
        Words separated by single spaces.

    Examples
    --------
    >>> plain_name("Mid_Width-smaller")
    'mid width smaller'
    """
    return " ".join("".join(char if char.isalnum() else " " for char in name.lower()).split())


def known_design(name: str) -> str | None:
    """The paper's design with this name, None if there is none.

    Parameters
    ----------
    name : str
        Name as written.

    Returns
    -------
    str or None
        A key of `STUDY_COLOURS`.
    """
    return next((known for known in STUDY_COLOURS if plain_name(known) == plain_name(name)), None)


def design_colours(names: Iterable[str], chosen: dict[str, str]) -> dict[str, str]:
    """A colour for each design: the chosen one, the study's own, or the next of `OTHER_COLOURS` in this order.

    Parameters
    ----------
    names : iterable of str
        Designs in the study's order.
    chosen : dict of str to str
        Colours that the user chose, by design.

    Returns
    -------
    dict of str to str
        Colour of each design.

    Examples
    --------
    >>> design_colours(["original", "ours", "theirs"], {"ours": "#000000"})
    {'original': '#d62728', 'ours': '#000000', 'theirs': '#0072b2'}
    """
    colours: dict[str, str] = {}
    n_others = 0
    for name in names:
        known = known_design(name)
        if name in chosen:
            colours[name] = chosen[name]
        elif known is not None:
            colours[name] = STUDY_COLOURS[known]
        else:
            colours[name] = OTHER_COLOURS[n_others % len(OTHER_COLOURS)]
            n_others += 1
    return colours
