"""The command `track`: which videos, which network, and what is said in the end."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from . import model_folders
from .engines import DeviceOption, EngineOption, ModelOption, ThreadsOption, load_network, measured_angle
from .project_commands import ProjectArgument
from .tracking_runs import (
    ForceOption,
    OverlayOption,
    VideosArgument,
    check_writable,
    list_problems,
    listed_videos,
    track_videos,
)


def track(
    project: ProjectArgument,
    videos: VideosArgument,
    model: ModelOption = None,
    out: Annotated[
        Path | None, typer.Option(help="Where the results go.", show_default="PROJECT/results")
    ] = None,
    overlay: OverlayOption = False,
    force: ForceOption = False,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: ThreadsOption = None,
) -> None:
    """Measure the bending angle over time in videos.

    Writes a table (CSV, HDF5), a figure, and how they came about (JSON). What is up to date is passed over: the same
    video, network and settings. Exit status 1 when a video failed or is damaged; the others are done.
    """
    from ..project import Project

    opened = Project.open(project)
    paths = listed_videos(videos)
    folder = out or opened.results_dir
    check_writable(folder)
    network = load_network(model_folders.chosen(opened, model), engine, device, threads)
    problems = track_videos(
        network,
        measured_angle(opened, network),
        paths,
        folder,
        overlay=overlay,
        force=force,
        min_likelihood=opened.settings.tracking.min_likelihood,
    )
    list_problems(problems, paths)
