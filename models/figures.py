"""Figures of an evaluation: the learning curve, the distribution of errors, and the frames with the largest errors.

matplotlib through its object interface only: no global state, no display.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ..tracker.atomic import atomic_path
from ..tracker.links import make_folder
from ..tracker.types import FloatArray
from .data.images import read_image
from .evaluation import Evaluation

WORST_FRAMES = 6
"""Frames shown in worst-frames.png."""

LEAST_POINTS = 3
"""Rows of training.csv from which a learning curve is drawn."""

FEW_VALUES = 10
"""Values below which a distribution is drawn as dots."""

WIDE_LOG_AXIS = 4.0
"""Ratio of the ends of an axis above which there are at least two of 1, 2, 5, 10, ... on it."""

_LABEL, _DETECTED = "#0072B2", "#D55E00"
"""Blue and vermilion of Okabe & Ito, which colour-blind readers can distinguish; the markers differ in shape too."""


def write_figures(evaluation: Evaluation, rows: Sequence[dict[str, float]], folder: Path) -> list[Path]:
    """Write errors.png, worst-frames.png and, where there are rows, learning-curve.png.

    Parameters
    ----------
    evaluation : Evaluation
    rows : sequence of dict
        Rows of training.csv.
    folder : Path

    Returns
    -------
    list of Path
        The files written.
    """
    make_folder(folder, parents=False)
    figures = {"errors.png": _errors(evaluation), "worst-frames.png": _worst(evaluation)}
    if rows:
        figures["learning-curve.png"] = _learning_curve(rows)
    for name, figure in figures.items():
        with atomic_path(folder / name) as temporary:
            figure.savefig(temporary, dpi=150, format="png")
    return [folder / name for name in figures]


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _learning_curve(rows: Sequence[dict[str, float]]) -> Figure:
    figure = _figure(7, 3.2)
    left, right = figure.subplots(1, 2)
    step = [row["step"] for row in rows]
    few = len(rows) < LEAST_POINTS
    if not few:
        left.plot(step, [row["loss"] for row in rows], color="0.2")
    left.set(title="Training loss", xlabel="step", ylabel="loss", yscale="log")
    px = np.array([row["held_out_px"] for row in rows], dtype=float)
    if not few:
        right.plot(step, px, color=_LABEL, marker="o", markersize=3)
    right.set(title="Held-out frames", xlabel="step", ylabel="distance from labels (px RMS)", yscale="log")
    if few:
        for axes in (left, right):
            text = f"{len(rows)} evaluation{'s' if len(rows) > 1 else ''}: too few for a curve"
            axes.text(0.5, 0.5, text, ha="center", transform=axes.transAxes)
    elif np.isnan(px).all():
        right.text(0.5, 0.5, "no frames held out", ha="center", transform=right.transAxes)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, which="both")
        _label_plainly(axes.yaxis)
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))  # there is no half a step
        if few:
            axes.set(xticks=[], yticks=[])
    return figure


def _label_plainly(axis: Axis) -> None:
    """Put a few plain numbers on a logarithmic axis, 0.2 and not 2 x 10^-1, however little it spans."""
    low, high = axis.get_view_interval()
    # On less than a decade even steps read better; LogLocator would leave one tick or none.
    wide = low > 0 and high / low > WIDE_LOG_AXIS
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if wide else MaxNLocator(5))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def _errors(evaluation: Evaluation) -> Figure:
    figure = _figure(7, 3.2)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for k, name in enumerate(evaluation.keypoints):
        _draw_distribution(left, evaluation.error_px[:, k], f"C{k}", name)
    left.set(title="Keypoints", xlabel="distance from label (px)", ylabel="share of frames", xlim=(0, None))
    left.legend(frameon=False, fontsize="small")
    _draw_distribution(right, np.abs(evaluation.angle_error_deg), "0.2", "bending angle")
    right.set(title="Bending angle", xlabel="difference from label (deg)", xlim=(0, None))
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25)
        axes.set_ylim(0, 1.02)
    return figure


def _draw_distribution(axes: Axes, values: FloatArray, colour: str, label: str) -> None:
    """The empirical distribution: steps, or of few values a dot for each, since steps would look like more data."""
    x, share = _cumulative(values)
    if len(x) - 1 < FEW_VALUES:
        axes.plot(x[1:], share[1:], "o", color=colour, markersize=4, label=label)
    else:
        axes.step(x, share, where="post", color=colour, label=label)


def _cumulative(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Empirical cumulative distribution of the values that are not NaN, as steps from (0, 0)."""
    known = np.sort(values[~np.isnan(values)])
    return np.concatenate([[0.0], known]), np.arange(len(known) + 1) / max(len(known), 1)


def _worst(evaluation: Evaluation) -> Figure:
    error = np.nan_to_num(evaluation.error_px, nan=-1.0).max(axis=1)
    order = np.argsort(-error)[:WORST_FRAMES]
    columns = min(3, len(order))
    lines = -(-len(order) // columns)
    figure = _figure(3.4 * columns, 2.9 * lines + 0.4)
    cells = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in cells:
        axes.set_axis_off()
    for axes, i in zip(cells, order, strict=False):
        frame = evaluation.frames[i]
        labels, found = evaluation.labels[i], evaluation.found.xy[i]
        image = read_image(frame)
        left, top, right, bottom = _around(np.vstack([labels, found]), image.shape[1::-1])
        axes.imshow(image[top:bottom, left:right], extent=(left - 0.5, right - 0.5, bottom - 0.5, top - 0.5))
        axes.plot(*labels.T, "o", mec=_LABEL, mfc="none", ms=8, mew=1.6, label="label")
        axes.plot(*found.T, "x", color=_DETECTED, ms=7, mew=1.6, label="found")
        worst = int(np.nanargmax(np.nan_to_num(evaluation.error_px[i], nan=-1.0)))
        axes.set_title(
            f"{frame.video}/{frame.image_path.name}\n{evaluation.keypoints[worst]} {error[i]:.1f} px off",
            fontsize="small",
        )
    handles, names = cells[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=2, frameon=False, fontsize="small")
    return figure


def _around(points: FloatArray, size_wh: Sequence[int]) -> tuple[int, int, int, int]:
    """Crop of an image that holds all points (M, 2) px with a margin: left, top, right, bottom, px."""
    points = points[~np.isnan(points).any(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(24.0, 0.25 * float((high - low).max()))
    left, top = np.maximum(np.floor(low - margin), 0).astype(int).tolist()
    right, bottom = np.minimum(np.ceil(high + margin), size_wh).astype(int).tolist()
    return left, top, max(right, left + 2), max(bottom, top + 2)
