"""Angle and pressure of one trial over time, one above the other (the paper's figure "Time Series")."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...types import FloatArray
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
from .styles import DesignStyle

if TYPE_CHECKING:
    from ..trial import TrialData

# Pixel columns: more than a page's width at 300 dpi show nothing more.
_COLUMNS = 1500


def time_series_figure(trial: TrialData, style: DesignStyle) -> Figure:
    """Bending angle and pressure over time, on one time axis; where the angle is unknown the curve has a gap.

    Parameters
    ----------
    trial : TrialData
        The trial.
    style : DesignStyle
        Style of its design.

    Returns
    -------
    Figure
        The figure.
    """
    with house_style():
        figure = new_figure(PAGE_MM, 78)
        angle_axes, pressure_axes = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        draw_time_series(angle_axes, pressure_axes, trial, style)
        angle_axes.set_title(trial.name)
        handles, labels = pressure_axes.get_legend_handles_labels()
        if len(handles) > 1:
            figure.legend(handles, labels, loc="outside upper right", ncols=len(handles))
        figure.align_ylabels()
    return figure


def draw_time_series(angle_axes: Axes, pressure_axes: Axes, trial: TrialData, style: DesignStyle) -> None:
    """Draw a trial's angle and pressure over time into two axes, one above the other with one time axis.

    Parameters
    ----------
    angle_axes, pressure_axes : Axes
        Axes to draw into.
    trial : TrialData
        The trial.
    style : DesignStyle
        Style of its design.
    """
    time_s, angle_deg = decimated(trial.time_s, trial.angle_deg, _COLUMNS)
    angle_axes.plot(time_s, angle_deg, color=style.colour, linewidth=0.8, label="angle")
    angle_axes.set_ylabel("bending angle (°)")
    _limit(angle_axes, trial.angle_deg)
    _mark_gaps(angle_axes, trial.time_s, trial.angle_deg)

    log_time_s, log_kpa = decimated(trial.log_time_s, trial.log_pressure_kpa, _COLUMNS)
    pressure_axes.plot(log_time_s, log_kpa, color=PRESSURE_COLOUR, linewidth=0.8, label="measured pressure")
    if trial.log_reference_kpa is not None:
        reference = decimated(trial.log_time_s, trial.log_reference_kpa, _COLUMNS)
        pressure_axes.plot(*reference, color="0.1", linewidth=0.6, linestyle=(0, (2, 1.6)), label="reference")
    pressure_axes.set_ylabel("pressure (kPa)")
    pressure_axes.set_xlabel("time (s)")
    _limit(pressure_axes, trial.log_pressure_kpa)
    if len(trial.time_s) > 1:
        pressure_axes.set_xlim(float(trial.time_s[0]), float(trial.time_s[-1]))
    pressure_axes.locator_params(axis="x", nbins=7)
    for axes, labels in ((angle_axes, 4), (pressure_axes, 3)):
        light_grid(axes)
        # Half of the time to draw a figure is spent on its ticks.
        axes.locator_params(axis="y", nbins=labels)
    angle_axes.tick_params(labelbottom=False)


def _limit(axes: Axes, values: FloatArray) -> None:
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    axes.set_ylim(limits_with_zero(low, high))


def _mark_gaps(axes: Axes, time_s: FloatArray, angle_deg: FloatArray) -> None:
    """A short bar on the time axis under each run of frames without an angle."""
    unknown = np.concatenate([[False], np.isnan(angle_deg), [False]])
    starts, ends = (
        np.flatnonzero(np.diff(unknown.astype(int)) == 1),
        np.flatnonzero(np.diff(unknown.astype(int)) == -1),
    )
    if len(starts) == 0:
        return
    frame_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    bars = [
        (time_s[start], time_s[end - 1] - time_s[start] + frame_s)
        for start, end in zip(starts, ends, strict=True)
    ]
    axes.broken_barh(
        bars,
        (0, 0.03),
        transform=axes.get_xaxis_transform(),
        color=AXIS_GREY,
        linewidth=0.6,
        label="no angle",
    )
