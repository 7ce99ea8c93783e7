"""The trained networks of a project: models/<name>/, which one is meant, and what a new one is called.

A folder with weights is a finished network. One without them is a training that was stopped.
"""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from .tracker.errors import BendtrackError, CheckpointError, TrainingError

if TYPE_CHECKING:
    from .tracker.project import Project

SETTINGS_FILE = "training-settings.json"
"""What the training was started with, so that --resume needs no other option."""

CROSS_VALIDATION = "cross-validation"
"""The folder in models/ that holds an evaluation by folds, and no network."""

_DEFAULT_NAME = "model"


def finished(project: Project) -> list[Path]:
    """Folders of the finished networks, the newest last."""
    from .models.inference.metadata import WEIGHTS_FILE

    found = [path for path in _folders(project) if (path / WEIGHTS_FILE).is_file()]
    return sorted(found, key=lambda path: ((path / WEIGHTS_FILE).stat().st_mtime_ns, path.name))


def unfinished(project: Project) -> list[Path]:
    """Folders of the trainings that can go on, the latest last."""
    from .models.inference.metadata import WEIGHTS_FILE
    from .models.training.state import STATE_FILE

    found = [
        path
        for path in _folders(project)
        if (path / SETTINGS_FILE).is_file()
        and ((path / STATE_FILE).is_file() or not (path / WEIGHTS_FILE).is_file())
    ]
    return sorted(found, key=lambda path: ((path / SETTINGS_FILE).stat().st_mtime_ns, path.name))


def chosen(project: Project, name: str | None) -> Path:
    """The folder of the network of that name, or of the newest.

    Raises
    ------
    CheckpointError
        There is none.
    """
    networks = finished(project)
    names = ", ".join(path.name for path in networks)
    if name is None:
        if not networks:
            raise CheckpointError(
                f"expected a trained network in {project.models_dir}, got none: run `bendtrack train` first"
            )
        return networks[-1]
    folder = project.models_dir / _checked(name)
    if folder not in networks:
        raise CheckpointError(f"--model: expected one of {names or '(none yet)'}, got '{name}'")
    return folder


def new_folder(project: Project, name: str | None, overwrite: bool) -> Path:
    """Where a new network goes: its name, or else the first of model, model-2, ... that is free.

    Raises
    ------
    TrainingError
        The name is taken, and it is not to be overwritten.
    """
    if name is None:
        names = (_DEFAULT_NAME if n == 1 else f"{_DEFAULT_NAME}-{n}" for n in count(1))
        return next(path for path in map(project.models_dir.joinpath, names) if not path.exists())
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


def _checked(name: str) -> str:
    """The name, if it can be a folder's everywhere."""
    if not name or name == CROSS_VALIDATION or name[0] in ". " or any(sign in name for sign in '/\\:*?"<>|'):
        raise BendtrackError(f"--model: expected letters, digits, and signs such as - _ ., got '{name}'")
    return name
