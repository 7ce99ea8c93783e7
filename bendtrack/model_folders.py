"""The trained networks of a project: models/<name>/, which one is meant, and what a new one is called.

A folder with weights is a finished network. One without them is a training that was stopped, or goes on. Networks have
the order of the times that they record themselves: times of files change with copies and with clocks.
"""

from __future__ import annotations

import json
import shlex
from datetime import UTC, datetime, timedelta
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from .reporting import SILENT, Reporter
from .tracker.errors import BendtrackError, CheckpointError, TrainingError
from .tracker.folder_lock import FolderInUseError, folder_lock
from .tracker.links import make_folder

if TYPE_CHECKING:
    from .tracker.project import Project

SETTINGS_FILE = "training-settings.json"
"""What the training was started with, so that --resume needs no other option."""

CROSS_VALIDATION = "cross-validation"
"""The folder in models/ that holds an evaluation by folds, and no network."""

STARTED = "started_at"
"""Entry of the settings' file: when the training was started or resumed, in ISO 8601."""

CLOCK_ERROR = timedelta(hours=1)
"""By how much two machines' clocks may differ before a network from the future is worth a warning."""

_DEFAULT_NAME = "model"


def finished(project: Project) -> list[Path]:
    """Folders of the finished networks, the newest last.

    Those that do not record when they were trained come first, since only earlier versions wrote such, in the order of
    their files' times.
    """
    from .models.inference.metadata import WEIGHTS_FILE

    found = [path for path in _folders(project) if (path / WEIGHTS_FILE).is_file()]
    return sorted(found, key=lambda path: _order(_trained_at(path), path / WEIGHTS_FILE))


def unfinished(project: Project) -> list[Path]:
    """Folders of the trainings that can go on, the one that was started or resumed last at the end."""
    from .models.inference.metadata import WEIGHTS_FILE
    from .models.training.state import STATE_FILE

    found = [
        path
        for path in _folders(project)
        if (path / SETTINGS_FILE).is_file()
        and ((path / STATE_FILE).is_file() or not (path / WEIGHTS_FILE).is_file())
    ]
    return sorted(found, key=lambda path: _order(_started_at(path), path / SETTINGS_FILE))


def in_use(folder: Path) -> bool:
    """Whether another process trains into a folder."""
    try:
        with folder_lock(folder, wait=False):
            return False
    except FolderInUseError:
        return True


def latest_training(project: Project) -> datetime | None:
    """When the newest network of a project was trained; None where none records it."""
    return max((time for time in map(_trained_at, finished(project)) if time is not None), default=None)


def start_of_training(project: Project) -> str:
    """The time that a training that starts now records, in ISO 8601: later than that of every unfinished one."""
    from .models.inference.metadata import later_than

    times = (_started_at(path) for path in unfinished(project))
    return later_than(max((time for time in times if time is not None), default=None))


def steps_to_labels(project: Project) -> list[str]:
    """The commands that lead to labels, in the order in which they are needed; none where there are labels.

    Parameters
    ----------
    project : tracker.project.Project
    """
    from .labeling.store import LabelStore

    root = shlex.quote(str(project.root))
    store = LabelStore.of(project)
    steps = []
    if not any(store.images(video) for video in store.videos()):
        steps.append(f"`bendtrack frames {root} VIDEO...` chooses frames")
    if not store.read():
        steps.append(f"`bendtrack label {root}` opens the page to label them")
    return steps


def chosen(project: Project, name: str | None, reporter: Reporter = SILENT) -> Path:
    """The folder of the network of that name, or of the newest.

    Parameters
    ----------
    project : tracker.project.Project
    name : str or None
        None takes the newest.
    reporter : Reporter
        Is warned where it is in doubt which is the newest.

    Returns
    -------
    Path

    Raises
    ------
    CheckpointError
        There is none, or one cannot be read, which may be the newest.
    """
    networks = finished(project)
    names = ", ".join(path.name for path in networks)
    if name is None:
        if not networks:
            raise CheckpointError(
                f"expected a trained network in {project.models_dir}, got none: "
                + ", ".join(
                    [
                        *steps_to_labels(project),
                        f"`bendtrack train {shlex.quote(str(project.root))}` trains one",
                    ]
                )
            )
        if len(networks) > 1:
            _say_doubt(networks, reporter)
        return networks[-1]
    folder = project.models_dir / _checked(name)
    if folder not in networks:
        raise CheckpointError(f"--model: expected one of {names or '(none yet)'}, got '{name}'")
    return folder


def new_folder(project: Project, name: str | None, overwrite: bool) -> Path:
    """Where a new network goes: its name, or else the first of model, model-2, ... that is free, which is made.

    Raises
    ------
    TrainingError
        The name is taken, and it is not to be overwritten.
    """
    if name is None:
        make_folder(project.models_dir, parents=False)
        names = (_DEFAULT_NAME if n == 1 else f"{_DEFAULT_NAME}-{n}" for n in count(1))
        return next(path for path in map(project.models_dir.joinpath, names) if _made(path))
    folder = project.models_dir / _checked(name)
    if folder.exists() and not overwrite:
        if folder in unfinished(project):
            raise TrainingError(
                f"--model: expected a new name, got '{name}', an unfinished training:"
                " go on with --resume, or begin anew with --overwrite"
            )
        raise TrainingError(
            f"--model: expected a new name, got '{name}', which is there already: choose another, or --overwrite"
        )
    return folder


def folder_to_resume(project: Project, name: str | None) -> Path:
    """The folder of the unfinished training of that name, or of the latest.

    Raises
    ------
    TrainingError
        There is none.
    """
    stopped = unfinished(project)
    if name is not None:
        stopped = [path for path in stopped if path.name == name]
    if not stopped:
        where = project.models_dir if name is None else project.models_dir / name
        raise TrainingError(f"--resume: expected an unfinished training in {where}, got none")
    return stopped[-1]


def _folders(project: Project) -> list[Path]:
    if not project.models_dir.is_dir():
        return []
    return [
        path
        for path in project.models_dir.iterdir()
        if path.is_dir() and not path.name.startswith(".") and path.name != CROSS_VALIDATION
    ]


def _made(path: Path) -> bool:
    """Make a folder; False where the name is taken, also by another process at this moment."""
    try:
        make_folder(path, parents=False, exist_ok=False)
    except FileExistsError:
        return False
    return True


def _trained_at(folder: Path) -> datetime | None:
    """When a network was trained; None where it does not record it or cannot be read."""
    from .models.inference.metadata import trained_at

    try:
        return trained_at(folder)
    except CheckpointError:
        return None


def _started_at(folder: Path) -> datetime | None:
    """When a training was started or resumed; None where its settings do not say so."""
    try:
        moment = datetime.fromisoformat(
            json.loads((folder / SETTINGS_FILE).read_text(encoding="utf-8"))[STARTED]
        )
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return None
    return moment if moment.tzinfo else None


def _order(moment: datetime | None, file: Path) -> tuple[bool, float, str]:
    """Sort key: by the time recorded; what records none comes first, by its file's time."""
    try:
        time_s = file.stat().st_mtime if moment is None else moment.timestamp()
    except OSError:  # removed at this moment
        time_s = 0.0
    return moment is not None, time_s, file.parent.name


def _say_doubt(networks: list[Path], reporter: Reporter) -> None:
    """Warn where the newest of several networks cannot be told for certain; refuse where one cannot be read."""
    from .models.inference.metadata import trained_at

    try:
        times = {path.name: trained_at(path) for path in networks}
    except CheckpointError as error:
        raise CheckpointError(
            f"{error}; it may be the newest network: --model names one that can be read"
        ) from error
    newest = networks[-1].name
    time = times[newest]
    if time is None:
        reporter.warn(
            f"took '{newest}', the newest of {len(networks)} networks by the time of its file, which copies change:"
            " none of them records when it was trained; --model names another"
        )
        return
    equal = [name for name, other in times.items() if other == time and name != newest]
    if equal:
        reporter.warn(
            f"took '{newest}', which was trained at the same moment as {', '.join(equal)} (a copy?);"
            " --model names another"
        )
    if time > datetime.now(UTC) + CLOCK_ERROR:
        reporter.warn(
            f"took '{newest}', the newest network, which was trained at {time:%Y-%m-%d %H:%M} UTC, later than this"
            " machine's clock says; --model names another"
        )


def _checked(name: str) -> str:
    """The name, if it can be a folder's everywhere."""
    if not name or name == CROSS_VALIDATION or name[0] in ". " or any(sign in name for sign in '/\\:*?"<>|'):
        raise BendtrackError(f"--model: expected letters, digits, and signs such as - _ ., got '{name}'")
    return name
