"""The page of one trial: angle and pressure over time beside the leaf (the paper's figure of one trial)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from ...types import FloatArray
from .leaf import draw_leaf
from .looks import Look
from .page import PAGE_MM, QUIET, house_style, new_figure
from .time_series import draw_time_series

if TYPE_CHECKING:
    from ..trial import TrialData


def trial_sheet(
    trial: TrialData,
    look: Look,
    loops: Sequence[FloatArray] = (),
    *,
    largest_pressure_kpa: float = float("nan"),
    largest_angle_deg: float = float("nan"),
    apart: Sequence[FloatArray] = (),
    note: str = "",
) -> Figure:
    """One trial's time series, and to its right the leaf where it has complete cycles (see `leaf.leaf_figure`).

    Axes stand at fixed places (no layout is solved), so that a study's hundred sheets are drawn quickly and
    can be laid over each other.
    """
    with house_style():
        figure = new_figure(PAGE_MM, 62, layout=None)
        with_leaf = len(loops) + len(apart) > 0
        right = 0.655 if with_leaf else 0.985
        grid = figure.add_gridspec(
            2, 1, left=0.074, right=right, bottom=0.135, top=0.875, hspace=0.13, height_ratios=(3, 2)
        )
        angle_axes = figure.add_subplot(grid[0])
        pressure_axes = figure.add_subplot(grid[1], sharex=angle_axes)
        draw_time_series(angle_axes, pressure_axes, trial, look)
        for axes in (angle_axes, pressure_axes):
            place = blended_transform_factory(figure.transFigure, axes.transAxes)
            axes.yaxis.set_label_coords(0.02, 0.5, transform=place)
        if with_leaf:
            leaf_axes = figure.add_axes((0.735, 0.135, 0.25, 0.74))
            draw_leaf(
                leaf_axes,
                loops,
                look,
                largest_pressure_kpa=largest_pressure_kpa,
                largest_angle_deg=largest_angle_deg,
                apart=apart,
                note=note,
            )
        figure.text(0.074, 0.955, trial.name, fontsize=8, va="center")
        figure.text(right, 0.955, look.label, va="center", ha="right", color=QUIET)
    return figure
