"""The figure of an angle table: angle over time, its uncertainty, and flagged rows."""

from __future__ import annotations

import warnings
from functools import cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from .atomic import atomic_path
from .errors import ResultsError, reason
from .results import AngleTable
from .types import Flag, FloatArray

# Okabe and Ito's palette: distinguishable with any colour vision.
_CURVE = "#0072B2"
_LONGEST_NAME = 64
_DRAWING = Lock()  # one at a time: all tables are drawn on one reused figure
_MARKS = {  # flag: colour, marker, legend text
    Flag.LOW_LIKELIHOOD: ("#E69F00", "o", "low likelihood"),
    Flag.JUMP: ("#F0E442", "v", "jump"),
    Flag.DAMAGED: ("#CC79A7", "s", "damaged frame"),
    Flag.OUT_OF_FRAME: ("#009E73", "^", "out of frame, no angle"),
    Flag.COINCIDENT_POINTS: ("#56B4E9", "D", "coincident points, no angle"),
    Flag.PASSED_OVER: ("0.6", "|", "dropped, no angle"),
    Flag.UNDECODABLE: ("#D55E00", "|", "undecodable, no angle"),
}


def write_angle_figure(table: AngleTable, out_path: str | Path) -> None:
    """Write angle over time as a PNG (1440 x 720 px): curve, band of 2 sd, flagged rows marked by kind.

    Where the angle is unknown the curve has a gap and the row's mark stands on the time axis.

    Parameters
    ----------
    table : AngleTable
        The table to draw.
    out_path : str or Path
        The PNG to write or replace.

    Raises
    ------
    ResultsError
        The file cannot be written.
    """
    with _DRAWING:
        figure, axes = _empty()
        _draw(figure, axes, table)
        _save(figure, out_path)


@cache
def _sheet() -> tuple[Figure, Axes]:
    """The figure that all tables are drawn into, one after the other: axes and ticks are slow to create."""
    # The object interface: no window, no state that a user's own pyplot session would see.
    figure = Figure(figsize=(9, 4.5), dpi=160)
    FigureCanvasAgg(figure)
    # Room for the longest labels: solving a layout for each figure takes longer than tracking a short clip.
    axes = figure.add_axes((0.092, 0.225, 0.88, 0.705))
    axes.set_xlabel("time (s)")
    axes.grid(axis="y", color="0.92", linewidth=0.8, zorder=0)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _empty() -> tuple[Figure, Axes]:
    """The sheet with nothing drawn on it."""
    figure, axes = _sheet()
    for drawn in (*axes.lines, *axes.collections, *figure.legends):
        drawn.remove()
    axes.dataLim.set_points(Bbox.null().get_points())
    axes.set_xlim(0, 1)  # stays in force where there is nothing to draw
    axes.autoscale()
    return figure, axes


def _draw(figure: Figure, axes: Axes, table: AngleTable) -> None:
    time_s, angle_deg = _with_gaps(table.time_s, table.angle_deg)
    _, sd_deg = _with_gaps(table.time_s, table.angle_sd_deg)
    axes.plot(time_s, angle_deg, color=_CURVE, linewidth=1.2, label="bending angle", zorder=3)
    if np.isfinite(sd_deg).any():
        band = (angle_deg - 2 * sd_deg, angle_deg + 2 * sd_deg)
        axes.fill_between(time_s, *band, color=_CURVE, alpha=0.22, linewidth=0, label="± 2 sd", zorder=2)
    _draw_single_rows(axes, table)
    _mark_flagged(axes, table)

    axes.axhline(0, color="0.75", linewidth=0.8, zorder=1)
    definition = "" if table.definition is None else f", {table.definition.name}"
    axes.set_ylabel(f"bending angle{definition} (°)")
    if len(table) > 1:
        axes.set_xlim(float(table.time_s[0]), float(table.time_s[-1]))
    name = table.provenance.get("video", {}).get("name", "")
    if len(name) > _LONGEST_NAME:
        name = f"{name[: _LONGEST_NAME - 21]}…{name[-20:]}"
    # "$" would begin mathematics. A fixed title height (y=1.0) saves matplotlib a second layout of the axes.
    axes.set_title(name.replace("$", r"\$"), loc="left", fontsize=11, y=1.0)
    n_flagged = int(np.sum(table.flag != ""))
    axes.set_title(f"{len(table)} frames, {n_flagged} flagged", loc="right", fontsize=9, color="0.35", y=1.0)
    _limit_angles(axes, table)
    handles, _ = axes.get_legend_handles_labels()
    if len(handles) > 1:
        figure.legend(loc="lower center", ncols=min(len(handles), 4), frameon=False, fontsize=9)


def _save(figure: Figure, out_path: str | Path) -> None:
    try:
        with atomic_path(out_path) as temporary, warnings.catch_warnings():
            # A name in a script that the font lacks is shown as boxes; the file's name says it too.
            warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
            figure.savefig(temporary, format="png", pil_kwargs={"compress_level": 1})
    except OSError as error:
        raise ResultsError(f"{out_path}: cannot be written ({reason(error)})") from error


def _limit_angles(axes: Axes, table: AngleTable) -> None:
    """Set the axis by the angles and the typical band: the band of a very uncertain row can have any height."""
    known = np.isfinite(table.angle_deg)
    if not known.any():
        axes.set_ylim(-5.0, 95.0)
        return
    low, high = table.angle_deg[known].min(), table.angle_deg[known].max()
    sd_deg = table.angle_sd_deg[known & np.isfinite(table.angle_sd_deg) & (table.flag == "")]
    typical = 2 * float(np.median(sd_deg)) if len(sd_deg) else 0.0
    margin = max(0.06 * (high - low), 1.3 * typical, 1.0)
    axes.set_ylim(min(low, 0.0) - margin, high + margin)


def _with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The series with a NaN inserted in each pause of the camera, which a line would otherwise bridge."""
    steps = np.diff(time_s)
    pauses = np.flatnonzero(steps > 4 * np.median(steps)) + 1 if len(steps) else np.array([], dtype=int)
    return np.insert(time_s, pauses, time_s[pauses]), np.insert(values, pauses, np.nan)


def _draw_single_rows(axes: Axes, table: AngleTable) -> None:
    """Dots for angles between two gaps, which a line does not show."""
    known = np.concatenate([[False], np.isfinite(table.angle_deg), [False]])
    alone = known[1:-1] & ~known[:-2] & ~known[2:]
    axes.plot(table.time_s[alone], table.angle_deg[alone], ".", color=_CURVE, markersize=3, zorder=3)


def _mark_flagged(axes: Axes, table: AngleTable) -> None:
    for kind in dict.fromkeys(table.flag[table.flag != ""]):
        colour, marker, text = _MARKS.get(kind, ("0.4", "x", str(kind)))
        rows = table.flag == kind
        known = rows & np.isfinite(table.angle_deg)
        unknown = rows & ~known
        label = f"{text} ({int(rows.sum())})"
        style: dict[str, Any] = {"linestyle": "none", "marker": marker, "color": colour, "zorder": 4}
        if known.any():
            axes.plot(
                table.time_s[known],
                table.angle_deg[known],
                markersize=3.2,
                markeredgewidth=0,
                label=label,
                **style,
            )
            label = ""
        if unknown.any():
            axes.plot(
                table.time_s[unknown],
                np.full(int(unknown.sum()), 0.012),
                transform=axes.get_xaxis_transform(),
                markersize=7 if marker == "|" else 4,
                clip_on=False,
                label=label,
                **style,
            )
