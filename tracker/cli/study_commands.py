"""The command about studies: analyze."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from ..errors import BendtrackError, StudyError
from . import console

_STUDY_FILE = "study.toml"
# More warnings than this stand in the report only, where they are by trial.
_MAX_WARNINGS = 20


def analyze(
    study: Annotated[
        Path | None, typer.Argument(help="The study file.", metavar="[STUDY.toml]", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for report, figures and tables.",
            metavar="FOLDER",
            show_default="STUDY-report next to the study file",
        ),
    ] = None,
    init: Annotated[
        Path | None,
        typer.Option(
            help=f"Write a first {_STUDY_FILE} for the logs, videos and angle tables in this folder. A log must lie"
            " inside the folder and be named like its video.",
            metavar="FOLDER",
            show_default="no new file",
        ),
    ] = None,
) -> None:
    """Analyse a study: cycles, hysteresis, tables, figures, report.

    Puts the angle tables and the pressure logs of a study together. The study file lists the trials; --init FOLDER
    writes a first one. The exit status is 1 when a trial failed; the others are done.
    """
    if (study is None) == (init is None):
        raise StudyError("expected a study file, or --init FOLDER to write a first one")
    if init is not None:
        _write_first(init)
    elif study is not None:
        _analyse(study, out)


def _next(folder: Path) -> str:
    """What to call with a folder, where a study file was expected."""
    if (folder / _STUDY_FILE).is_file():
        return f"Its study file: {console.command('analyze', folder / _STUDY_FILE)}"
    return f"{console.command('analyze', '--init', folder)} writes a first {_STUDY_FILE} into it"


def _write_first(folder: Path) -> None:
    from ..atomic import atomic_write_text, remove_leftovers
    from ..study.first_study import first_study_file
    from ..study.study_file import read_study

    path = folder / _STUDY_FILE
    if path.exists():
        raise StudyError(
            f"expected a folder without {_STUDY_FILE}, got one where it is: {folder}."
            f" {console.command('analyze', path)} analyses it"
        )
    text = first_study_file(folder)
    remove_leftovers(path.parent, path.stem)
    atomic_write_text(path, text)
    n_trials = len(read_study(path).trials)
    console.say(
        f"{path}: {n_trials} trial{'s' if n_trials > 1 else ''}. Look it over, then:"
        f" {console.command('analyze', path)}"
    )


def _analyse(path: Path, out: Path | None) -> None:
    from ...studies import analyse_file
    from ..links import make_folder
    from ..study.report import write_report
    from ..study.study_file import read_study
    from .reporter import ConsoleReporter

    if path.is_dir():
        raise StudyError(f"expected a study file, got a folder: {path}. {_next(path)}")
    folder = out or read_study(path).root / f"{path.stem}-report"
    make_folder(folder)  # now, not after a minute
    analysed = analyse_file(path, ConsoleReporter())
    study, trials, problems = analysed.study, analysed.trials, analysed.problems
    if analysed.results is not None:
        warnings = analysed.results.warnings
        for trial, warning in list(zip(warnings["trial"], warnings["warning"], strict=True))[:_MAX_WARNINGS]:
            console.warn(f"{trial}: {warning}")
        if len(warnings) > _MAX_WARNINGS:
            console.warn(f"{len(warnings) - _MAX_WARNINGS} more, in the report")
        report = write_report(analysed.results, trials, study, folder, workers=(os.cpu_count() or 1) - 1)
        console.say(f"{len(trials)} of {len(study.trials)} trials analysed -> {report}")
    if problems:
        others = "the others are done" if trials else "so nothing was analysed"
        console.complain(f"{len(problems)} of {len(study.trials)} trials failed, {others}:")
        for name, problem in problems.items():
            console.complain(f"{name}: {problem}")
        raise typer.Exit(1 if trials else BendtrackError.exit_status)
