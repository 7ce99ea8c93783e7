"""Styles that distinguish the designs of a study in every figure: colour, marker and line, never colour alone."""

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
# Brightness of a marker's edge relative to its colour, so that pale colours are visible on white.
_EDGE = 0.62


@dataclass(frozen=True)
class DesignStyle:
    """How one design is drawn.

    Attributes
    ----------
    label : str
        Name of the design in legends.
    colour : str
        Colour of the study file, hex.
    edge : str
        Colour of edges: the same, darker.
    marker : str
        Marker, as matplotlib's.
    line : str or tuple
        Line style, as matplotlib's.
    """

    label: str
    colour: str
    edge: str
    marker: str
    line: Any

    def handle(self, *, marker: bool = True, line: bool = True) -> Line2D:
        """An entry for a legend.

        Parameters
        ----------
        marker, line : bool, optional
            Whether the marker, the line is shown.

        Returns
        -------
        Line2D
            A legend handle.
        """
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


def design_styles(designs: Iterable[tuple[str, str, str]]) -> dict[str, DesignStyle]:
    """The style of each design by name, from (name, label, colour) in the study's order.

    Parameters
    ----------
    designs : iterable of tuple of (str, str, str)
        Name, label and colour of each design.

    Returns
    -------
    dict of str to DesignStyle
        Style of each design, by its name.
    """
    return {
        name: DesignStyle(
            label=label,
            colour=to_hex(colour),
            edge=_darker(colour),
            marker=_MARKERS[index % len(_MARKERS)],
            line=_LINES[index % len(_LINES)],
        )
        for index, (name, label, colour) in enumerate(designs)
    }


def _darker(colour: str) -> str:
    red, green, blue = to_rgb(colour)
    return to_hex((_EDGE * red, _EDGE * green, _EDGE * blue))
