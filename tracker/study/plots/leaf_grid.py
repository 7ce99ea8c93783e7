"""All leaves of a study: a panel for each frequency (rows) and pressure (columns), a colour for each design."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ...types import FloatArray
from .leaf import mean_loop
from .page import PAGE_MM, house_style, light_grid, limits_with_zero, new_figure
from .styles import DesignStyle

_ROW_MM = 46.0
# Points per cycle: the resolution of a panel of a fifth of the page.
_POINTS = 100


def leaf_grid_figure(
    dynamic: pd.DataFrame, loops: Mapping[str, Sequence[FloatArray]], styles: Mapping[str, DesignStyle]
) -> Figure:
    """Every dynamic trial's cycles, with the design's marker at the tip of its leaf.

    Parameters
    ----------
    dynamic : DataFrame
        One row per trial, with trial, design, frequency_hz and pressure_pp_kpa.
    loops : mapping of str to sequence of ndarray of float
        (N, 2) of each cycle used, pressure in kPa and angle in degrees, by trial.
    styles : mapping of str to DesignStyle
        Style of each design, by its name.

    Returns
    -------
    Figure
        The figure.
    """
    shown = dynamic[[len(loops.get(name, ())) > 0 for name in dynamic["trial"]]]
    frequencies = sorted(shown["frequency_hz"].unique())
    pressures = sorted(shown["pressure_pp_kpa"].unique())
    with house_style():
        n_rows, n_columns = max(len(frequencies), 1), max(len(pressures), 1)
        figure = new_figure(PAGE_MM, _ROW_MM * n_rows + 14)
        grid = figure.subplots(n_rows, n_columns, sharex=True, sharey="row", squeeze=False)
        for row, frequency in enumerate(frequencies):
            for column, pressure in enumerate(pressures):
                axes = grid[row, column]
                here = shown[(shown["frequency_hz"] == frequency) & (shown["pressure_pp_kpa"] == pressure)]
                light_grid(axes, "both")
                if here.empty:
                    axes.text(0.5, 0.5, "no trial", transform=axes.transAxes, ha="center", color="0.6")
                _draw_trials(axes, here, loops, styles)
                if row == 0:
                    axes.set_title(f"{pressure:g} kPa peak to peak", loc="center")
                if column == 0:
                    axes.set_ylabel(f"{frequency:g} Hz\nbending angle (°)")
                if row == n_rows - 1:
                    axes.set_xlabel("pressure (kPa)")
        if len(shown):
            pressures_kpa, _ = _extremes(shown["trial"], loops)
            grid[0, 0].set_xlim(limits_with_zero(*pressures_kpa))
        for row, frequency in enumerate(frequencies):
            _, angles_deg = _extremes(shown.loc[shown["frequency_hz"] == frequency, "trial"], loops)
            grid[row, 0].set_ylim(limits_with_zero(*angles_deg))
        used = [style for name, style in styles.items() if name in set(shown["design"])]
        figure.legend(
            handles=[style.handle(line=False) for style in used],
            loc="outside lower center",
            ncols=min(len(used), 4) or 1,
        )
    return figure


def _draw_trials(
    axes: Axes,
    trials: pd.DataFrame,
    loops: Mapping[str, Sequence[FloatArray]],
    styles: Mapping[str, DesignStyle],
) -> None:
    """The leaves of one panel, in the study's order of designs, so that the drawing order is the same in all panels."""
    cycles: list[FloatArray] = []
    colours: list[str] = []
    rank = {name: index for index, name in enumerate(styles)}
    for trial in sorted(trials.to_dict("records"), key=lambda trial: rank[trial["design"]]):
        style = styles[trial["design"]]
        own = [_thinned(loop) for loop in loops[trial["trial"]]]
        cycles += own
        colours += [style.colour] * len(own)
        axes.plot(
            *_tip(mean_loop(own)),
            marker=style.marker,
            color=style.colour,
            markeredgecolor=style.edge,
            markeredgewidth=0.6,
            markersize=4,
            zorder=5,
        )
    lines = LineCollection(cycles, colors=colours, linewidths=0.45, alpha=0.8)
    axes.add_collection(lines, autolim=False)


def _extremes(
    names: Iterable[str], loops: Mapping[str, Sequence[FloatArray]]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Lowest and highest pressure, and angle, of some trials' cycles."""
    points = np.concatenate([loop for name in names for loop in loops[name]])
    (low_kpa, low_deg), (high_kpa, high_deg) = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    return (float(low_kpa), float(high_kpa)), (float(low_deg), float(high_deg))


def _thinned(loop: FloatArray) -> FloatArray:
    step = max(len(loop) // _POINTS, 1)
    rows = np.arange(0, len(loop), step)
    # The largest angle is kept: the tip matters most.
    if np.isfinite(loop[:, 1]).any():
        rows = np.union1d(rows, np.nanargmax(np.abs(loop[:, 1])))
    return loop[rows]


def _tip(mean: FloatArray) -> tuple[float, float]:
    if not np.isfinite(mean[:, 1]).any():
        return float("nan"), float("nan")
    # Of either sign: where bending counts as negative, the largest value is the start, at (0, 0).
    index = int(np.nanargmax(np.abs(mean[:, 1])))
    return float(mean[index, 0]), float(mean[index, 1])
