"""Bars of dynamic response and of hysteresis ratio, with their intervals, for all designs and pressures."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .looks import Look
from .page import INK, PAGE_MM, house_style, new_figure, quiet_grid

# Column of the table, words on the axis.
_METRICS = (("dynamic_response_deg", "dynamic response (°)"), ("hysteresis_ratio", "hysteresis ratio"))
_GROUP = 0.86  # of a pressure's place on the axis is taken by its bars


def bars_figure(dynamic: pd.DataFrame, looks: Mapping[str, Look]) -> Figure:
    """Largest angle (above) and hysteresis ratio (below), a column for each frequency; whiskers are intervals.

    Parameters
    ----------
    dynamic : DataFrame
        One row a trial, with design, frequency_hz, pressure_pp_kpa, and each metric with its _low, _high.
    """
    frequencies = sorted(dynamic["frequency_hz"].dropna().unique())
    with house_style():
        n_columns = max(len(frequencies), 1)
        figure = new_figure(PAGE_MM, 104)
        grid = figure.subplots(len(_METRICS), n_columns, sharey="row", squeeze=False)
        for column, frequency in enumerate(frequencies):
            here = dynamic[dynamic["frequency_hz"] == frequency]
            pressures = sorted(here["pressure_pp_kpa"].dropna().unique())
            for row, (metric, words) in enumerate(_METRICS):
                axes = grid[row, column]
                _draw_groups(axes, here, pressures, metric, looks)
                quiet_grid(axes)
                if row == 0:
                    axes.set_title(f"{frequency:g} Hz", loc="center")
                if row == len(_METRICS) - 1:
                    axes.set_xlabel("peak-to-peak pressure (kPa)")
                if column == 0:
                    axes.set_ylabel(words)
        used = [look for name, look in looks.items() if name in set(dynamic["design"])]
        figure.legend(
            handles=[look.handle(line=False) for look in used],
            loc="outside lower center",
            ncols=min(len(used), 4) or 1,
        )
        figure.align_ylabels()
    return figure


def _draw_groups(
    axes: Axes, trials: pd.DataFrame, pressures: list[float], metric: str, looks: Mapping[str, Look]
) -> None:
    counts = trials.groupby("pressure_pp_kpa").size()
    width = _GROUP / max(counts.max(), 1)
    # A bar's place: its group, and its rank in the group by the study's order of designs.
    rank = trials["design"].map({name: index for index, name in enumerate(looks)})
    order = trials.assign(order=rank).sort_values("order", kind="stable")
    within = order.groupby("pressure_pp_kpa").cumcount() - (order["pressure_pp_kpa"].map(counts) - 1) / 2
    group = order["pressure_pp_kpa"].map({pressure: index for index, pressure in enumerate(pressures)})
    order = order.assign(x=group + width * within)
    for name, look in looks.items():
        here = order[order["design"] == name]
        x, value = here["x"].to_numpy(float), here[metric].to_numpy(float)
        if not len(x):
            continue
        axes.bar(x, value, 0.86 * width, color=look.colour, linewidth=0)
        ends = here[[f"{metric}_low", f"{metric}_high"]].to_numpy(float).T
        axes.errorbar(
            x,
            value,
            np.abs(ends - value),
            linestyle="none",
            color=INK,
            elinewidth=0.7,
            capsize=1.3,
            capthick=0.7,
        )
        # At the foot, so that designs are told apart without colour.
        axes.plot(
            x,
            np.full(len(x), 0.035),
            transform=axes.get_xaxis_transform(),
            marker=look.marker,
            markersize=2.8,
            color="white",
            markeredgecolor=look.edge,
            markeredgewidth=0.5,
            linestyle="none",
        )
    axes.set_xticks(range(len(pressures)), [f"{pressure:g}" for pressure in pressures])
    axes.tick_params(axis="x", length=0)
