"""Commands about a project's network: train, evaluate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import console
from .arguments import ModelOption, ProjectArgument, opened

if TYPE_CHECKING:
    from ...models.evaluation import Evaluation
    from ...training import TrainedNetwork

_SHORT_END_PX = 40
"""Length of an end, px, under which the label-noise floor of thirty labels is above half a degree."""


def train(
    project: ProjectArgument,
    model: Annotated[
        str | None,
        typer.Option(
            help="Name of the new network, or of the one to resume.",
            metavar="NAME",
            show_default="model, model-2, ...",
        ),
    ] = None,
    name: Annotated[str | None, typer.Option("--name", hidden=True)] = None,
    backbone: Annotated[
        str | None,
        typer.Option(
            help="Size of the network: resnet18, resnet34 or resnet50.",
            metavar="BACKBONE",
            show_default="resnet18",
        ),
    ] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="What the network starts from: auto, actuator (the network that comes with bendtrack), imagenet,"
            " random, or a weights file.",
            metavar="START",
            show_default="auto: the best on this machine",
        ),
    ] = None,
    max_minutes: Annotated[
        float | None,
        typer.Option(
            help="The whole command ends within about this many minutes; fewer training steps are done if needed.",
            metavar="MINUTES",
            show_default="no limit",
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of everything random.", metavar="N", show_default="0"),
    ] = None,
    held_out: Annotated[
        float | None,
        typer.Option(
            help="Share of the labelled frames that judges the network instead of training it.",
            metavar="SHARE",
            show_default="0.1",
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with the training that was stopped last, or with --model NAME."),
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the network of this name, if there is one.")
    ] = False,
) -> None:
    """Train a network on the project's labels.

    An option that is not given is taken from [training] in bendtrack.toml, or else has its default. Ctrl-C saves the
    state of the training; --resume goes on from there.
    """
    trained = opened(project).train(
        model or name,
        backbone=backbone,
        init=init,
        max_minutes=max_minutes,
        seed=seed,
        held_out=held_out,
        resume=resume,
        overwrite=overwrite,
        started_s=console.started_s(),
    )
    show_training(trained)
    console.say(f"Next: {console.command('track', project)} VIDEO...")


def evaluate(
    project: ProjectArgument,
    model: ModelOption = None,
    folds: Annotated[
        int | None,
        typer.Option(
            help="Cross-validation instead: train this many networks, each judged on frames that it has not seen.",
            metavar="K",
            show_default="no cross-validation",
        ),
    ] = None,
) -> None:
    """Measure the errors of a network on labels that it was not trained on.

    In px for every keypoint, in degrees for the angle. Also draws figures, and the frames with the largest errors.
    """
    from ...model_folders import CROSS_VALIDATION
    from ...training import labeller_spread

    own = opened(project)
    evaluation = own.evaluate(model, folds=folds)
    show_evaluation(evaluation)
    _show_labeller_spread(evaluation, **labeller_spread(own.folder))
    if folds is not None:
        console.say(f"Figures: {own.folder.models_dir / CROSS_VALIDATION}")


def show_training(trained: TrainedNetwork) -> None:
    """Print how a new network does on the frames that were held out.

    Parameters
    ----------
    trained : TrainedNetwork
        As `Project.train` gives it.
    """
    evaluation = trained.evaluation
    if evaluation is None:
        console.say(
            "No frames were held out, so its error is not known; `bendtrack evaluate --folds 5` measures it"
        )
        return
    console.say(f"On the {len(evaluation.frames)} frames that were held out:")
    show_evaluation(evaluation)
    console.say(f"Network and figures: {trained.folder}")


def show_evaluation(evaluation: Evaluation) -> None:
    """Print the errors as a table, with the length that decides how well an angle can be known.

    Parameters
    ----------
    evaluation : Evaluation
        Errors of a network.
    """
    from rich.table import Table

    summary = evaluation.summary()
    table = Table("", "n", "mean", "median", "95 %", "max", box=None, pad_edge=False)
    for column in table.columns[1:]:
        column.justify = "right"

    def row(title: str, figures: dict[str, Any], unit: str) -> None:
        values = [figures[key] for key in ("mean", "median", "p95", "max")]
        cells = ["-" if value is None else f"{value:.2f} {unit}" for value in values]
        table.add_row(title, str(figures["n"]), *cells)

    for keypoint, figures in summary["per_keypoint_px"].items():
        row(keypoint, figures, "px")
    row("all keypoints", summary["error_px"], "px")
    row("bending angle", summary["angle_error_deg"], "°")
    if len(summary["per_actuator"]) > 1:
        for actuator, figures in summary["per_actuator"].items():
            row(f"{actuator}: keypoints", figures["error_px"], "px")
            row(f"{actuator}: angle", figures["angle_error_deg"], "°")
    console.show(table)
    length, floor = summary["end_vector_px"], summary["floor_for_1px_labels_deg"]
    if length is None or floor is None:
        return
    console.show(
        f"The points of an end are L = {length:.0f} px apart. One label of 1 px error is then itself"
        f" {summary['one_label_of_1px_deg']:.1f}° off (2 sigma / L rad), and each frame here is judged by one label:"
        " an error of about this size is no fault of the network.\n"
        f"Label noise alone allows {floor:.2f}° (label-noise floor of {summary['n_trained']} labels of 1 px error)."
    )
    if length < _SHORT_END_PX:
        console.show(
            "Advice: L is short. Label points that lie farther apart on each end, or bring the camera nearer:"
            " twice the length halves the error of the angle."
        )


def _show_labeller_spread(evaluation: Evaluation, labeller_spread: dict[str, Any] | None = None) -> None:
    """Print it next to the network's error, in the same measure."""
    if labeller_spread is None:
        return
    found, summary = labeller_spread, evaluation.summary()
    own = [f"{found['px']:.2f} px [{found['px_low']:.2f}, {found['px_high']:.2f}]"]
    network = [f"{summary['error_px']['rms'] / 2**0.5:.2f} px"]  # a distance has two coordinates
    if found["deg"] is not None and summary["angle_error_deg"]["rms"] is not None:
        own.append(f"{found['deg']:.2f}° [{found['deg_low']:.2f}, {found['deg_high']:.2f}]")
        network.append(f"{summary['angle_error_deg']['rms']:.2f}°")
    console.show(
        f"The labeller's own spread, from {found['n_points']} points in {found['n_frames']} frames that were"
        f" labelled twice: {', '.join(own)} a coordinate and angle; the network's error in the same measure (RMS):"
        f" {', '.join(network)}. No network can be seen to be better than the labels that it is judged by."
    )
