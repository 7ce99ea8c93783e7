"""Commands about a project and its labels: new, import, export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console

if TYPE_CHECKING:
    from ...labeling.interop.importing import ImportReport

ProjectArgument = Annotated[Path, typer.Argument(help="The project's folder.", metavar="PROJECT")]

_KEYPOINTS = "base_1,base_2,tip_1,tip_2"


class LabelFormat(StrEnum):
    """Foreign forms of labels; those of `bendtrack.labeling.interop.formats`."""

    DLC = "dlc"
    COCO = "coco"
    SLEAP = "sleap"
    LIGHTNING_POSE = "lightning-pose"


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
    console.say(
        f"{made.root}: a new project of {', '.join(made.keypoints)} ({made.settings.angle.definition}).\n"
        f"Labels of DeepLabCut, COCO, SLEAP and Lightning Pose come in with `bendtrack import {made.root} SOURCE`."
    )


def import_labels(
    project: ProjectArgument,
    source: Annotated[
        Path,
        typer.Argument(
            help="A DeepLabCut or Lightning Pose project, a folder with labeled-data/, a label file (CSV, .h5), "
            "COCO keypoints (json), or SLEAP labels (.slp)."
        ),
    ],
    format: Annotated[LabelFormat | None, typer.Option(help="Whose form.", show_default="recognised")] = None,
    images: Annotated[
        Path | None,
        typer.Option(help="Where the pictures are that the labels name.", show_default="beside the labels"),
    ] = None,
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
    """Take over the labels of another program.

    DeepLabCut, COCO, SLEAP or Lightning Pose. A project that is not there is made.
    """
    from ...labeling.interop.formats import open_labels
    from ...labeling.interop.importing import import_source, project_of
    from ..errors import LabelError

    found = open_labels(source, format, images)
    report = import_source(found, project_of(project, found), videos=video or (), overwrite=overwrite)
    print_report(report)
    if not report.labelled and not report.unchanged:
        raise LabelError(f"{source}: expected labelled frames, got none that could be taken over")
    if report.skipped:
        raise typer.Exit(1)
    console.say(f"Next: bendtrack train {project}")


def print_report(report: ImportReport) -> None:
    """What an import did; what it left out comes last."""
    for warning in report.warnings:
        console.warn(warning)
    console.say(report.summary())
    for reason in report.skipped:
        console.warn(f"left out: {reason}")


def export_labels(
    project: ProjectArgument,
    out: Annotated[Path, typer.Argument(help="A folder that is new or empty; for SLEAP a new .slp file.")],
    format: Annotated[
        LabelFormat | None,
        typer.Option(help="Whose form.", show_default="dlc; sleap where OUT ends in .slp"),
    ] = None,
    video: Annotated[
        list[Path] | None,
        typer.Option(help="A video to name in it (dlc, sleap). May be given more than once."),
    ] = None,
) -> None:
    """Write the labels as another program's.

    DeepLabCut, COCO, SLEAP or Lightning Pose.
    """
    from ...labeling.interop import formats
    from ..project import Project

    report = formats.export_labels(Project.open(project), out, format, videos=video or ())
    for warning in report.warnings:
        console.warn(warning)
    console.say(f"{out}: {report.labelled} labelled frames and {report.images} pictures")
