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
    dynamic : one row a trial, with design, frequency_hz, pressure_pp_kpa, and each metric with its _low, _high
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
    most = max((int((trials["pressure_pp_kpa"] == pressure).sum()) for pressure in pressures), default=1)
    width = _GROUP / max(most, 1)
    place_of = {name: index for index, name in enumerate(looks)}
    for group, pressure in enumerate(pressures):
        here = trials[trials["pressure_pp_kpa"] == pressure]
        here = here.iloc[np.argsort([place_of[name] for name in here["design"]], kind="stable")]
        at = group + width * (np.arange(len(here)) - (len(here) - 1) / 2)
        for x, trial in zip(at, here.to_dict("records"), strict=True):
            look = looks[str(trial["design"])]
            value = trial[metric]
            axes.bar(x, value, 0.86 * width, color=look.colour, linewidth=0)
            low, high = trial[f"{metric}_low"], trial[f"{metric}_high"]
            if np.isfinite([value, low, high]).all():
                axes.errorbar(
                    x,
                    value,
                    [[value - low], [high - value]],
                    color=INK,
                    linewidth=0.7,
                    capsize=1.3,
                    capthick=0.7,
                )
            # At the foot, so that designs are told apart without colour.
            axes.plot(
                x,
                0.035,
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
