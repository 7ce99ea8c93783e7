"""Commands about a project and its labels: new, import, export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .arguments import ProjectArgument, check_order, opened

if TYPE_CHECKING:
    from ...labeling.interop.importing import ImportReport

_KEYPOINTS = "base_1,base_2,tip_1,tip_2"


class LabelFormat(StrEnum):
    """Formats of other programs' labels; those of `bendtrack.labeling.interop.formats`."""

    DLC = "dlc"
    COCO = "coco"
    SLEAP = "sleap"
    LIGHTNING_POSE = "lightning-pose"


def new(
    project: Annotated[Path, typer.Argument(help="The folder to make.", metavar="PROJECT")],
    keypoints: Annotated[
        str,
        typer.Option(
            help="Names of the points to label, from the fixed end to the moving end, with commas between them.",
            metavar="NAMES",
        ),
    ] = _KEYPOINTS,
    angle: Annotated[
        str | None,
        typer.Option(
            help="Definition of the bending angle: two-vector, three-point, chord or arc-fit.",
            metavar="DEFINITION",
            show_default="two-vector; three-point for three keypoints",
        ),
    ] = None,
) -> None:
    """Make a new project."""
    from ...project import new_project

    names = [name.strip() for name in keypoints.split(",")]
    made = new_project(project, keypoints=names, angle=angle)
    console.say(
        f"{made.path}: a new project of {', '.join(made.keypoints)} ({made.settings.angle.definition}).\n"
        f"Next: {console.command('frames', project)} VIDEO...\n"
        f"Labels of DeepLabCut, COCO, SLEAP or Lightning Pose: {console.command('import', project)} SOURCE"
    )


def import_labels(
    project: ProjectArgument,
    source: Annotated[
        Path,
        typer.Argument(
            help="A DeepLabCut or Lightning Pose project, a folder with labeled-data/, a label file (CSV, .h5), "
            "COCO keypoints (json), or SLEAP labels (.slp).",
            metavar="SOURCE",
        ),
    ],
    format: Annotated[
        LabelFormat | None,
        typer.Option(
            help="Format of the source: dlc, coco, sleap or lightning-pose.",
            metavar="FORMAT",
            show_default="recognised from the source",
        ),
    ] = None,
    images: Annotated[
        Path | None,
        typer.Option(
            help="Folder with the images that the labels name.",
            metavar="FOLDER",
            show_default="next to the labels",
        ),
    ] = None,
    video: Annotated[
        list[Path] | None,
        typer.Option(
            help="A video to take images from that the source lacks. May be given more than once.",
            metavar="VIDEO",
        ),
    ] = None,
    overwrite: Annotated[
        bool,
        typer.Option("--overwrite", help="Where both have labels for a frame, take those of the source."),
    ] = False,
) -> None:
    """Take over the labels of another program.

    DeepLabCut, COCO, SLEAP or Lightning Pose. If there is no project yet, it is made.
    """
    from ...labeling.interop.formats import open_labels
    from ...labeling.interop.importing import import_source, project_of
    from ..errors import LabelError

    # A name that is not there yet becomes a project, unless it is called like labels.
    if project.exists() or project.suffix.lower() in (".csv", ".h5", ".json", ".slp"):
        check_order(project, (source,))
    found = open_labels(source, format, images)
    report = import_source(found, project_of(project, found), videos=video or (), overwrite=overwrite)
    print_report(report)
    if not report.labelled and not report.unchanged:
        raise LabelError(f"{source}: expected labelled frames, got none that could be taken over")
    if report.skipped:
        raise typer.Exit(1)
    console.say(f"Next: {console.command('train', project)}")


def print_report(report: ImportReport) -> None:
    """Print what an import did; what it left out comes last."""
    for warning in report.warnings:
        console.warn(warning)
    console.say(report.summary())
    for reason in report.skipped:
        console.warn(f"left out: {reason}")


def export_labels(
    project: ProjectArgument,
    out: Annotated[
        Path, typer.Argument(help="A folder that is new or empty; for SLEAP a new .slp file.", metavar="OUT")
    ],
    format: Annotated[
        LabelFormat | None,
        typer.Option(
            help="Format to write: dlc, coco, sleap or lightning-pose.",
            metavar="FORMAT",
            show_default="dlc; sleap where OUT ends in .slp",
        ),
    ] = None,
    video: Annotated[
        list[Path] | None,
        typer.Option(
            help="A video that the export names as the source of frames (dlc, sleap). May be given more than once.",
            metavar="VIDEO",
        ),
    ] = None,
) -> None:
    """Write the labels in the format of another program.

    DeepLabCut, COCO, SLEAP or Lightning Pose.
    """
    report = opened(project, out).export(out, format=format, videos=video or ())
    for warning in report.warnings:
        console.warn(warning)
    console.say(f"{out}: {report.labelled} labelled frames and {report.images} pictures")
