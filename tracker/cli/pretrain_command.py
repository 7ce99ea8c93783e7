"""The command `pretrain`: hours of rendered actuators, for a network that knows them before any label."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..atomic import remove_leftovers
from ..errors import TrainingError
from . import console


def pretrain(
    out: Annotated[Path, typer.Argument(help="Folder of the network.", metavar="OUT")],
    backbone: Annotated[str, typer.Option(help="resnet18, resnet34 or resnet50.")] = "resnet18",
    steps: Annotated[
        int | None,
        typer.Option(help="In all; the learning rate falls towards the last.", show_default="30000"),
    ] = None,
    stop_after: Annotated[
        float | None, typer.Option(help="Stop after so many minutes; --resume goes on.", metavar="MINUTES")
    ] = None,
    max_minutes: Annotated[
        float | None,
        typer.Option(
            help="The learning rate falls so that all ends by then, after fewer steps.", metavar="MINUTES"
        ),
    ] = None,
    pictures: Annotated[
        int | None, typer.Option(help="New ones in a step.", show_default="16, on a GPU 36", metavar="N")
    ] = None,
    batch: Annotated[
        int | None,
        typer.Option(
            help="Pictures learnt from in a step, new and kept ones.",
            show_default="32, on a GPU 512",
            metavar="N",
        ),
    ] = None,
    pool: Annotated[
        int | None,
        typer.Option(
            help="Pictures that are kept, 0.3 MB each.",
            show_default="4096, on a GPU half of its memory",
            metavar="N",
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(help="Processes that draw pictures, about 100 a second each.", metavar="N")
    ] = 1,
    init: Annotated[
        str, typer.Option(help="random, actuator (what comes with bendtrack), or a pretrained network.")
    ] = "random",
    seed: Annotated[
        int, typer.Option(help="Everything random follows from it; with --init, not that network's own.")
    ] = 0,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what was stopped in OUT.")] = False,
) -> None:
    """Teach a network actuators in general, from rendered ones.

    Many hours on two cores, minutes on a GPU with many; can be stopped at any time.
    `train --init OUT/weights.safetensors` starts from what came of it, finished or not.
    """
    from ...models.finding.header import WEIGHTS_FILE
    from ...models.learning.pretraining import pretrain as run
    from ...models.learning.pretraining import usual_settings
    from ...models.learning.training_state import STATE_FILE
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
        f"{facts['steps']} of {facts['steps_planned']} steps, {facts['pictures']} pictures, {facts['minutes']:.0f} min."
        f" New pictures: {100 * judged['located_share']:.1f} % of the keypoints in sight are located within 5 % of the"
        f" body's length (median {100 * judged['located_median']:.1f} %); refined to {judged['refined_px']:.2f} px"
    )
    console.say(f"Network: {out / WEIGHTS_FILE}; figure: {out / 'learning-curve.png'}")
