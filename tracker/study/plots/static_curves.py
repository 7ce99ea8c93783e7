"""Static curves: the angle held at each stair against the model's curve, and their difference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .page import AXIS_GREY, COLUMN_MM, house_style, light_grid, new_figure
from .styles import DesignStyle

if TYPE_CHECKING:
    from ..trial import TrialData


def static_figure(
    steps: pd.DataFrame, trials: Sequence[TrialData], styles: Mapping[str, DesignStyle]
) -> Figure:
    """Measured angle at each stair with its interval, the model's curve, and measured minus model below.

    Parameters
    ----------
    steps : DataFrame
        One row per stair, with trial, number, pressure_kpa, angle_deg, angle_deg_low, angle_deg_high,
        model_angle_deg.
    trials : sequence of TrialData
        Trials of the steps, with their model curves.
    styles : mapping of str to DesignStyle
        Style of each design, by its name.

    Returns
    -------
    Figure
        The figure.
    """
    with house_style():
        figure = new_figure(COLUMN_MM, 104)
        angles, residuals = figure.subplots(2, 1, sharex=True, height_ratios=(5, 2))
        for trial in trials:
            style = styles[trial.design]
            here = steps[steps["trial"] == trial.name].sort_values("number")
            if trial.model_pressure_kpa is not None and trial.model_angle_deg is not None:
                angles.plot(
                    trial.model_pressure_kpa,
                    trial.model_angle_deg,
                    color=style.colour,
                    linestyle="--",
                    linewidth=1.6,
                )
            x, y = here["pressure_kpa"].to_numpy(float), here["angle_deg"].to_numpy(float)
            whiskers = np.abs([y - here["angle_deg_low"], here["angle_deg_high"] - y])
            off = y - here["model_angle_deg"].to_numpy(float)
            for axes, values in ((angles, y), (residuals, off)):
                axes.errorbar(
                    x,
                    values,
                    whiskers,
                    color=style.colour,
                    linewidth=0.6,
                    linestyle=(0, (1.2, 1.2)),
                    elinewidth=0.6,
                    capsize=1.3,
                    marker=style.marker,
                    markersize=3.6,
                    markeredgecolor=style.edge,
                    markeredgewidth=0.6,
                )
        residuals.axhline(0, color=AXIS_GREY, linewidth=0.6)
        angles.set_ylabel("bending angle (°)")
        residuals.set_ylabel("measured − model (°)")
        residuals.set_xlabel("pressure (kPa)")
        for axes in (angles, residuals):
            light_grid(axes, "both")
        used = [style for name, style in styles.items() if name in {trial.design for trial in trials}]
        line_key = [
            Line2D(
                [],
                [],
                color=AXIS_GREY,
                marker="o",
                markersize=3.6,
                linestyle=(0, (1.2, 1.2)),
                linewidth=0.6,
                label="measured",
            ),
            Line2D([], [], color=AXIS_GREY, linestyle="--", linewidth=1.6, label="model"),
        ]
        angles.legend(handles=[*(style.handle(line=False) for style in used), *line_key], loc="upper left")
        figure.align_ylabels()
    return figure
