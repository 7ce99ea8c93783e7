"""Arguments and options that several commands share, and the project that a command was given."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import BendtrackError
from . import console

if TYPE_CHECKING:
    from ...project import Project

SETTINGS_FILE = "bendtrack.toml"
"""As in `tracker.project`, which takes too long to load for --help."""

ProjectArgument = Annotated[Path, typer.Argument(help="The project's folder.", metavar="PROJECT")]
VideosArgument = Annotated[
    list[str],
    typer.Argument(
        help="Video files, folders of videos, or patterns such as 'day1/*.mp4'.", metavar="VIDEO..."
    ),
]
OverlayOption = Annotated[
    bool,
    typer.Option(
        "--overlay", help="Also write NAME.overlay.mp4: the video with points and angle drawn on it."
    ),
]
ForceOption = Annotated[
    bool, typer.Option("--force", help="Measure every video again, also those that are up to date.")
]
ModelOption = Annotated[
    str | None,
    typer.Option(
        help="Name of the network to use, a folder in PROJECT/models.",
        metavar="NAME",
        show_default="the newest",
    ),
]
EngineOption = Annotated[
    str,
    typer.Option(
        help="How the network is computed: auto, openvino-int8, openvino or torch. auto takes the fastest that is"
        " exact.",
        metavar="ENGINE",
    ),
]
DeviceOption = Annotated[
    str,
    typer.Option(
        help="What the network is computed on: auto, cpu or cuda. auto takes a GPU where there is one.",
        metavar="DEVICE",
    ),
]
ThreadsOption = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processor cores for the network.", metavar="N", show_default="all"),
]


def opened(project: Path, *others: str | Path) -> Project:
    """Open the project that a command was given.

    Parameters
    ----------
    project : Path
        What stands in the place of PROJECT.
    *others : str or Path
        What else the command was given, to see whether the order is wrong.

    Returns
    -------
    Project
        The front door's, which reports to the terminal.

    Raises
    ------
    BendtrackError
        PROJECT is no project, but one of the others is.
    ProjectError
        PROJECT is no project.
    """
    check_order(project, others)
    from ...project import Project
    from ..project import Project as ProjectFolder
    from .reporter import ConsoleReporter

    return Project(ProjectFolder.open(project), ConsoleReporter())


def check_order(project: Path, others: Sequence[str | Path]) -> None:
    """See that PROJECT comes first.

    Parameters
    ----------
    project : Path
        What stands in the place of PROJECT.
    others : sequence of str or Path
        What else the command was given.

    Raises
    ------
    BendtrackError
        PROJECT is no project, but one of the others is.
    """
    if (project / SETTINGS_FILE).is_file():
        return
    for other in others:
        if (Path(other) / SETTINGS_FILE).is_file():
            rest = [str(one) for one in others if one is not other]
            begun = console.command_begun()
            wanted = console.command(*begun, str(other), str(project), *rest)
            raise BendtrackError(
                f"expected the project first, got {project} and then the project {other}:"
                f" did you swap them? `{wanted}`"
            )
