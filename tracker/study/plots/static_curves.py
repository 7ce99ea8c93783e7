"""Static curves: the angle held at each stair against the model's curve, and what is left between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from .looks import Look
from .page import COLUMN_MM, QUIET, house_style, new_figure, quiet_grid

if TYPE_CHECKING:
    from ..trial import TrialData


def static_figure(steps: pd.DataFrame, trials: Sequence[TrialData], looks: Mapping[str, Look]) -> Figure:
    """Measured angle at each stair with its interval, the model's curve, and measured less model below.

    Parameters
    ----------
    steps : DataFrame
        One row a stair, with trial, number, pressure_kpa, angle_deg, angle_deg_low, angle_deg_high,
        model_angle_deg.
    trials : sequence of TrialData
        Those of the steps, for their model curves.
    """
    with house_style():
        figure = new_figure(COLUMN_MM, 104)
        angles, residuals = figure.subplots(2, 1, sharex=True, height_ratios=(5, 2))
        for trial in trials:
            look = looks[trial.design]
            here = steps[steps["trial"] == trial.name].sort_values("number")
            if trial.model_pressure_kpa is not None and trial.model_angle_deg is not None:
                angles.plot(
                    trial.model_pressure_kpa,
                    trial.model_angle_deg,
                    color=look.colour,
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
                    color=look.colour,
                    linewidth=0.6,
                    linestyle=(0, (1.2, 1.2)),
                    elinewidth=0.6,
                    capsize=1.3,
                    marker=look.marker,
                    markersize=3.6,
                    markeredgecolor=look.edge,
                    markeredgewidth=0.6,
                )
        residuals.axhline(0, color=QUIET, linewidth=0.6)
        angles.set_ylabel("bending angle (°)")
        residuals.set_ylabel("measured − model (°)")
        residuals.set_xlabel("pressure (kPa)")
        for axes in (angles, residuals):
            quiet_grid(axes, "both")
        used = [look for name, look in looks.items() if name in {trial.design for trial in trials}]
        style = [
            Line2D(
                [],
                [],
                color=QUIET,
                marker="o",
                markersize=3.6,
                linestyle=(0, (1.2, 1.2)),
                linewidth=0.6,
                label="measured",
            ),
            Line2D([], [], color=QUIET, linestyle="--", linewidth=1.6, label="model"),
        ]
        angles.legend(handles=[*(look.handle(line=False) for look in used), *style], loc="upper left")
        figure.align_ylabels()
    return figure
