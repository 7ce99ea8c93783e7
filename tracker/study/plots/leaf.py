"""One trial's hysteresis loop, its leaf: angle against pressure with the rectangle of the hysteresis ratio.

The rectangle is the paper's: the axes, and the lines at the trial's largest pressure and largest angle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...types import FloatArray
from .page import AXIS_GREY, COLUMN_MM, house_style, light_grid, limits_with_zero, new_figure
from .styles import DesignStyle

# Points of a mean loop: finer than visible at a column's width.
_PHASES = 240


def leaf_figure(
    loops: Sequence[FloatArray],
    style: DesignStyle,
    *,
    largest_pressure_kpa: float,
    largest_angle_deg: float,
    apart: Sequence[FloatArray] = (),
    title: str = "",
    note: str = "",
) -> Figure:
    """The cycles of a trial, their mean, the rectangle, and the direction.

    Parameters
    ----------
    loops : sequence of ndarray of float
        (N, 2) of each cycle used, pressure in kPa and angle in degrees, in the order of time.
    style : DesignStyle
        Style of the design.
    largest_pressure_kpa, largest_angle_deg : float
        Sides of the rectangle; not drawn where one is NaN.
    apart : sequence of ndarray of float, optional
        Excluded cycles, drawn in grey.
    title : str, optional
        Title of the figure.
    note : str, optional
        Text inside the rectangle, such as the ratio.

    Returns
    -------
    Figure
        The figure.
    """
    with house_style():
        figure = new_figure(COLUMN_MM, 74)
        axes = figure.add_subplot()
        draw_leaf(
            axes,
            loops,
            style,
            largest_pressure_kpa=largest_pressure_kpa,
            largest_angle_deg=largest_angle_deg,
            apart=apart,
            note=note,
        )
        axes.set_title(title)
    return figure


def draw_leaf(
    axes: Axes,
    loops: Sequence[FloatArray],
    style: DesignStyle,
    *,
    largest_pressure_kpa: float,
    largest_angle_deg: float,
    apart: Sequence[FloatArray] = (),
    note: str = "",
) -> None:
    """Draw a leaf with its rectangle into `axes` (see `leaf_figure`).

    Parameters
    ----------
    axes : Axes
        Axes to draw into.
    loops, apart : sequence of ndarray of float
        (N, 2) kPa and deg of each cycle used, and of excluded ones.
    style : DesignStyle
        Style of the design.
    largest_pressure_kpa, largest_angle_deg : float
        Sides of the rectangle, NaN for none.
    note : str, optional
        Text inside the rectangle.
    """
    _draw_cycles(axes, apart, colour="0.55", label="cycles apart", zorder=1.8)
    _draw_cycles(axes, loops, colour=style.colour, label="cycles", zorder=2)
    if len(loops):
        mean = mean_loop(loops)
        axes.fill(mean[:, 0], mean[:, 1], color=style.colour, alpha=0.10, linewidth=0, zorder=1)
        axes.plot(
            mean[:, 0], mean[:, 1], color=style.edge, linewidth=0.6, zorder=3, label="mean of the cycles"
        )
        for branch in ("loading", "unloading"):
            _draw_arrow(axes, mean, style, branch)
    corner = np.array([[largest_pressure_kpa, largest_angle_deg]])
    if np.isfinite(corner).all():
        axes.add_patch(
            Rectangle(
                (0, 0),
                largest_pressure_kpa,
                largest_angle_deg,
                fill=False,
                edgecolor="0.25",
                linewidth=0.7,
                linestyle=(0, (4, 2.5)),
                zorder=2.5,
                label="rectangle of the ratio",
            )
        )
    points = np.concatenate([*loops, *apart, corner])
    lowest, highest = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    axes.set_xlim(limits_with_zero(float(lowest[0]), float(highest[0])))
    axes.set_ylim(limits_with_zero(float(lowest[1]), float(highest[1])))
    for limit, line in ((axes.get_xlim()[0], axes.axvline), (axes.get_ylim()[0], axes.axhline)):
        if limit < 0:
            line(0, color=AXIS_GREY, linewidth=0.6, zorder=1)
    axes.set_xlabel("pressure (kPa)")
    axes.set_ylabel("bending angle (°)")
    light_grid(axes, "both")
    axes.locator_params(nbins=5)
    if note:
        # The corner of low pressure and large angle is not covered by the leaf.
        axes.text(0.05, 0.90, note, transform=axes.transAxes, va="top", linespacing=1.5)


def _draw_cycles(axes: Axes, loops: Sequence[FloatArray], *, colour: str, label: str, zorder: float) -> None:
    if len(loops):
        lines = LineCollection(loops, colors=colour, linewidths=0.4, alpha=0.55, zorder=zorder, label=label)
        axes.add_collection(lines, autolim=False)


def mean_loop(loops: Sequence[FloatArray]) -> FloatArray:
    """The mean over cycles at equal phase, (240, 2): for display only, not used for numbers.

    Samples are taken as equally spaced in a cycle; where a cycle has a gap, the others count.

    Parameters
    ----------
    loops : sequence of ndarray of float
        (N, 2) kPa and deg of each cycle.

    Returns
    -------
    ndarray of float
        (240, 2) kPa and deg.
    """
    phase = np.linspace(0, 1, _PHASES)
    resampled = np.full((len(loops), _PHASES, 2), np.nan)
    for index, loop in enumerate(loops):
        if len(loop) > 1:
            at = np.linspace(0, 1, len(loop))
            for column in (0, 1):
                resampled[index, :, column] = np.interp(phase, at, loop[:, column])
    known = np.isfinite(resampled).all(axis=2)
    counts = known.sum(axis=0)
    sums = np.where(known[:, :, None], resampled, 0.0).sum(axis=0)
    mean: FloatArray = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], np.nan)
    return mean


def _draw_arrow(axes: Axes, mean: FloatArray, style: DesignStyle, branch: str) -> None:
    """An arrowhead on the mean loop, on one branch, labelled with the branch's name."""
    if not np.isfinite(mean).all():
        return
    top = int(mean[:, 0].argmax())
    rising = branch == "loading"
    rows = np.arange(top + 1) if rising else np.arange(top, len(mean))
    if len(rows) < 8:
        return
    # Low while loading and high while unloading: there the name does not cover the curves.
    level = float(mean[:, 1].min() + (0.3 if rising else 0.6) * np.ptp(mean[:, 1]))
    index = int(rows[np.abs(mean[rows, 1] - level).argmin()])
    before, after = max(index - 6, 0), min(index + 6, len(mean) - 1)
    axes.annotate(
        "",
        xy=tuple(mean[after]),
        xytext=tuple(mean[before]),
        arrowprops={
            "arrowstyle": "-|>,head_length=0.75,head_width=0.34",
            "color": style.edge,
            "linewidth": 0,
            "shrinkA": 0,
            "shrinkB": 0,
        },
        zorder=4,
    )
    axes.annotate(
        branch,
        xy=tuple(mean[index]),
        xytext=(6, -6) if rising else (-6, 4),
        textcoords="offset points",
        ha="left" if rising else "right",
        va="top" if rising else "bottom",
        fontsize=6.5,
        zorder=4,
    )
