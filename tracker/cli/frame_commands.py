"""Commands about pictures to label: frames, and labels check."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from . import console
from .project_commands import ProjectArgument
from .tracking_runs import VideosArgument, listed_videos


class Spread(StrEnum):
    """What the chosen frames are spread evenly over."""

    PRESSURE = "pressure"
    APPEARANCE = "appearance"
    TIME = "time"


def frames(
    project: ProjectArgument,
    videos: VideosArgument,
    actuator: Annotated[
        str | None, typer.Option(help="Which actuator they show.", show_default="as bendtrack.toml says")
    ] = None,
    count: Annotated[int, typer.Option(help="New pictures of each actuator, over all its videos.")] = 30,
    pressure: Annotated[
        list[Path] | None,
        typer.Option(
            help="Pressure log, on the video's clock. For several videos: once for each, in their order, or a"
            " folder with logs named like the videos."
        ),
    ] = None,
    by: Annotated[
        Spread | None,
        typer.Option(help="What to spread them over.", show_default="pressure with a log, else appearance"),
    ] = None,
) -> None:
    """Choose frames to label that span the whole range of motion.

    They are saved as pictures in labeled-data/. Blurred, damaged and equal frames are passed over. Once more, and
    further frames fill the gaps that are left. Exit status 1 when a video could not be used.
    """
    from ...labeling.new_frames import add_frames
    from ...labeling.survey import By
    from ..project import Project
    from . import progress_bars

    report = add_frames(
        Project.open(project),
        listed_videos(videos),
        count=count,
        by=None if by is None else By(by),
        pressure_logs=pressure or (),
        actuator=actuator,
        counting=progress_bars.counting,
    )
    for warning in report.warnings:
        console.warn(warning)
    for video, pictures in report.saved.items():
        console.say(f"{video}: {len(pictures)} pictures -> {pictures[0].parent}")
    for name, (new, in_all) in report.actuators.items():
        console.say(f"{name}: {new} new pictures to label, {in_all} in all")
    for video, problem in report.failed.items():
        console.complain(f"{video}: {problem}")
    if report.failed:
        raise typer.Exit(1 if report.saved else 2)
    console.say(f"Next: bendtrack label {project}")


labels = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Look for mistakes in labels.")


@labels.callback()
def _labels() -> None:
    """Look for mistakes in labels."""


@labels.command("check")
def check(project: ProjectArgument) -> None:
    """Look for mistakes in the labels.

    Missing points, points outside or at one place, swapped ends, jumps in length, points far from where the other
    labels put them, a picture labelled twice. Each comes with what opens it on the label page (#VIDEO/IMAGE). Exit
    status 1 when there is something to look at.
    """
    from ...labeling.checks import check_labels
    from ..project import Project

    report = check_labels(Project.open(project))
    for note in report.notes:
        console.warn(note)
    for finding in report.findings:
        console.show(f"{finding.image_path}: {finding.problem}: {finding.message}  {finding.link}")
    count = len(report.findings)
    console.say(
        f"{report.labelled} labelled frames: {f'{count} to look at' if count else 'nothing to look at'}"
    )
    if count:
        raise typer.Exit(1)
