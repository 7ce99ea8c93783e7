"""Page layout of every figure of a study: column widths, fonts, line weights; saved as vector PDF and PNG.

The figures are drawn in files of their own; the designs' colours are in `styles.py`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from ...atomic import atomic_path
from ...errors import ResultsError, reason
from ...types import FloatArray
from .typeface import figure_families

# A journal's column and its text width.
COLUMN_MM, PAGE_MM = 88.0, 180.0
DPI = 300
TEXT_GREY, AXIS_GREY, GRID_GREY = "0.15", "0.42", "0.88"
PRESSURE_COLOUR = "#4a6484"
_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "legend.handlelength": 2.6,
    "text.color": TEXT_GREY,
    "axes.edgecolor": AXIS_GREY,
    "axes.labelcolor": TEXT_GREY,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.titlelocation": "left",
    "axes.titlepad": 4.0,
    "axes.titley": 1.0,  # the default position, without measuring every tick
    "axes.labelpad": 2.5,
    "xtick.color": AXIS_GREY,
    "ytick.color": AXIS_GREY,
    "xtick.labelcolor": TEXT_GREY,
    "ytick.labelcolor": TEXT_GREY,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 0.9,
    "lines.solid_capstyle": "round",
    "hatch.linewidth": 0.5,
    "pdf.fonttype": 42,  # TrueType: some publishers refuse Type 3
    "savefig.dpi": DPI,
    "text.parse_math": False,  # "$" in a name is a dollar
    "axes.unicode_minus": True,
    "axes.formatter.useoffset": False,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Matplotlib settings of all figures; the user's own are restored afterwards."""
    with mpl.rc_context(), warnings.catch_warnings():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        mpl.rcParams["font.sans-serif"] = figure_families()  # the same figure on every machine
        # Characters that the font lacks are shown as boxes; captions and file names contain the name too.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def new_figure(width_mm: float, height_mm: float, *, layout: str | None = "constrained") -> Figure:
    """An empty figure of a size on paper, without a window. Call it within `house_style`.

    Parameters
    ----------
    width_mm, height_mm : float
        Size on paper, mm.
    layout : str or None, optional
        Layout engine of matplotlib, None for none.

    Returns
    -------
    Figure
        The figure.
    """
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4), layout=layout)  # type: ignore[arg-type]
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, stem: str | Path) -> Image.Image:
    """Write `stem`.pdf (vector, TrueType fonts embedded) and `stem`.png (300 dpi), each whole or not at all.

    Parameters
    ----------
    figure : Figure
        The figure.
    stem : str or Path
        Path of the files, without suffix.

    Returns
    -------
    Image.Image
        The image as saved in the PNG.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    stem = Path(stem)
    with house_style():
        layout = figure.get_layout_engine()
        if layout is not None:
            # Solved once for both files.
            layout.execute(figure)
            figure.set_layout_engine(None)
        # Into memory first: on a full disk Matplotlib's own writer ends with an error of its own. No date: the same
        # study gives the same files, byte for byte.
        pages = BytesIO()
        figure.savefig(pages, format="pdf", metadata={"CreationDate": None})
        with _written(stem.with_name(f"{stem.name}.pdf")) as path:
            path.write_bytes(pages.getvalue())
        canvas = FigureCanvasAgg(figure)
        own_dpi, figure.dpi = figure.dpi, DPI
        canvas.draw()
        image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        figure.dpi = own_dpi
        with _written(stem.with_name(f"{stem.name}.png")) as path:
            # Twice as fast as the usual 6, a few per cent larger.
            image.save(path, format="PNG", dpi=(DPI, DPI), compress_level=1)
    return image


@contextmanager
def _written(path: Path) -> Iterator[Path]:
    try:
        with atomic_path(path) as temporary:
            yield temporary
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({reason(error)})") from error


def limits_with_zero(low: float, high: float, *, headroom: float = 0.06) -> tuple[float, float]:
    """Axis limits that hold [low, high] and zero, with room at the ends that are not zero.

    Parameters
    ----------
    low, high : float
        Range of the values.
    headroom : float, optional
        Fraction of the range that is added at an end.

    Returns
    -------
    low : float
        Lower limit.
    high : float
        Upper limit.
    """
    low, high = min(low, 0.0), max(high, 0.0)
    if not math.isfinite(high - low) or high == low:
        return 0.0, 1.0
    room = headroom * (high - low)
    # The room below zero is no larger than the values below zero (noise).
    return (low - min(room, -low) if low < 0 else 0.0), (high + room if high > 0 else 0.0)


def decimated(time_s: FloatArray, values: FloatArray, n_columns: int) -> tuple[FloatArray, FloatArray]:
    """Min-max decimation of a dense series: the lowest and the highest value of each of `n_columns` pixel columns.

    A line through the result covers the pixels that a line through all samples covers. NaN stays a gap.

    Parameters
    ----------
    time_s, values : ndarray of float
        (N,) series.
    n_columns : int
        Number of pixel columns.

    Returns
    -------
    time_s, values : ndarray of float
        (at most 2 `n_columns`,) or the input where it is not denser.
    """
    step = len(values) // n_columns
    if step < 4:
        return time_s, values
    n = step * -(-len(values) // step)
    padding = n - len(values)
    blocks = np.append(values, np.full(padding, values[-1])).reshape(-1, step)
    times = np.append(time_s, np.full(padding, time_s[-1])).reshape(-1, step)
    rows = np.arange(len(blocks))[:, None]
    # argmin returns a NaN's index when there is one, so a gap is kept.
    extremes = np.sort(np.stack([blocks.argmin(axis=1), blocks.argmax(axis=1)], axis=1), axis=1)
    return times[rows, extremes].ravel(), blocks[rows, extremes].ravel()


def light_grid(axes: Axes, which: str = "y") -> None:
    """Thin grid lines behind the data, along the axis that values are read from.

    Parameters
    ----------
    axes : Axes
        Axes to draw into.
    which : str, optional
        "x", "y" or "both".
    """
    axes.grid(axis=which, color=GRID_GREY, linewidth=0.5)  # type: ignore[arg-type]
