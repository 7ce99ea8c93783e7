"""Writes all figures of a study and says what each shows. How each is drawn is its family's file."""

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
from .looks import Look
from .page import save_figure
from .ratio_angle import ratio_angle_figure
from .static_curves import static_figure
from .time_series import time_series_figure
from .trial_sheet import blank_sheet, trial_sheet

if TYPE_CHECKING:
    from ..analysis import StudyResults
    from ..trial import TrialData

_LONGEST_FILE_NAME = 80
# Waves of the control's figure: more would be too narrow.
_MOST_WAVES = 4


@dataclass(frozen=True)
class WrittenFigure:
    """A figure that was written: `name`.pdf and `name`.png in the figures' folder, and the picture for the report.

    Attributes
    ----------
    name : str
        Of the file, without its ending, relative to the figures' folder.
    caption : str
        What it shows.
    png : bytes
        A smaller picture for a screen.
    narrow : bool
        As wide as a column, not the page.
    """

    name: str
    caption: str
    png: bytes
    narrow: bool = False


@dataclass(frozen=True)
class Leaf:
    """What the drawing of a trial's leaf needs: cycles used and the one set apart, the rectangle, a note."""

    loops: tuple[FloatArray, ...] = ()
    apart: tuple[FloatArray, ...] = ()
    largest_pressure_kpa: float = math.nan
    largest_angle_deg: float = math.nan
    note: str = ""


def write_study_figures(
    results: StudyResults, trials: Sequence[TrialData], looks: dict[str, Look], folder: Path
) -> list[WrittenFigure]:
    """The figures of the whole study; a family without data is left out.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    figures = [
        *_example_figures(results, trials, looks),
        *_dynamic_figures(results, looks),
        *_static_figures(results, trials, looks),
        *_control_figures(results, trials),
    ]
    return [
        WrittenFigure(name, caption, _for_screen(save_figure(figure, folder / name), 256), narrow)
        for name, caption, narrow, figure in figures
    ]


# Name, caption, whether it is as wide as a column, the figure: drawn when it is asked for, so that one is held at once.
_Figures = Iterator[tuple[str, str, bool, Figure]]


def _example_figures(results: StudyResults, trials: Sequence[TrialData], looks: dict[str, Look]) -> _Figures:
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
    yield "time_series", caption, False, time_series_figure(example, looks[example.design])
    leaf = leaves_of(results).get(example.name, Leaf())
    caption = (
        f"{example.name}: {len(leaf.loops)} cycles and their mean. The hysteresis ratio is the area within the leaf "
        f"over the area of the dashed rectangle, which reaches to the axes."
    )
    if leaf.apart:
        caption += " Grey: the first cycle, which differs from the others and is left out of the numbers."
    figure = leaf_figure(
        leaf.loops,
        looks[example.design],
        largest_pressure_kpa=leaf.largest_pressure_kpa,
        largest_angle_deg=leaf.largest_angle_deg,
        apart=leaf.apart,
        note=leaf.note,
        title=example.name,
    )
    yield "leaf", caption, True, figure


def _dynamic_figures(results: StudyResults, looks: dict[str, Look]) -> _Figures:
    measured = _measured(results)
    placed = measured.dropna(subset=["frequency_hz", "pressure_pp_kpa"])
    if len(placed):
        caption = (
            "Angle against pressure of all dynamic trials, by frequency (rows) and peak-to-peak pressure (columns). "
            "A mark stands at the tip of each design's leaf."
        )
        loops = {name: leaf.loops for name, leaf in leaves_of(results).items()}
        yield "leaves", caption, False, leaf_grid_figure(placed, loops, looks)
        caption = (
            f"Dynamic response (largest angle) and hysteresis ratio of every trial; whiskers are "
            f"{100 * results.confidence:g} % intervals."
        )
        yield "bars", caption, False, bars_figure(placed, looks)
    if len(measured.dropna(subset=["hysteresis_ratio", "frequency_hz"])):
        caption = (
            "Hysteresis ratio against largest angle; a design's trials are joined by straight lines, whiskers are "
            f"{100 * results.confidence:g} % intervals. The dashed line stands where designs are compared at one angle."
        )
        comparisons = best_comparisons(results.constant_angle)
        yield "ratio_against_angle", caption, False, ratio_angle_figure(measured, comparisons, looks)


def _static_figures(results: StudyResults, trials: Sequence[TrialData], looks: dict[str, Look]) -> _Figures:
    names = set(results.static_steps["trial"])
    static = [trial for trial in trials if trial.name in names]
    if static:
        caption = (
            "Angle held at each stair (marks, in the order of time), the model's curve (dashed), and measured less "
            "model (below)."
        )
        yield "static_curves", caption, True, static_figure(results.static_steps, static, looks)


def _control_figures(results: StudyResults, trials: Sequence[TrialData]) -> _Figures:
    """Of each wave the trial of the largest pressure: staircases first, slow before fast."""
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
            "Measured pressure on its reference wave, and the error (measured less reference), for the trial of the "
            "largest pressure of each wave: " + ", ".join(trial.name for trial in shown) + "."
        )
        figure = control_figure(shown, [float(rmse_kpa[trial.name]) for trial in shown])
        yield "control_tracking", caption, False, figure


def _measured(results: StudyResults) -> pd.DataFrame:
    """Dynamic trials that have a value."""
    return results.dynamic.dropna(subset=["dynamic_response_deg"])


def start_trial_sheets(
    results: StudyResults, trials: Sequence[TrialData], looks: dict[str, Look], folder: Path, workers: int
) -> TrialSheets:
    """Begin to write a sheet for each trial, in `workers` other processes (0: in this one, when collected)."""
    names = file_names(trial.name for trial in trials)
    leaves = leaves_of(results)
    jobs = [
        (trial, looks[trial.design], leaves.get(trial.name, Leaf()), folder / names[trial.name])
        for trial in trials
    ]
    return TrialSheets(jobs, workers)


class TrialSheets:
    """The sheets of a study's trials, being written. `collect` waits for them; leaving the `with` block ends all."""

    def __init__(self, jobs: list[tuple[TrialData, Look, Leaf, Path]], workers: int) -> None:
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

        Raises
        ------
        ResultsError
            A file cannot be written.
        """
        pictures: list[bytes] = []
        for place in reversed(range(len(self._jobs))):
            # What nobody has begun, from the end on, is drawn here: no process waits while there is work.
            mine = not self._futures or self._futures[place].cancel()
            pictures.append(write_sheet(*self._jobs[place]) if mine else self._futures[place].result())
        pictures.reverse()
        return {
            trial.name: WrittenFigure(f"{stem.parent.name}/{stem.name}", "", png)
            for (trial, _, _, stem), png in zip(self._jobs, pictures, strict=True)
        }


def write_sheet(trial: TrialData, look: Look, leaf: Leaf, stem: Path) -> bytes:
    """Write one trial's sheet (PDF, PNG) and return its picture for the report."""
    figure = trial_sheet(
        trial,
        look,
        leaf.loops,
        largest_pressure_kpa=leaf.largest_pressure_kpa,
        largest_angle_deg=leaf.largest_angle_deg,
        apart=leaf.apart,
        note=leaf.note,
        paper=_paper(len(leaf.loops) + len(leaf.apart) > 0),
    )
    # Half the size and 64 colours: a hundred of them go into one page.
    return _for_screen(save_figure(figure, stem).reduce(2), 64)


@cache
def _paper(with_leaf: bool) -> Figure:
    """What this process draws its sheets on, one after the other."""
    return blank_sheet(with_leaf)


def leaves_of(results: StudyResults) -> dict[str, Leaf]:
    """The leaf of every dynamic trial that has loops, by the trial's name."""
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
    """A file name (without an ending) for each trial name: safe on every system, no two alike.

    >>> file_names(["a b/40 kPa", "a b:40 kPa", "../up"])
    {'a b/40 kPa': 'a_b_40_kPa', 'a b:40 kPa': 'a_b_40_kPa-2', '../up': 'up'}
    """
    found: dict[str, str] = {}
    taken: set[str] = set()
    for name in names:
        safe = "".join(sign if sign.isascii() and (sign.isalnum() or sign in "-_.") else "_" for sign in name)
        stem = safe.strip("._-")[:_LONGEST_FILE_NAME] or "trial"
        candidate, number = stem, 2
        while candidate.casefold() in taken:
            candidate, number = f"{stem}-{number}", number + 1
        taken.add(candidate.casefold())
        found[name] = candidate
    return found


def _for_screen(picture: Image.Image, colours: int) -> bytes:
    """The picture as a PNG with a palette: a third of the size, and no difference to the eye."""
    data = io.BytesIO()
    picture.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(
        data, format="PNG", compress_level=6
    )
    return data.getvalue()
