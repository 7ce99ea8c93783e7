"""The command `angle`: from video to bending angle without project or labels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .engines import DeviceOption, EngineOption, ThreadsOption, load_network
from .tracking_runs import (
    ForceOption,
    OverlayOption,
    VideosArgument,
    check_writable,
    list_problems,
    listed_videos,
    track_videos,
)

BACKBONE = "resnet18"


def angle(
    videos: VideosArgument,
    out: Annotated[Path, typer.Option(help="Where the results go.")] = Path("bendtrack-angles"),
    network: Annotated[
        Path | None,
        typer.Option(
            help="A pretrained network, its folder or file (`bendtrack pretrain`).",
            show_default="the one that comes with bendtrack",
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Never learn the actuator first: sooner, fewer frames found.")
    ] = False,
    overlay: OverlayOption = False,
    force: ForceOption = False,
    engine: EngineOption = "auto",
    device: DeviceOption = "auto",
    threads: ThreadsOption = None,
) -> None:
    """Measure without labels.

    Finds the actuator in each video, and which of its ends is fixed: the one that does not move. Where it is not sure
    of it everywhere, it learns it first, from the frames in which it is: about a minute on two cores. Writes what
    `track` writes. Exit status 1 when in some video none can be seen; thirty labels are more exact.
    """
    from ...models.networks.shipped import working_copy

    paths = listed_videos(videos)
    check_writable(out)
    detector = load_network(
        network or working_copy(BACKBONE), engine, device, threads, self_training=not quick
    )
    list_problems(track_videos(detector, None, paths, out, overlay=overlay, force=force), paths)
