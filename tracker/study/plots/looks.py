"""What tells the designs of a study apart in every figure: colour, marker and line style, never colour alone."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from matplotlib.colors import to_hex, to_rgb
from matplotlib.lines import Line2D

_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p", "h", "*")
_LINES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.2)),
    (0, (1.2, 1.1)),
    (0, (5, 1.2, 1.2, 1.2)),
    (0, (8, 1.5)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (2.5, 1)),
    (0, (8, 1.2, 2, 1.2)),
)
# How dark the edge of a mark is beside its colour, so that pale colours stand out from white too.
_EDGE = 0.62


@dataclass(frozen=True)
class Look:
    """How one design is drawn.

    Attributes
    ----------
    label : str
        Its name in legends.
    colour : str
        As the study file gives it, hex.
    edge : str
        The same, darker.
    marker : str
        Matplotlib's marker.
    line : str or tuple
        Matplotlib's line style.
    """

    label: str
    colour: str
    edge: str
    marker: str
    line: Any

    def handle(self, *, marker: bool = True, line: bool = True) -> Line2D:
        """An entry for a legend."""
        return Line2D(
            [],
            [],
            color=self.colour,
            linestyle=self.line if line else "none",
            marker=self.marker if marker else "",
            markersize=4,
            markeredgecolor=self.edge,
            markeredgewidth=0.6,
            label=self.label,
        )


def looks_of(designs: Iterable[tuple[str, str, str]]) -> dict[str, Look]:
    """The look of each design, given (name, label, colour) in the study's order, by name."""
    return {
        name: Look(
            label=label,
            colour=to_hex(colour),
            edge=_darker(colour),
            marker=_MARKERS[place % len(_MARKERS)],
            line=_LINES[place % len(_LINES)],
        )
        for place, (name, label, colour) in enumerate(designs)
    }


def _darker(colour: str) -> str:
    red, green, blue = to_rgb(colour)
    return to_hex((_EDGE * red, _EDGE * green, _EDGE * blue))
