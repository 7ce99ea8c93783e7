"""A study file becomes numbers: its trials are read and analysed. The report is in `tracker.study.report`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .reporting import SILENT, Reporter
from .tracker.errors import BendtrackError, StudyError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .tracker.study.analysis import StudyResults
    from .tracker.study.study_file import Study
    from .tracker.study.trial import TrialData


@dataclass(frozen=True)
class AnalysedStudy:
    """A study with all that could be read of it.

    Attributes
    ----------
    study : Study
        The study file.
    trials : list of TrialData
        The trials that could be read.
    problems : Mapping of str to str
        Name of a trial that could not be read -> why.
    results : StudyResults or None
        All numbers; None where no trial could be read.
    """

    study: Study
    trials: list[TrialData]
    problems: Mapping[str, str]
    results: StudyResults | None


def analyse(study: str | Path, *, reporter: Reporter = SILENT) -> StudyResults:
    """Analyse a study: angle tables and pressure logs become cycles, hysteresis and comparisons. Nothing is written.

    Parameters
    ----------
    study : str or Path
        The study file (study.toml).
    reporter : Reporter
        Is warned of trials that cannot be read, and of what the data cannot carry.

    Returns
    -------
    StudyResults
        Tables: `dynamic` (one row a dynamic trial), `cycles`, `static`, `constant_angle`, `improvements`, `ranking` ...

    Raises
    ------
    StudyError
        The study file is malformed, or none of its trials can be read.

    Examples
    --------
    >>> import bendtrack as bt
    >>> bt.analyse("study.toml").dynamic[["design", "hysteresis_ratio"]]  # doctest: +SKIP
    """
    analysed = analyse_file(Path(study), reporter)
    for name, problem in analysed.problems.items():
        reporter.warn(f"trial '{name}' left out: {problem}")
    if analysed.results is None:
        raise StudyError(f"{study}: expected at least one trial that can be read, got none")
    return analysed.results


def analyse_file(path: Path, reporter: Reporter = SILENT) -> AnalysedStudy:
    """Read a study file and its trials, and analyse those that can be read.

    Parameters
    ----------
    path : Path
        The study file.
    reporter : Reporter
        Is told how far it is.

    Returns
    -------
    AnalysedStudy
        Results, and what is missing from them.

    Raises
    ------
    StudyError
        The study file is malformed.
    """
    from .tracker.study.analysis import analyse_study
    from .tracker.study.study_file import read_study
    from .tracker.study.trial_data import load_trial

    study = read_study(path)
    trials: list[TrialData] = []
    problems: dict[str, str] = {}
    with reporter.counting("reading", "trials") as progress:
        for number, settings in enumerate(study.trials, 1):
            try:
                trials.append(load_trial(study, settings))
            except (BendtrackError, OSError) as error:
                problems[settings.name] = str(error).removeprefix(f"trial '{settings.name}': ")
            progress(number, len(study.trials))
    if not trials:
        return AnalysedStudy(study, trials, problems, None)
    baseline = study.baseline
    if baseline not in (None, *(trial.design for trial in trials)):
        reporter.warn(f"no trial of the baseline '{baseline}' could be read: nothing is compared with it")
        baseline = None
    results = analyse_study(trials, baseline=baseline, angles_deg=study.compare_angles_deg or None)
    return AnalysedStudy(study, trials, problems, results)
