"""Hysteresis ratio against largest angle, and the vertical line at which two designs are compared."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...types import FloatArray
from ..number_text import MINUS
from .page import AXIS_GREY, PAGE_MM, TEXT_GREY, house_style, light_grid, new_figure
from .styles import DesignStyle

_ROOM = 1.06  # the axis of angles over the largest angle


def ratio_angle_figure(
    dynamic: pd.DataFrame, comparisons: pd.DataFrame, styles: Mapping[str, DesignStyle]
) -> Figure:
    """A panel for each frequency: the trials of a design joined in the order of their largest angle.

    Parameters
    ----------
    dynamic : DataFrame
        One row per trial, with design, frequency_hz, dynamic_response_deg, hysteresis_ratio, _low and _high.
    comparisons : DataFrame
        At most one row per frequency, with frequency_hz, angle_deg, baseline, design, baseline_ratio,
        design_ratio, improvement (a fraction).
    styles : mapping of str to DesignStyle
        Style of each design, by its name.

    Returns
    -------
    Figure
        The figure.
    """
    frequencies = sorted(dynamic["frequency_hz"].dropna().unique())
    with house_style():
        figure = new_figure(PAGE_MM, 76)
        grid = figure.subplots(1, max(len(frequencies), 1), sharey=True, squeeze=False)[0]
        for axes, frequency in zip(grid, frequencies, strict=False):
            here = dynamic[dynamic["frequency_hz"] == frequency].sort_values("dynamic_response_deg")
            for name, style in styles.items():
                _draw_design(axes, here[here["design"] == name], style)
            axes.set_title(f"{frequency:g} Hz", loc="center")
            axes.set_xlabel("largest bending angle (°)")
            light_grid(axes, "both")
            # Room on the right for a marker, also where a design has a single trial and all angles lie close together.
            right = np.nanmax(here[["dynamic_response_deg", "dynamic_response_deg_high"]].to_numpy(float))
            axes.set_xlim(0, right * _ROOM if right > 0 else None)
        for axes, frequency in zip(grid, frequencies, strict=False):
            for comparison in comparisons[comparisons["frequency_hz"] == frequency].to_dict("records"):
                _draw_comparison(axes, comparison, styles)
        grid[0].set_ylabel("hysteresis ratio")
        drawn = dynamic.dropna(subset=["dynamic_response_deg", "hysteresis_ratio", "frequency_hz"])
        used = [style for name, style in styles.items() if name in set(drawn["design"])]
        figure.legend(
            handles=[style.handle() for style in used],
            loc="outside lower center",
            ncols=min(len(used), 4) or 1,
        )
    return figure


def _draw_design(axes: Axes, trials: pd.DataFrame, style: DesignStyle) -> None:
    if trials.empty:
        return
    x, y = (trials[column].to_numpy(float) for column in ("dynamic_response_deg", "hysteresis_ratio"))
    axes.plot(x, y, color=style.colour, linestyle=style.line, linewidth=1.0, zorder=3, label=style.label)
    axes.errorbar(
        x,
        y,
        xerr=_arms(trials, "dynamic_response_deg"),
        yerr=_arms(trials, "hysteresis_ratio"),
        linestyle="none",
        color=style.edge,
        linewidth=0.6,
        capsize=1.2,
        zorder=3.5,
    )
    axes.plot(
        x,
        y,
        linestyle="none",
        marker=style.marker,
        markersize=4,
        color=style.colour,
        markeredgecolor=style.edge,
        markeredgewidth=0.6,
        zorder=4,
    )


def _arms(trials: pd.DataFrame, column: str) -> FloatArray:
    """Lengths (2, N) of the whiskers below and above each value."""
    value = trials[column].to_numpy(float)
    ends = trials[[f"{column}_low", f"{column}_high"]].to_numpy(float).T
    return np.abs(ends - value)


def _draw_comparison(axes: Axes, best: Mapping[str, Any], styles: Mapping[str, DesignStyle]) -> None:
    """A dashed line at the angle of a comparison and both crossings, as the paper shows it."""
    angle, ratios = float(best["angle_deg"]), (float(best["baseline_ratio"]), float(best["design_ratio"]))
    axes.axvline(angle, color=TEXT_GREY, linewidth=0.8, linestyle=(0, (4, 2.5)), zorder=2)
    for ratio in ratios:
        axes.plot(
            [0, angle], [ratio, ratio], color=AXIS_GREY, linewidth=0.5, linestyle=(0, (1.5, 1.5)), zorder=2
        )
        axes.plot(
            angle,
            ratio,
            marker="o",
            markersize=6.5,
            color="none",
            markeredgecolor=TEXT_GREY,
            markeredgewidth=0.9,
            zorder=6,
        )
        axes.annotate(
            f"{ratio:.3f}", (0, ratio), xytext=(3, 1.5), textcoords="offset points", va="bottom", zorder=6
        )
    improvement = f"{-100 * best['improvement']:+.1f}\u00a0%".replace("-", MINUS)
    caption = f"at {angle:g}°: {styles[best['design']].label} {improvement} against {styles[best['baseline']].label}"
    axes.set_title(f"{axes.get_title('center')}\n{caption}", loc="center")
