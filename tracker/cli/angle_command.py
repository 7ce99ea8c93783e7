"""The command `angle`: angle over time without project or labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import DeviceOption, EngineOption, ForceOption, OverlayOption, ThreadsOption, VideosArgument
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
    overlay: OverlayOption = False,
    force: ForceOption = False,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: ThreadsOption = None,
) -> None:
    """Measure the bending angle without labels.

    Finds the actuator in each video, and which of its ends is fixed: the one that does not move. Where the network is
    not sure of the moving end, it first adapts to this actuator, which takes about a minute on two cores. Writes what
    `bendtrack track` writes. Thirty labelled frames give more exact angles. The exit status is 1 when no actuator is
    seen in a video.
    """
    from ...measuring import measure_each
    from ..batch import listed_videos
    from .reporter import ConsoleReporter

    show_outcomes(
        measure_each(
            listed_videos(videos),
            out,
            model=model or network,
            adapt=not quick,
            overlay=overlay,
            force=force,
            engine=engine,
            device=device,
            threads=threads,
            reporter=ConsoleReporter(),
        )
    )
