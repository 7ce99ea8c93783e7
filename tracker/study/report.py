"""The report of a study: figures, tables and one self-contained HTML page, written into a folder.

Its text comes from `findings.py`, `methods.py` and `paper_tables.py`; its HTML from `report_page.html` and
`report_parts.py`.
"""

from __future__ import annotations

import hashlib
import json
import platform
import string
from collections.abc import Mapping, Sequence
from dataclasses import fields
from html import escape
from importlib import resources
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ..atomic import atomic_write_text, remove_leftovers
from ..errors import ResultsError, reason
from ..links import make_folder
from ..results import json_ready
from .analysis import StudyResults
from .findings import main_findings
from .latex import latex_table
from .methods import DEFINITIONS, methods_text
from .number_text import MINUS, counted, plain_number
from .paper_tables import PaperTable, interval_of, paper_tables, with_unit
from .plots.figure_set import WrittenFigure, start_trial_sheets, write_study_figures
from .plots.styles import design_styles
from .report_parts import (
    Part,
    collapsed_html,
    contents_html,
    definitions_html,
    figure_html,
    legend_html,
    list_html,
    paragraph_html,
    part_html,
    table_html,
)
from .study_file import Study
from .tables import write_csv_tables
from .trial import Kind, TrialData

# Sections of the report: heading, anchor, tables, figures.
_SECTIONS: tuple[tuple[str, str, tuple[str, ...], tuple[str, ...]], ...] = (
    (
        "Hysteresis",
        "hysteresis",
        ("hysteresis_ratio_at_one_angle",),
        ("leaf", "leaves", "ratio_against_angle"),
    ),
    ("Dynamic response", "response", ("dynamic_response",), ("bars",)),
    ("Ranking", "ranking", ("ranking",), ()),
    ("Static curves", "static", ("static_against_model",), ("static_curves",)),
    ("Pressure control", "control", ("control",), ("control_tracking",)),
    ("All dynamic trials", "dynamic-trials", ("dynamic_trials",), ("time_series",)),
)
_LIBRARIES = ("bendtrack", "numpy", "scipy", "pandas", "matplotlib")


def write_report(
    results: StudyResults, trials: Sequence[TrialData], study: Study, out_dir: str | Path, *, workers: int = 0
) -> Path:
    """Write figures/*.pdf and *.png, tables/*.csv and *.tex, and report.html, each whole or not at all.

    The page is self-contained: its images are embedded and nothing is loaded from elsewhere.

    Parameters
    ----------
    results : StudyResults
        All tables of the study.
    trials : sequence of TrialData
        The trials that `results` were computed from.
    study : Study
        The study file.
    out_dir : str or Path
        Folder to write into, made with its parents.
    workers : int, optional
        Number of additional processes that draw the trials' own figures. Each starts its own Python, so a script
        that uses them needs the usual `if __name__ == "__main__":`.

    Returns
    -------
    Path
        Path of report.html.

    Raises
    ------
    ResultsError
        A file or folder cannot be written.
    """
    out = Path(out_dir)
    try:
        for folder in ("figures/trials", "tables"):
            make_folder(out / folder)
        for folder in (".", "figures", "figures/trials", "tables"):
            remove_leftovers(out / folder)
    except OSError as error:
        raise ResultsError(f"{out}: cannot be written ({reason(error)})") from error
    styles = design_styles((name, design.label, design.colour) for name, design in study.designs.items())
    labels = {name: design.label for name, design in study.designs.items()}
    with start_trial_sheets(results, trials, styles, out / "figures" / "trials", workers) as sheets:
        figures = write_study_figures(results, trials, styles, out / "figures")
        tables = paper_tables(results, labels)
        _write_tables(results, tables, out / "tables")
        trial_sheets = sheets.collect()
    page = _page(results, trials, study, figures, tables, trial_sheets)
    path = out / "report.html"
    _write(path, page)
    return path


def _write_tables(results: StudyResults, tables: Sequence[PaperTable], folder: Path) -> None:
    frames = {field.name: getattr(results, field.name) for field in fields(results)}
    write_csv_tables(
        {name: frame for name, frame in frames.items() if isinstance(frame, pd.DataFrame)}, folder
    )
    for table in tables:
        _write(folder / f"{table.name}.tex", latex_table(table))


def _write(path: Path, text: str) -> None:
    try:
        atomic_write_text(path, text)
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({reason(error)})") from error


def _page(
    results: StudyResults,
    trials: Sequence[TrialData],
    study: Study,
    figures: Sequence[WrittenFigure],
    tables: Sequence[PaperTable],
    sheets: Mapping[str, WrittenFigure],
) -> str:
    labels = {name: design.label for name, design in study.designs.items()}
    numbers = {figure.name: number for number, figure in enumerate(_in_page_order(figures), start=1)}
    parts = [Part("Summary", "summary", list_html(main_findings(results, labels), "findings"))]
    for heading, anchor, table_names, figure_names in _SECTIONS:
        shown = [table_html(table) for table in tables if table.name in table_names]
        shown += [
            _figure_html(figure, f"Figure {numbers[figure.name]}.")
            for name in figure_names
            for figure in figures
            if figure.name == name
        ]
        if shown:
            parts.append(Part(heading, anchor, "\n".join(shown)))
    parts.append(_trials_part(results, trials, labels, sheets))
    methods = "".join(paragraph_html(text) for text in methods_text(results))
    definitions = Part("Definitions", "definitions", definitions_html(DEFINITIONS))
    parts.append(Part("What was done", "methods", methods, (definitions,)))
    parts.append(_provenance_part(trials, study))
    used = [study.designs[name] for name in study.designs if any(trial.design == name for trial in trials)]
    page = string.Template(
        resources.files(__package__).joinpath("report_page.html").read_text(encoding="utf-8")
    )
    return page.substitute(
        version=escape(version("bendtrack")),
        title=escape(study.title),
        subtitle=escape(_subtitle(results, trials)),
        key=legend_html([(design.label, design.colour) for design in used]),
        contents=contents_html(parts),
        body="\n".join(part_html(part) for part in parts),
        footer=escape(
            f"Written by bendtrack {version('bendtrack')}. Every figure lies next to this page in figures/ "
            f"(PDF, PNG at 300 dpi), every table in tables/ (CSV, LaTeX)."
        ),
    )


def _in_page_order(figures: Sequence[WrittenFigure]) -> list[WrittenFigure]:
    order = [name for *_, names in _SECTIONS for name in names]
    return sorted(figures, key=lambda figure: order.index(figure.name))


def _figure_html(figure: WrittenFigure, number: str) -> str:
    return figure_html(
        figure.png,
        name=number,
        alt=figure.caption,
        caption=f"{figure.caption} (figures/{figure.name}.pdf)",
        css_class="column" if figure.narrow else "",
    )


def _subtitle(results: StudyResults, trials: Sequence[TrialData]) -> str:
    counts = {kind: sum(trial.kind is kind for trial in trials) for kind in Kind}
    parts = [counted(len({trial.design for trial in trials}), "design")]
    if counts[Kind.DYNAMIC]:
        used = int(results.cycles["used"].sum())
        parts.append(f"{counted(counts[Kind.DYNAMIC], 'dynamic trial')} with {counted(used, 'cycle')} used")
    if counts[Kind.STATIC]:
        parts.append(counted(counts[Kind.STATIC], "static trial"))
    parts.append(counted(sum(len(trial.time_s) for trial in trials), "frame"))
    return " · ".join(parts)


def _trials_part(
    results: StudyResults,
    trials: Sequence[TrialData],
    labels: Mapping[str, str],
    sheets: Mapping[str, WrittenFigure],
) -> Part:
    """Every trial, collapsed: its sheet, its warnings, how its clocks were synchronised."""
    warnings_of = (
        results.warnings.groupby("trial")["warning"].apply(list).to_dict() if len(results.warnings) else {}
    )
    values = {row["trial"]: row for row in results.dynamic.to_dict("records")}
    by_design: dict[str, list[str]] = {}
    for number, trial in enumerate(trials, start=1):
        warnings = warnings_of.get(trial.name, [])
        sheet = sheets[trial.name]
        gaps = (
            " Short bars on the time axis: frames without an angle."
            if np.isnan(trial.angle_deg).any()
            else ""
        )
        content = list_html(warnings, "warnings") + figure_html(
            sheet.png,
            name="",
            alt=f"{trial.name}: bending angle and pressure over time, and angle against pressure",
            caption=f"{_clock_caption(trial)}{gaps} (figures/{sheet.name}.pdf)",
        )
        nominal = [
            with_unit(float(value), unit)
            for value, unit in ((trial.frequency_hz, "Hz"), (trial.pressure_pp_kpa, "kPa"))
            if value is not None
        ]
        aside = [trial.kind.value, *nominal]
        if (
            trial.name in values
            and values[trial.name]["hysteresis_ratio"] == values[trial.name]["hysteresis_ratio"]
        ):
            aside.append(f"ratio {interval_of(values[trial.name], 'hysteresis_ratio', 3)}")
        mark = counted(len(warnings), "warning") if warnings else ""
        by_design.setdefault(trial.design, []).append(
            collapsed_html(trial.name, ", ".join(aside), mark, content, f"trial-{number}")
        )
    parts = tuple(
        Part(labels[design], f"design-{index}", "\n".join(items))
        for index, (design, items) in enumerate(by_design.items(), start=1)
    )
    count = counted(len(results.warnings), "warning")
    return Part(
        "Trials and warnings",
        "trials",
        paragraph_html(f"{count} in {counted(len(warnings_of), 'trial')}. A line opens with a click."),
        parts,
    )


def _clock_caption(trial: TrialData) -> str:
    delay_s = trial.shift.delay_s
    sign = MINUS if delay_s < 0 else "+"
    return (
        f"Clocks by {trial.shift.method}: video time = log time {sign} {plain_number(abs(delay_s), 4)} s, "
        f"with a standard uncertainty of {plain_number(trial.shift_sd_s, 4)} s."
    )


def _provenance_part(trials: Sequence[TrialData], study: Study) -> Part:
    try:
        study_hash = hashlib.sha256(study.path.read_bytes()).hexdigest()
    except OSError:
        study_hash = "not read"
    facts = [
        ("Study file", f"{study.path.name}, SHA-256 {study_hash}", ""),
        ("Versions", ", ".join(f"{name} {version(name)}" for name in _LIBRARIES), ""),
        ("Python", f"{platform.python_version()}, {platform.system()} {platform.machine()}", ""),
    ]
    entries = "".join(
        collapsed_html(trial.name, "", "", _json_html(trial.provenance), f"source-{number}")
        for number, trial in enumerate(trials, start=1)
    )
    files = Part("Files and settings of each trial", "sources", entries)
    return Part("Provenance", "provenance", definitions_html(facts), (files,))


def _json_html(values: Mapping[str, Any]) -> str:
    return f"<pre><code>{escape(json.dumps(json_ready(dict(values)), indent=1, ensure_ascii=False))}</code></pre>"
