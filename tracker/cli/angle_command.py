"""The command `angle`: angle over time without labels, or with one labelled frame."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import console
from .arguments import DeviceOption, EngineOption, ForceOption, OverlayOption, ThreadsOption, VideosArgument
from .label_command import label_first
from .outcomes import show_outcomes


def angle(
    videos: VideosArgument,
    out: Annotated[Path, typer.Option(help="Folder for the results.", metavar="FOLDER")] = Path(
        "bendtrack-angles"
    ),
    model: Annotated[
        Path | None,
        typer.Option(
            help="Folder or file of a pretrained network, as `bendtrack pretrain` writes it.",
            metavar="NETWORK",
            show_default="the one that comes with bendtrack",
        ),
    ] = None,
    network: Annotated[Path | None, typer.Option("--network", hidden=True)] = None,
    quick: Annotated[
        bool,
        typer.Option(
            "--quick", help="Do not adapt the network to this actuator: sooner, but fewer frames found."
        ),
    ] = False,
    label: Annotated[
        bool,
        typer.Option(
            "--label",
            help="Label one frame first, on a page in the browser: four clicks say which actuator is meant and where"
            " its ends are.",
        ),
    ] = False,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="With --label: only print the page's address.")
    ] = False,
    overlay: OverlayOption = False,
    force: ForceOption = False,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: ThreadsOption = None,
) -> None:
    """Measure the bending angle without labels, or with one labelled frame (--label).

    Finds the actuator in each video, and which of its ends is fixed: the one that does not move. Where the network is
    not sure of the moving end, it first adapts to this actuator, which takes about a minute on two cores. Writes what
    `bendtrack track` writes. Thirty labelled frames give more exact angles. The exit status is 1 when no actuator is
    seen in a video.

    With --label, one frame of the first video is chosen. You click its four points, and a network learns them from the
    whole video. The label is kept in FOLDER/labels, which is a project: more videos and labels can follow.
    """
    from ...measuring import measure_each, measure_labelled, project_to_label
    from ..batch import listed_videos, unreadable
    from .reporter import ConsoleReporter

    model = model or network
    if label and (quick or model is not None):
        raise typer.BadParameter("--label trains a network of its own: leave out --model and --quick")
    if no_browser and not label:
        raise typer.BadParameter("--no-browser belongs to --label")
    paths = listed_videos(videos)
    if failed := unreadable(paths):
        show_outcomes(failed)
    if label:
        project = project_to_label(paths, out, reporter=ConsoleReporter())
        label_first(project.folder, no_browser)
        show_outcomes(
            measure_labelled(
                project,
                paths,
                out,
                started_s=console.started_s(),
                overlay=overlay,
                force=force,
                engine=engine,
                device=device,
                threads=threads,
            )
        )
        return
    show_outcomes(
        measure_each(
            paths,
            out,
            model=model,
            adapt=not quick,
            overlay=overlay,
            force=force,
            engine=engine,
            device=device,
            threads=threads,
            reporter=ConsoleReporter(),
        )
    )
