"""Tracking of the pressure control: measured pressure on its reference wave, and the error below."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from .page import (
    AXIS_GREY,
    PAGE_MM,
    PRESSURE_COLOUR,
    decimated,
    house_style,
    light_grid,
    limits_with_zero,
    new_figure,
)

if TYPE_CHECKING:
    from ..trial import TrialData

_COLUMNS = 700
# Number of cycles shown: enough to see the pattern of the error.
_CYCLES = 3


def control_figure(trials: Sequence[TrialData], rmse_kpa: Sequence[float]) -> Figure:
    """A column for each trial: pressure and reference over time (three cycles of a wave), error and RMSE below.

    Parameters
    ----------
    trials : sequence of TrialData
        Trials, which must have a reference.
    rmse_kpa : sequence of float
        RMSE of each trial, over its whole log.

    Returns
    -------
    Figure
        The figure.
    """
    with house_style():
        figure = new_figure(PAGE_MM, 70)
        grid = figure.subplots(2, len(trials), sharex="col", squeeze=False, height_ratios=(2, 1))
        for column, (trial, rmse) in enumerate(zip(trials, rmse_kpa, strict=True)):
            assert trial.log_reference_kpa is not None
            waves, errors = grid[:, column]
            shown = trial.log_time_s >= trial.log_time_s[0]
            if trial.frequency_hz:
                shown &= trial.log_time_s < trial.log_time_s[0] + _CYCLES / trial.frequency_hz
            time_s = trial.log_time_s[shown] - trial.log_time_s[0]
            measured, reference = trial.log_pressure_kpa[shown], trial.log_reference_kpa[shown]
            waves.plot(
                *decimated(time_s, measured, _COLUMNS), color=PRESSURE_COLOUR, linewidth=1.1, label="measured"
            )
            waves.plot(
                *decimated(time_s, reference, _COLUMNS),
                color="0.05",
                linewidth=0.6,
                linestyle=(0, (3, 2)),
                label="reference",
            )
            errors.plot(
                *decimated(time_s, measured - reference, _COLUMNS), color=PRESSURE_COLOUR, linewidth=0.5
            )
            errors.axhline(0, color=AXIS_GREY, linewidth=0.5)
            errors.axhspan(-rmse, rmse, color=PRESSURE_COLOUR, alpha=0.18, linewidth=0)
            errors.set_title(f"RMSE {rmse:.2g} kPa (band)", loc="right", fontsize=6.5, pad=2)
            wave = f"{trial.frequency_hz:g} Hz" if trial.frequency_hz else "staircase"
            pressure = f", {trial.pressure_pp_kpa:g} kPa" if trial.pressure_pp_kpa else ""
            waves.set_title(f"{wave}{pressure}", loc="center")
            errors.set_xlabel("time (s)")
            errors.set_xlim(0, float(time_s[-1]))
            for axes in (waves, errors):
                light_grid(axes)
        known = np.concatenate([trial.log_pressure_kpa for trial in trials])
        for axes in grid[0]:
            axes.set_ylim(limits_with_zero(float(np.nanmin(known)), float(np.nanmax(known))))
        grid[0, 0].set_ylabel("pressure (kPa)")
        grid[1, 0].set_ylabel("error (kPa)")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
        figure.align_ylabels()
    return figure
