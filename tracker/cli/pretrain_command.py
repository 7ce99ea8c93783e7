"""The command `pretrain`: hours of rendered actuators, for a network that knows them before any label."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..atomic import remove_leftovers
from ..errors import TrainingError
from . import console


def pretrain(
    out: Annotated[Path, typer.Argument(help="Folder for the network.", metavar="OUT")],
    backbone: Annotated[
        str, typer.Option(help="Size of the network: resnet18, resnet34 or resnet50.", metavar="BACKBONE")
    ] = "resnet18",
    steps: Annotated[
        int | None,
        typer.Option(
            help="Number of training steps. The learning rate falls towards the last one.",
            metavar="N",
            show_default="30000",
        ),
    ] = None,
    stop_after: Annotated[
        float | None,
        typer.Option(
            help="Stop after this many minutes; --resume goes on.",
            metavar="MINUTES",
            show_default="at the last step",
        ),
    ] = None,
    max_minutes: Annotated[
        float | None,
        typer.Option(
            help="End within this many minutes, after fewer steps if needed; the learning rate falls in time.",
            metavar="MINUTES",
            show_default="no limit",
        ),
    ] = None,
    pictures: Annotated[
        int | None,
        typer.Option(
            help="Number of newly rendered images in each step.", metavar="N", show_default="16, on a GPU 36"
        ),
    ] = None,
    batch: Annotated[
        int | None,
        typer.Option(
            help="Number of images in each step, newly rendered and kept ones together.",
            metavar="N",
            show_default="32, on a GPU 512",
        ),
    ] = None,
    pool: Annotated[
        int | None,
        typer.Option(
            help="Number of rendered images that are kept for later steps, 0.3 MB each.",
            metavar="N",
            show_default="4096, on a GPU half of its memory",
        ),
    ] = None,
    workers: Annotated[
        int,
        typer.Option(help="Number of processes that render images, about 100 a second each.", metavar="N"),
    ] = 1,
    init: Annotated[
        str,
        typer.Option(
            help="What the network starts from: random, actuator (the network that comes with bendtrack), or a"
            " pretrained network.",
            metavar="START",
        ),
    ] = "random",
    seed: Annotated[
        int,
        typer.Option(
            help="Seed of everything random. With --init NETWORK, take another one than that network had.",
            metavar="N",
        ),
    ] = 0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the pretraining that was stopped in OUT.")
    ] = False,
) -> None:
    """Teach a network actuators in general, from rendered ones.

    Takes many hours on two cores, minutes on a GPU with many. It can be stopped at any time.
    `bendtrack train --init OUT/weights.safetensors` starts from this network, finished or not.
    """
    from ...models.inference.metadata import WEIGHTS_FILE
    from ...models.pretraining.pretrainer import pretrain as run
    from ...models.pretraining.pretrainer import usual_settings
    from ...models.training.state import STATE_FILE
    from . import progress_bars

    if not resume and (out / STATE_FILE).is_file():
        raise TrainingError(
            f"expected a folder without a pretraining, got an unfinished one in {out}: add --resume"
        )
    if not resume and (out / WEIGHTS_FILE).is_file():
        raise TrainingError(f"expected a folder without a network, got one in {out}")
    asked = {"steps": steps, "pictures": pictures, "batch": batch, "pool": pool}
    given = {name: number for name, number in asked.items() if number is not None}
    settings = usual_settings(backbone=backbone, seed=seed, init=init, **given)
    remove_leftovers(out)
    console.say(
        f"{'Going on' if resume else 'Beginning'} in {out}: {settings.steps} steps in all, {backbone}"
    )
    with progress_bars.training(out.name) as progress:
        stop_after_s, max_s = (
            None if minutes is None else 60 * minutes for minutes in (stop_after, max_minutes)
        )
        checkpoint = run(
            out,
            settings,
            resume=resume,
            stop_after_s=stop_after_s,
            max_s=max_s,
            workers=workers,
            progress=progress,
        )
    facts = checkpoint.training
    judged = facts["judged"]
    console.say(
        f"{facts['steps']} of {facts['steps_planned']} steps, {facts['pictures']} images, {facts['minutes']:.0f} min."
        f" New images: {100 * judged['located_share']:.1f} % of the keypoints in sight are located within 5 % of the"
        f" body's length (median {100 * judged['located_median']:.1f} %); refined to {judged['refined_px']:.2f} px"
    )
    console.say(f"Network: {out / WEIGHTS_FILE}; figure: {out / 'learning-curve.png'}")
