"""Bars of dynamic response and of hysteresis ratio, with their intervals, for all designs and pressures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .page import PAGE_MM, TEXT_GREY, house_style, light_grid, new_figure
from .styles import DesignStyle

# Column of the table, label of the axis.
_METRICS = (("dynamic_response_deg", "dynamic response (°)"), ("hysteresis_ratio", "hysteresis ratio"))
_GROUP = 0.86  # fraction of a pressure's width on the axis that its bars take


def bars_figure(dynamic: pd.DataFrame, styles: Mapping[str, DesignStyle]) -> Figure:
    """Largest angle (above) and hysteresis ratio (below), a column for each frequency; whiskers are intervals.

    Parameters
    ----------
    dynamic : DataFrame
        One row per trial, with design, frequency_hz, pressure_pp_kpa, and each metric with its _low, _high.
    styles : mapping of str to DesignStyle
        Style of each design, by its name.

    Returns
    -------
    Figure
        The figure.
    """
    frequencies = sorted(dynamic["frequency_hz"].dropna().unique())
    with house_style():
        n_columns = max(len(frequencies), 1)
        figure = new_figure(PAGE_MM, 104)
        grid = figure.subplots(len(_METRICS), n_columns, sharey="row", squeeze=False)
        for column, frequency in enumerate(frequencies):
            here = dynamic[dynamic["frequency_hz"] == frequency]
            pressures = sorted(here["pressure_pp_kpa"].dropna().unique())
            for row, (metric, label) in enumerate(_METRICS):
                axes = grid[row, column]
                _draw_groups(axes, here, pressures, metric, styles)
                light_grid(axes)
                if row == 0:
                    axes.set_title(f"{frequency:g} Hz", loc="center")
                if row == len(_METRICS) - 1:
                    axes.set_xlabel("peak-to-peak pressure (kPa)")
                if column == 0:
                    axes.set_ylabel(label)
        used = [style for name, style in styles.items() if name in set(dynamic["design"])]
        figure.legend(
            handles=[style.handle(line=False) for style in used],
            loc="outside lower center",
            ncols=min(len(used), 4) or 1,
        )
        figure.align_ylabels()
    return figure


def _draw_groups(
    axes: Axes, trials: pd.DataFrame, pressures: list[float], metric: str, styles: Mapping[str, DesignStyle]
) -> None:
    counts = trials.groupby("pressure_pp_kpa").size()
    width = _GROUP / max(counts.max(), 1)
    # A bar's position: its group, and its rank in the group by the study's order of designs.
    rank = trials["design"].map({name: index for index, name in enumerate(styles)})
    order = trials.assign(order=rank).sort_values("order", kind="stable")
    within = order.groupby("pressure_pp_kpa").cumcount() - (order["pressure_pp_kpa"].map(counts) - 1) / 2
    group = order["pressure_pp_kpa"].map({pressure: index for index, pressure in enumerate(pressures)})
    order = order.assign(x=group + width * within)
    for name, style in styles.items():
        here = order[order["design"] == name]
        x, value = here["x"].to_numpy(float), here[metric].to_numpy(float)
        if not len(x):
            continue
        axes.bar(x, value, 0.86 * width, color=style.colour, linewidth=0)
        ends = here[[f"{metric}_low", f"{metric}_high"]].to_numpy(float).T
        axes.errorbar(
            x,
            value,
            np.abs(ends - value),
            linestyle="none",
            color=TEXT_GREY,
            elinewidth=0.7,
            capsize=1.3,
            capthick=0.7,
        )
        # At the foot of the bar, so that designs are distinguished without colour.
        axes.plot(
            x,
            np.full(len(x), 0.035),
            transform=axes.get_xaxis_transform(),
            marker=style.marker,
            markersize=2.8,
            color="white",
            markeredgecolor=style.edge,
            markeredgewidth=0.5,
            linestyle="none",
        )
    axes.set_xticks(range(len(pressures)), [f"{pressure:g}" for pressure in pressures])
    axes.tick_params(axis="x", length=0)
