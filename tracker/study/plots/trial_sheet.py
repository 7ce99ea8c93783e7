"""The sheet of one trial: angle and pressure over time, next to the leaf (the paper's figure of one trial)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from ...types import FloatArray
from .leaf import draw_leaf
from .page import AXIS_GREY, PAGE_MM, house_style, new_figure
from .styles import DesignStyle
from .time_series import draw_time_series

if TYPE_CHECKING:
    from ..trial import TrialData


_LEFT, _RIGHT, _RIGHT_WITH_LEAF = 0.074, 0.985, 0.655


def trial_sheet_figure(
    trial: TrialData,
    style: DesignStyle,
    loops: Sequence[FloatArray] = (),
    *,
    largest_pressure_kpa: float = float("nan"),
    largest_angle_deg: float = float("nan"),
    apart: Sequence[FloatArray] = (),
    note: str = "",
    sheet: Figure | None = None,
) -> Figure:
    """One trial's time series, and to its right the leaf where it has complete cycles (see `leaf.leaf_figure`).

    Parameters
    ----------
    trial : TrialData
        The trial.
    style : DesignStyle
        Style of its design.
    loops : sequence of ndarray of float, optional
        (N, 2) kPa and deg of each cycle used.
    largest_pressure_kpa, largest_angle_deg : float, optional
        Sides of the rectangle, NaN for none.
    apart : sequence of ndarray of float, optional
        Excluded cycles, drawn in grey.
    note : str, optional
        Text inside the rectangle.
    sheet : Figure or None, optional
        A figure from `blank_sheet` or from an earlier call, which is wiped and reused; None for a new one.

    Returns
    -------
    Figure
        The figure.
    """
    with_leaf = len(loops) + len(apart) > 0
    figure = blank_sheet(with_leaf) if sheet is None else sheet
    with house_style():
        _wipe(figure)
        angle_axes, pressure_axes, *leaf_axes = figure.axes
        draw_time_series(angle_axes, pressure_axes, trial, style)
        for axes in leaf_axes:
            draw_leaf(
                axes,
                loops,
                style,
                largest_pressure_kpa=largest_pressure_kpa,
                largest_angle_deg=largest_angle_deg,
                apart=apart,
                note=note,
            )
        right = _RIGHT_WITH_LEAF if leaf_axes else _RIGHT
        figure.text(_LEFT, 0.955, trial.name, fontsize=8, va="center")
        figure.text(right, 0.955, style.label, va="center", ha="right", color=AXIS_GREY)
    return figure


def blank_sheet(with_leaf: bool) -> Figure:
    """The axes of a sheet, at fixed positions: no layout is solved, and all sheets are aligned.

    Creating axes and ticks takes a third of the time of a sheet, so a finished sheet is reused.

    Parameters
    ----------
    with_leaf : bool
        Whether there are axes for a leaf.

    Returns
    -------
    Figure
        The figure.
    """
    with house_style():
        figure = new_figure(PAGE_MM, 62, layout=None)
        grid = figure.add_gridspec(
            2,
            1,
            left=_LEFT,
            right=_RIGHT_WITH_LEAF if with_leaf else _RIGHT,
            bottom=0.135,
            top=0.875,
            hspace=0.13,
            height_ratios=(3, 2),
        )
        angle_axes = figure.add_subplot(grid[0])
        figure.add_subplot(grid[1], sharex=angle_axes)
        if with_leaf:
            figure.add_axes((0.735, 0.135, 0.25, 0.74))
        for axes in figure.axes:
            # Fixed label positions too: automatic ones would measure every tick.
            across = blended_transform_factory(figure.transFigure, axes.transAxes)
            upwards = blended_transform_factory(axes.transAxes, figure.transFigure)
            axes.yaxis.set_label_coords(axes.get_position().x0 - 0.054, 0.5, transform=across)
            axes.xaxis.set_label_coords(0.5, 0.055, transform=upwards)
    return figure


def _wipe(figure: Figure) -> None:
    for text in list(figure.texts):
        text.remove()
    for axes in figure.axes:
        for artist in [*axes.lines, *axes.collections, *axes.patches, *axes.texts]:
            artist.remove()
