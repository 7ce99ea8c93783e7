"""The command `track`: angle over time with a project's network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import (
    DeviceOption,
    EngineOption,
    ForceOption,
    ModelOption,
    OverlayOption,
    ProjectArgument,
    ThreadsOption,
    VideosArgument,
    opened,
)
from .outcomes import show_outcomes


def track(
    project: ProjectArgument,
    videos: VideosArgument,
    model: ModelOption = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results.", metavar="FOLDER", show_default="PROJECT/results"),
    ] = None,
    overlay: OverlayOption = False,
    force: ForceOption = False,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: ThreadsOption = None,
) -> None:
    """Measure the bending angle over time in videos.

    Writes for each video a table (NAME.csv, NAME.h5), a figure (NAME.png) and how they came about (NAME.json). A video
    is skipped when its results are up to date: same video, same network, same settings. The exit status is 1 when a
    video failed or is damaged; the others are done.
    """
    show_outcomes(
        opened(project, *videos).track_each(
            videos,
            model=model,
            out=out,
            overlay=overlay,
            force=force,
            engine=engine,
            device=device,
            threads=threads,
        )
    )
