"""Commands about frames to label: frames, and labels check."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from . import console
from .app import Command
from .arguments import ProjectArgument, VideosArgument, opened


class Spread(StrEnum):
    """What the chosen frames are spread evenly over."""

    PRESSURE = "pressure"
    APPEARANCE = "appearance"
    TIME = "time"


def frames(
    project: ProjectArgument,
    videos: VideosArgument,
    actuator: Annotated[
        str | None,
        typer.Option(
            help="Name of the actuator that the videos show.",
            metavar="NAME",
            show_default="as bendtrack.toml says",
        ),
    ] = None,
    count: Annotated[
        int,
        typer.Option(help="Number of new images for each actuator, over all its videos.", metavar="N"),
    ] = 30,
    pressure: Annotated[
        list[Path] | None,
        typer.Option(
            help="Pressure log, on the clock of the video. For several videos: give it once for each video, in"
            " their order, or give a folder with logs named like the videos.",
            metavar="LOG",
        ),
    ] = None,
    by: Annotated[
        Spread | None,
        typer.Option(
            help="What to spread the frames over: pressure, appearance or time.",
            metavar="WHAT",
            show_default="pressure with a log, else appearance",
        ),
    ] = None,
) -> None:
    """Choose frames to label that span the whole range of motion.

    They are saved as images in labeled-data/. Blurred and damaged frames are skipped, and so are frames that look the
    same. When the command is run again, further frames fill the gaps. The exit status is 1 when a video could not be
    used.
    """
    report = opened(project, *videos).add_frames(
        videos, count=count, by=by, pressure=pressure or (), actuator=actuator
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
    console.say(f"Next: {console.command('label', project)}")


labels = typer.Typer(no_args_is_help=True, rich_markup_mode=None, help="Look for mistakes in labels.")


@labels.callback()
def _labels() -> None:
    """Look for mistakes in labels."""


@labels.command("check", cls=Command)
def check(project: ProjectArgument) -> None:
    """Look for mistakes in the labels.

    Missing points, points outside the image, two points at one place, swapped ends, jumps in length, points far from
    where the other labels put them, an image labelled twice. Each finding comes with the address that opens it on the
    label page (#VIDEO/IMAGE). The exit status is 1 when something was found.
    """
    from ...labeling.checks import check_labels

    report = check_labels(opened(project).folder)
    for note in report.notes:
        console.warn(note)
    for finding in report.findings:
        console.show(f"{finding.image_path}: {finding.problem}: {finding.message}  {finding.link}")
    count = len(report.findings)
    if count:
        console.say(
            f"To open one: start {console.command('label', project)}, and put what begins with # behind the page's"
            " address (http://127.0.0.1:PORT/#...)"
        )
    console.say(
        f"{report.labelled} labelled frames with {report.points} points:"
        f" {f'{count} to look at' if count else 'nothing to look at'}"
    )
    if count:
        raise typer.Exit(1)
