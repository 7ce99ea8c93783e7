"""Writes all figures of a study and says what each shows. How each is drawn is its family's file."""

from __future__ import annotations

import io
import math
import multiprocessing
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from ...types import FloatArray
from ..paper_tables import best_comparisons, interval_of
from .bars import bars_figure
from .control_tracking import control_figure
from .leaf import leaf_figure
from .leaf_grid import leaf_grid_figure
from .looks import Look
from .page import save_figure
from .ratio_angle import ratio_angle_figure
from .static_curves import static_figure
from .time_series import time_series_figure
from .trial_sheet import trial_sheet

if TYPE_CHECKING:
    from ..analysis import StudyResults
    from ..trial import TrialData

_LONGEST_FILE_NAME = 80


@dataclass(frozen=True)
class WrittenFigure:
    """A figure that was written: `name`.pdf and `name`.png in the figures' folder, and the picture for the report.

    Attributes
    ----------
    name : of the file, without its ending, relative to the figures' folder
    caption : what it shows
    png : a smaller picture for a screen
    narrow : as wide as a column, not the page
    """

    name: str
    caption: str
    png: bytes
    narrow: bool = False


@dataclass(frozen=True)
class Leaf:
    """What the drawing of a trial's leaf needs: cycles used and left out, the rectangle, a note."""

    loops: tuple[FloatArray, ...] = ()
    apart: tuple[FloatArray, ...] = ()
    largest_pressure_kpa: float = math.nan
    largest_angle_deg: float = math.nan
    note: str = ""


def write_study_figures(
    results: StudyResults,
    trials: Sequence[TrialData],
    looks: dict[str, Look],
    folder: Path,
    *,
    baseline: str | None,
) -> list[WrittenFigure]:
    """The figures of the whole study; a family without data is left out.

    Raises
    ------
    ResultsError
        A file cannot be written.
    """
    dynamic = results.dynamic
    measured = dynamic[dynamic["dynamic_response_deg"].notna()] if len(dynamic) else dynamic
    written = []
    example = _example(measured, trials, baseline)
    if example is not None:
        leaf = leaf_of(example.name, results)
        caption = f"{example.name}: bending angle and pressure over time."
        written.append(
            _write(time_series_figure(example, looks[example.design]), folder, "time_series", caption)
        )
        figure = leaf_figure(
            leaf.loops,
            looks[example.design],
            largest_pressure_kpa=leaf.largest_pressure_kpa,
            largest_angle_deg=leaf.largest_angle_deg,
            apart=leaf.apart,
            note=leaf.note,
            title=example.name,
        )
        caption = (
            f"{example.name}: {len(leaf.loops)} cycles and their mean. The hysteresis ratio is the area within "
            f"the leaf over the area of the dashed rectangle, which reaches to the axes."
        )
        if leaf.apart:
            caption += " Grey: complete cycles that the numbers leave out."
        written.append(_write(figure, folder, "leaf", caption, narrow=True))
    if len(measured):
        loops = {name: leaf_of(name, results).loops for name in measured["trial"]}
        if measured[["frequency_hz", "pressure_pp_kpa"]].notna().all(axis=1).any():
            caption = (
                "Angle against pressure of all dynamic trials, by frequency (rows) and peak-to-peak pressure "
                "(columns). A mark stands at the tip of each design's leaf."
            )
            written.append(_write(leaf_grid_figure(measured, loops, looks), folder, "leaves", caption))
            caption = (
                "Dynamic response (largest angle) and hysteresis ratio of every trial; whiskers are "
                f"{100 * results.confidence:g} % intervals."
            )
            written.append(_write(bars_figure(measured, looks), folder, "bars", caption))
        if measured["hysteresis_ratio"].notna().any() and measured["frequency_hz"].notna().any():
            caption = (
                "Hysteresis ratio against largest angle; a design's trials are joined by straight lines. The "
                "dashed line stands where designs are compared at one angle."
            )
            figure = ratio_angle_figure(measured, best_comparisons(results.constant_angle), looks)
            written.append(_write(figure, folder, "ratio_against_angle", caption))
    static_names = set(results.static_steps["trial"]) if len(results.static_steps) else set()
    static = [trial for trial in trials if trial.name in static_names]
    if static:
        caption = (
            "Angle held at each stair (marks, in the order of time), the model's curve (dashed), and measured less "
            "model (below)."
        )
        written.append(
            _write(
                static_figure(results.static_steps, static, looks),
                folder,
                "static_curves",
                caption,
                narrow=True,
            )
        )
    shown, rmse_kpa = _control_examples(results.control, trials)
    if shown:
        caption = (
            "Measured pressure on its reference wave, and the error (measured less reference), for the trial of the "
            "largest pressure of each wave: " + ", ".join(trial.name for trial in shown) + "."
        )
        written.append(_write(control_figure(shown, rmse_kpa), folder, "control_tracking", caption))
    return written


def start_trial_sheets(
    results: StudyResults, trials: Sequence[TrialData], looks: dict[str, Look], folder: Path, workers: int
) -> TrialSheets:
    """Begin to write a sheet for each trial, in `workers` other processes (0: in this one, when collected)."""
    names = file_names(trial.name for trial in trials)
    jobs = [
        (trial, looks[trial.design], leaf_of(trial.name, results), folder / names[trial.name])
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
        pictures = (
            [f.result() for f in self._futures] if self._pool else [write_sheet(*job) for job in self._jobs]
        )
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
    )
    # Half the size and 64 colours: a hundred of them go into one page.
    return _for_screen(save_figure(figure, stem).reduce(2), 64)


def leaf_of(name: str, results: StudyResults) -> Leaf:
    """A trial's leaf from the results; an empty one where it has none."""
    loops = results.loops.get(name, [])
    rows = results.dynamic[results.dynamic["trial"] == name] if len(results.dynamic) else results.dynamic
    if not len(loops) or rows.empty:
        return Leaf()
    row = rows.iloc[0]
    cycles = results.cycles[results.cycles["trial"] == name].sort_values("number")
    used = cycles["used"].to_numpy(bool) if len(cycles) == len(loops) else np.zeros(len(loops), bool)
    ratio = interval_of(row, "hysteresis_ratio", 3)
    return Leaf(
        loops=tuple(loop for loop, is_used in zip(loops, used, strict=True) if is_used),
        apart=tuple(loop for loop, is_used in zip(loops, used, strict=True) if not is_used),
        largest_pressure_kpa=float(row["largest_pressure_kpa"]),
        largest_angle_deg=float(row["dynamic_response_deg"]),
        note=f"ratio {ratio}" if math.isfinite(row["hysteresis_ratio"]) else "",
    )


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


def _write(figure: Figure, folder: Path, name: str, caption: str, *, narrow: bool = False) -> WrittenFigure:
    return WrittenFigure(name, caption, _for_screen(save_figure(figure, folder / name), 256), narrow)


def _for_screen(picture: Image.Image, colours: int) -> bytes:
    """The picture as a PNG with a palette: a third of the size, and no difference to the eye."""
    data = io.BytesIO()
    picture.quantize(colours, dither=Image.Dither.NONE).save(data, format="PNG", compress_level=6)
    return data.getvalue()


def _example(dynamic: pd.DataFrame, trials: Sequence[TrialData], baseline: str | None) -> TrialData | None:
    """The trial that is shown large: the baseline's slowest at its largest pressure."""
    if dynamic.empty:
        return None
    own = dynamic[dynamic["design"] == baseline]
    name = (
        (own if len(own) else dynamic)
        .sort_values(["frequency_hz", "pressure_pp_kpa"], ascending=[True, False], kind="stable")["trial"]
        .iloc[0]
    )
    return next(trial for trial in trials if trial.name == name)


def _control_examples(
    control: pd.DataFrame, trials: Sequence[TrialData]
) -> tuple[list[TrialData], list[float]]:
    """Of each wave the trial of the largest pressure (the first of several), staircases first, slow before fast."""
    if control.empty:
        return [], []
    rmse_kpa = dict(zip(control["trial"], control["rmse_kpa"], strict=True))
    chosen: dict[tuple[str, float], TrialData] = {}
    for trial in trials:
        if trial.log_reference_kpa is None or not math.isfinite(rmse_kpa.get(trial.name, math.nan)):
            continue
        wave = (trial.kind.value, trial.frequency_hz or 0.0)
        if wave not in chosen or (trial.pressure_pp_kpa or 0) > (chosen[wave].pressure_pp_kpa or 0):
            chosen[wave] = trial
    order = sorted(chosen, key=lambda wave: (wave[0] != "static", wave[1]))[:4]
    return [chosen[wave] for wave in order], [float(rmse_kpa[chosen[wave].name]) for wave in order]
