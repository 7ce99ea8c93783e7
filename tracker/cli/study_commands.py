"""The command about studies: analyze."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import BendtrackError, StudyError
from . import console

if TYPE_CHECKING:
    from ..study.study_file import Study
    from ..study.trial import TrialData

_STUDY_FILE = "study.toml"
# More warnings than this stand in the report only, where they are by trial.
_MAX_WARNINGS = 20


def analyze(
    study: Annotated[
        Path | None, typer.Argument(help="The study file.", metavar="STUDY.toml", show_default=False)
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Where report, figures and tables go.", show_default="STUDY-report beside the study"
        ),
    ] = None,
    init: Annotated[
        Path | None,
        typer.Option(
            help=f"Write a first {_STUDY_FILE} for the files in this folder, by their names.",
            metavar="FOLDER",
        ),
    ] = None,
) -> None:
    """Hysteresis, tables, figures and a report of a study.

    Puts angle tables and pressure logs together.

    The study file lists the trials; a first one comes from --init FOLDER. Exit status 1 when a trial
    failed; the others are done.
    """
    if (study is None) == (init is None):
        raise StudyError("expected a study file, or --init FOLDER to write a first one")
    if init is not None:
        _write_first(init)
    elif study is not None:
        _analyse(study, out)


def _write_first(folder: Path) -> None:
    from ..atomic import atomic_write_text
    from ..study.first_study import first_study_file
    from ..study.study_file import read_study

    path = folder / _STUDY_FILE
    if path.exists():
        raise StudyError(f"expected a folder without {_STUDY_FILE}, got one where it is: {folder}")
    text = first_study_file(folder)
    atomic_write_text(path, text)
    n_trials = len(read_study(path).trials)
    console.say(
        f"{path}: {n_trials} trial{'s' if n_trials > 1 else ''}. Look it over, then: bendtrack analyze {path}"
    )


def _analyse(path: Path, out: Path | None) -> None:
    from ..study.analysis import analyse_study
    from ..study.report import write_report
    from ..study.study_file import read_study

    study = read_study(path)
    folder = out or study.root / f"{path.stem}-report"
    folder.mkdir(parents=True, exist_ok=True)  # now, not after a minute
    trials, problems = _loaded(study)
    if trials:
        baseline = study.baseline
        if baseline not in (None, *(trial.design for trial in trials)):
            console.warn(f"no trial of the baseline '{baseline}' could be read: nothing is compared with it")
            baseline = None
        results = analyse_study(trials, baseline=baseline, angles_deg=study.compare_angles_deg or None)
        warnings = results.warnings
        for trial, warning in list(zip(warnings["trial"], warnings["warning"], strict=True))[:_MAX_WARNINGS]:
            console.warn(f"{trial}: {warning}")
        if len(warnings) > _MAX_WARNINGS:
            console.warn(f"{len(warnings) - _MAX_WARNINGS} more, in the report")
        report = write_report(results, trials, study, folder, workers=(os.cpu_count() or 1) - 1)
        console.say(f"{len(trials)} of {len(study.trials)} trials analysed -> {report}")
    if problems:
        others = "the others are done" if trials else "so nothing was analysed"
        console.complain(f"{len(problems)} of {len(study.trials)} trials failed, {others}:")
        for name, problem in problems.items():
            console.complain(f"{name}: {problem}")
        raise typer.Exit(1 if trials else BendtrackError.exit_status)


def _loaded(study: Study) -> tuple[list[TrialData], dict[str, str]]:
    """The trials that can be read, and why the others cannot."""
    from ..study.trial_data import load_trial
    from . import progress_bars

    trials: list[TrialData] = []
    problems: dict[str, str] = {}
    with progress_bars.counting("reading", "trials") as progress:
        for number, settings in enumerate(study.trials, 1):
            try:
                trials.append(load_trial(study, settings))
            except (BendtrackError, OSError) as error:
                problems[settings.name] = str(error).removeprefix(f"trial '{settings.name}': ")
            progress(number, len(study.trials))
    return trials, problems
