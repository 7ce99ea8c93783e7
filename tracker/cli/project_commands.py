"""Commands about a project and its labels: new, import, export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import talk

if TYPE_CHECKING:
    from ...labeling.interop.dlc import ImportReport

ProjectArgument = Annotated[Path, typer.Argument(help="The project's folder.", metavar="PROJECT")]

_KEYPOINTS = "base_1,base_2,tip_1,tip_2"


class LabelFormat(StrEnum):
    """Foreign forms of labels that can be written."""

    DLC = "dlc"


def new(
    project: ProjectArgument,
    keypoints: Annotated[
        str, typer.Option(help="Names of the points to label, base to tip, with commas between.")
    ] = _KEYPOINTS,
    angle: Annotated[
        str | None, typer.Option(help="two-vector, three-point, chord or arc-fit.", show_default="two-vector")
    ] = None,
) -> None:
    """Make a new project."""
    from ..project import Project

    names = [name.strip() for name in keypoints.split(",")]
    made = Project.create(project, keypoints=names, angle=angle)
    talk.say(
        f"{made.root}: a new project of {', '.join(made.keypoints)} ({made.settings.angle.definition}).\n"
        f"Labels of DeepLabCut come in with `bendtrack import {made.root} SOURCE`."
    )


def import_labels(
    project: ProjectArgument,
    source: Annotated[
        Path,
        typer.Argument(help="A DeepLabCut project, a folder with labeled-data/, or a label file (CSV)."),
    ],
    video: Annotated[
        list[Path] | None,
        typer.Option(
            help="A video to take pictures from that the source lacks. May be given more than once."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Where both label a frame, the source counts.")
    ] = False,
) -> None:
    """Take over the labels of a DeepLabCut project or folder. A project that is not there is made."""
    from ...labeling.interop.dlc import import_dlc, project_for
    from ..errors import LabelError

    opened = project_for(project, source)
    report = import_dlc(source, opened, videos=video or (), overwrite=overwrite)
    print_report(report)
    if not report.labelled and not report.unchanged:
        raise LabelError(f"{source}: expected labelled frames, got none that could be taken over")
    if report.skipped:
        raise typer.Exit(1)
    talk.say(f"Next: bendtrack train {project}")


def print_report(report: ImportReport) -> None:
    """What an import did; what it left out comes last."""
    for warning in report.warnings:
        talk.warn(warning)
    talk.say(report.summary())
    for reason in report.skipped:
        talk.warn(f"left out: {reason}")


def export_labels(
    project: ProjectArgument,
    out: Annotated[Path, typer.Argument(help="A folder that is new or empty.")],
    format: Annotated[LabelFormat, typer.Option(help="Whose form.")] = LabelFormat.DLC,
    video: Annotated[
        list[Path] | None, typer.Option(help="A video to name in it. May be given more than once.")
    ] = None,
) -> None:
    """Write the labels as a DeepLabCut project."""
    from ...labeling.interop.dlc_export import export_dlc
    from ..project import Project

    report = export_dlc(Project.open(project), out, videos=video or ())
    for warning in report.warnings:
        talk.warn(warning)
    talk.say(f"{out}: {report.labelled} labelled frames and {report.images} pictures in DeepLabCut's layout")
