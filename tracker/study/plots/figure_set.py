"""Writes all figures of a study, with captions. Each kind of figure is drawn in its own file."""

from __future__ import annotations

import io
import math
import multiprocessing
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from ...types import FloatArray
from ..paper_tables import best_comparisons, interval_of
from ..trial import Kind
from .bars import bars_figure
from .control_tracking import control_figure
from .leaf import leaf_figure
from .leaf_grid import leaf_grid_figure
from .page import save_figure
from .ratio_angle import ratio_angle_figure
from .static_curves import static_figure
from .styles import DesignStyle
from .time_series import time_series_figure
from .trial_sheet import blank_sheet, trial_sheet_figure

if TYPE_CHECKING:
    from ..analysis import StudyResults
    from ..trial import TrialData

_LONGEST_FILE_NAME = 80
# Most waves in the control figure: more panels would be too narrow.
_MOST_WAVES = 4


@dataclass(frozen=True)
class WrittenFigure:
    """A figure that was written: `name`.pdf and `name`.png in the figures' folder, and an image for the report.

    Attributes
    ----------
    name : str
        File name without suffix, relative to the figures' folder.
    caption : str
        Caption of the figure.
    png : bytes
        A smaller image for the screen.
    narrow : bool
        The figure is as wide as a column, not the page.
    """

    name: str
    caption: str
    png: bytes
    narrow: bool = False


@dataclass(frozen=True)
class Leaf:
    """Data for a trial's leaf: the cycles used, an excluded first one, the rectangle, a note.

    Attributes
    ----------
    loops : tuple of ndarray of float
        (N, 2) kPa and deg of each cycle used.
    apart : tuple of ndarray of float
        The excluded first cycle, where there is one.
    largest_pressure_kpa, largest_angle_deg : float
        Sides of the rectangle, NaN for none.
    note : str
        Text inside the rectangle.
    """

    loops: tuple[FloatArray, ...] = ()
    apart: tuple[FloatArray, ...] = ()
    largest_pressure_kpa: float = math.nan
    largest_angle_deg: float = math.nan
    note: str = ""


def write_study_figures(
    results: StudyResults, trials: Sequence[TrialData], styles: dict[str, DesignStyle], folder: Path
) -> list[WrittenFigure]:
    """The figures of the whole study; a figure without data is omitted.

    Parameters
    ----------
    results : StudyResults
        Results of the study.
    trials : sequence of TrialData
        The trials that `results` were computed from.
    styles : dict of str to DesignStyle
        Style of each design, by its name.
    folder : Path
        Folder of the figures.

    Returns
    -------
    list of WrittenFigure
        The figures written.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    figures = [
        *_example_figures(results, trials, styles),
        *_dynamic_figures(results, styles),
        *_static_figures(results, trials, styles),
        *_control_figures(results, trials),
    ]
    return [
        WrittenFigure(name, caption, _for_screen(save_figure(figure, folder / name), 256), narrow)
        for name, caption, narrow, figure in figures
    ]


# Name, caption, whether it is as wide as a column, the figure: drawn on demand, so that only one is in memory.
_Figures = Iterator[tuple[str, str, bool, Figure]]


def _example_figures(
    results: StudyResults, trials: Sequence[TrialData], styles: dict[str, DesignStyle]
) -> _Figures:
    """One trial large: the baseline's slowest at its largest pressure."""
    measured = _measured(results)
    own = measured[measured["design"] == results.baseline]
    order = (own if len(own) else measured).sort_values(
        ["frequency_hz", "pressure_pp_kpa"], ascending=[True, False], kind="stable"
    )
    example = next((trial for name in order["trial"] for trial in trials if trial.name == name), None)
    if example is None:
        return
    caption = f"{example.name}: bending angle and pressure over time."
    yield "time_series", caption, False, time_series_figure(example, styles[example.design])
    leaf = leaves_of(results).get(example.name, Leaf())
    caption = (
        f"{example.name}: {len(leaf.loops)} cycles and their mean. The hysteresis ratio is the area within the leaf "
        f"over the area of the dashed rectangle, which reaches to the axes."
    )
    if leaf.apart:
        caption += " Grey: the first cycle, which differs from the others and is left out of the numbers."
    figure = leaf_figure(
        leaf.loops,
        styles[example.design],
        largest_pressure_kpa=leaf.largest_pressure_kpa,
        largest_angle_deg=leaf.largest_angle_deg,
        apart=leaf.apart,
        note=leaf.note,
        title=example.name,
    )
    yield "leaf", caption, True, figure


def _dynamic_figures(results: StudyResults, styles: dict[str, DesignStyle]) -> _Figures:
    measured = _measured(results)
    placed = measured.dropna(subset=["frequency_hz", "pressure_pp_kpa"])
    if len(placed):
        caption = (
            "Angle against pressure of all dynamic trials, by frequency (rows) and peak-to-peak pressure (columns). "
            "A marker shows the tip of each design's leaf."
        )
        loops = {name: leaf.loops for name, leaf in leaves_of(results).items()}
        yield "leaves", caption, False, leaf_grid_figure(placed, loops, styles)
        caption = (
            f"Dynamic response (largest angle) and hysteresis ratio of every trial; whiskers are "
            f"{100 * results.confidence:g} % intervals."
        )
        yield "bars", caption, False, bars_figure(placed, styles)
    if len(measured.dropna(subset=["hysteresis_ratio", "frequency_hz"])):
        caption = (
            "Hysteresis ratio against largest angle; a design's trials are joined by straight lines, whiskers are "
            f"{100 * results.confidence:g} % intervals."
        )
        comparisons = best_comparisons(results.constant_angle)
        if len(comparisons):
            caption += " The dashed line is the angle at which designs are compared."
        yield "ratio_against_angle", caption, False, ratio_angle_figure(measured, comparisons, styles)


def _static_figures(
    results: StudyResults, trials: Sequence[TrialData], styles: dict[str, DesignStyle]
) -> _Figures:
    names = set(results.static_steps["trial"])
    static = [trial for trial in trials if trial.name in names]
    if static:
        caption = (
            "Angle held at each stair (marks, in the order of time), the model's curve (dashed), and measured minus "
            "model (below)."
        )
        yield "static_curves", caption, True, static_figure(results.static_steps, static, styles)


def _control_figures(results: StudyResults, trials: Sequence[TrialData]) -> _Figures:
    """The trial of the largest pressure of each wave: staircases first, slow before fast."""
    rmse_kpa = dict(zip(results.control["trial"], results.control["rmse_kpa"], strict=True))
    chosen: dict[tuple[bool, float], TrialData] = {}
    for trial in trials:
        wave = (trial.kind is Kind.DYNAMIC, trial.frequency_hz or 0.0)
        usual = chosen.get(wave, trial).pressure_pp_kpa or 0.0
        if trial.name in rmse_kpa and (wave not in chosen or (trial.pressure_pp_kpa or 0.0) > usual):
            chosen[wave] = trial
    shown = [chosen[wave] for wave in sorted(chosen)][:_MOST_WAVES]
    if shown:
        caption = (
            "Measured pressure on its reference wave, and the error (measured minus reference), for the trial of the "
            "largest pressure of each wave: " + ", ".join(trial.name for trial in shown) + "."
        )
        figure = control_figure(shown, [float(rmse_kpa[trial.name]) for trial in shown])
        yield "control_tracking", caption, False, figure


def _measured(results: StudyResults) -> pd.DataFrame:
    """Dynamic trials that have a value."""
    return results.dynamic.dropna(subset=["dynamic_response_deg"])


def start_trial_sheets(
    results: StudyResults,
    trials: Sequence[TrialData],
    styles: dict[str, DesignStyle],
    folder: Path,
    workers: int,
) -> TrialSheets:
    """Start to write a sheet for each trial, in `workers` other processes (0: in this one, when collected).

    Parameters
    ----------
    results : StudyResults
        Results of the study.
    trials : sequence of TrialData
        The trials that `results` were computed from.
    styles : dict of str to DesignStyle
        Style of each design, by its name.
    folder : Path
        Folder of the figures.
    workers : int
        Number of additional processes.

    Returns
    -------
    TrialSheets
        The sheets, to be used in a `with` block.
    """
    names = file_names(trial.name for trial in trials)
    leaves = leaves_of(results)
    jobs = [
        (trial, styles[trial.design], leaves.get(trial.name, Leaf()), folder / names[trial.name])
        for trial in trials
    ]
    return TrialSheets(jobs, workers)


class TrialSheets:
    """The sheets of a study's trials, being written. `collect` waits for them; leaving the `with` block ends all."""

    def __init__(self, jobs: list[tuple[TrialData, DesignStyle, Leaf, Path]], workers: int) -> None:
        self._jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._futures: list[Future[bytes]] = []
        if workers > 0 and len(jobs) > 1:
            # A fresh interpreter each: a fork of a process with threads (BLAS, a progress bar) may hang.
            self._pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"))
            self._futures = [self._pool.submit(write_sheet, *job) for job in jobs]

    def __enter__(self) -> TrialSheets:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def collect(self) -> dict[str, WrittenFigure]:
        """Every trial's sheet, by the trial's name.

        Returns
        -------
        dict of str to WrittenFigure
            The sheets written.

        Raises
        ------
        ResultsError
            A file cannot be written.
        """
        images: list[bytes] = []
        for index in reversed(range(len(self._jobs))):
            # Sheets not yet started are drawn in this process, from the last one on, so that none is idle.
            mine = not self._futures or self._futures[index].cancel()
            images.append(write_sheet(*self._jobs[index]) if mine else self._futures[index].result())
        images.reverse()
        return {
            trial.name: WrittenFigure(f"{stem.parent.name}/{stem.name}", "", png)
            for (trial, _, _, stem), png in zip(self._jobs, images, strict=True)
        }


def write_sheet(trial: TrialData, style: DesignStyle, leaf: Leaf, stem: Path) -> bytes:
    """Write one trial's sheet (PDF, PNG) and return its image for the report.

    Parameters
    ----------
    trial : TrialData
        The trial.
    style : DesignStyle
        Style of its design.
    leaf : Leaf
        Its leaf.
    stem : Path
        Path of the files, without suffix.

    Returns
    -------
    bytes
        A PNG.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    figure = trial_sheet_figure(
        trial,
        style,
        leaf.loops,
        largest_pressure_kpa=leaf.largest_pressure_kpa,
        largest_angle_deg=leaf.largest_angle_deg,
        apart=leaf.apart,
        note=leaf.note,
        sheet=_reused_sheet(len(leaf.loops) + len(leaf.apart) > 0),
    )
    # Half the size and 64 colours: one page may hold a hundred of them.
    return _for_screen(save_figure(figure, stem).reduce(2), 64)


@cache
def _reused_sheet(with_leaf: bool) -> Figure:
    """The figure that this process reuses for its sheets."""
    return blank_sheet(with_leaf)


def leaves_of(results: StudyResults) -> dict[str, Leaf]:
    """The leaf of every dynamic trial that has loops, by the trial's name.

    Parameters
    ----------
    results : StudyResults
        Results of the study.

    Returns
    -------
    dict of str to Leaf
        The leaves.
    """
    leaves = {}
    for row in results.dynamic.to_dict("records"):
        loops = results.loops.get(row["trial"], [])
        first_used = 1 if row["first_cycle_apart"] else 0
        ratio = interval_of(row, "hysteresis_ratio", 3) if math.isfinite(row["hysteresis_ratio"]) else ""
        if loops:
            leaves[row["trial"]] = Leaf(
                loops=tuple(loops[first_used:]),
                apart=tuple(loops[:first_used]),
                largest_pressure_kpa=float(row["largest_pressure_kpa"]),
                largest_angle_deg=float(row["dynamic_response_deg"]),
                note=f"ratio {ratio}" if ratio else "",
            )
    return leaves


def file_names(names: Iterable[str]) -> dict[str, str]:
    """A file name (without suffix) for each trial name: valid on every system, and unique.

    Parameters
    ----------
    names : iterable of str
        Names of the trials.

    Returns
    -------
    dict of str to str
        File name of each trial.

    Examples
    --------
    >>> file_names(["a b/40 kPa", "a b:40 kPa", "../up"])
    {'a b/40 kPa': 'a_b_40_kPa', 'a b:40 kPa': 'a_b_40_kPa-2', '../up': 'up'}
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        safe = "".join(char if char.isascii() and (char.isalnum() or char in "-_.") else "_" for char in name)
        stem = safe.strip("._-")[:_LONGEST_FILE_NAME] or "trial"
        candidate, number = stem, 2
        while candidate.casefold() in taken:
            candidate, number = f"{stem}-{number}", number + 1
        taken.add(candidate.casefold())
        found[name] = candidate
    return found


def _for_screen(image: Image.Image, colours: int) -> bytes:
    """The image as a PNG with a palette: a third of the size, with no visible difference."""
    data = io.BytesIO()
    image.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        data, format="PNG", compress_level=6
    )
    return data.getvalue()
