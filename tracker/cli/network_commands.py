"""Commands about the network: train, evaluate."""

from __future__ import annotations

import csv
import json
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..atomic import atomic_write_text, remove_leftovers
from ..errors import BendtrackError, CheckpointError, LabelError, TrainingError
from . import console, model_folders
from .project_commands import ProjectArgument

if TYPE_CHECKING:
    from ...models.checkpoint import Checkpoint
    from ...models.evaluation import Evaluation
    from ...models.learning.settings import TrainingSettings
    from ..project import Project
    from ..types import LabelledFrame


def train(
    project: ProjectArgument,
    name: Annotated[
        str | None, typer.Option(help="Of the network.", show_default="model, model-2, ...")
    ] = None,
    backbone: Annotated[str | None, typer.Option(help="resnet18, resnet34 or resnet50.")] = None,
    init: Annotated[
        str | None,
        typer.Option(
            help="auto, actuator (what comes with bendtrack), imagenet, random or a weights file.",
            show_default="auto: the best on this machine",
        ),
    ] = None,
    max_minutes: Annotated[float | None, typer.Option(help="End by then.")] = None,
    seed: Annotated[int | None, typer.Option(help="Everything random follows from it.")] = None,
    held_out: Annotated[
        float | None, typer.Option(help="Share of the frames to judge by, not trained on.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a training that was stopped (the latest, or --name).")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Let the new network take the place of --name.")
    ] = False,
) -> None:
    """Train a network on the project's labels.

    What is not given here is taken from [training] in bendtrack.toml, or else has a default.
    """
    from ..project import Project

    opened = Project.open(project)
    given = {
        "backbone": backbone,
        "init": init,
        "max_minutes": max_minutes,
        "seed": seed,
        "held_out": held_out,
    }
    given = {key: value for key, value in given.items() if value is not None}
    if resume:
        folder = model_folders.folder_to_resume(opened, name)
        settings = _stored_settings(folder, given)
    else:
        folder = model_folders.new_folder(opened, name, overwrite)
        settings = project_settings(opened, given)
        for stopped in model_folders.unfinished(opened):
            if name is None:
                console.warn(f"'{stopped.name}' is a training that was stopped; --resume goes on with it")
    train_network(opened, folder, settings, resume=resume)
    console.say(f"Next: bendtrack track {project} VIDEO...")


def evaluate(
    project: ProjectArgument,
    model: Annotated[str | None, typer.Option(help="Name of the network.", show_default="the newest")] = None,
    folds: Annotated[
        int | None,
        typer.Option(help="Cross-validation: train so many networks, each judged on what it has not seen."),
    ] = None,
) -> None:
    """Errors on labels that were not trained on.

    In px for every keypoint, in degrees for the angle; also figures, and the frames that went worst.
    """
    from ...models.checkpoint import load_checkpoint
    from ...models.cross_validation import cross_validate
    from ...models.evaluation import not_trained_on
    from ..project import Project
    from . import progress_bars

    opened = Project.open(project)
    if folds is None:
        folder = model_folders.chosen(opened, model)
        checkpoint = load_checkpoint(folder)
        frames = not_trained_on(checkpoint, _labels(opened, checkpoint.keypoints))
        if not frames:
            raise LabelError(
                f"expected labelled frames that '{folder.name}' was not trained on, got none:"
                " label more, train with --held-out 0.1, or use --folds 5"
            )
        console.say(f"'{folder.name}' on {len(frames)} frames that it was not trained on")
        spread = _labeller_spread(opened)
        evaluation = judge(folder, checkpoint, frames, **spread)
        show_evaluation(evaluation)
        _show_labeller_spread(evaluation, **spread)
        return
    if model is not None:
        raise BendtrackError("expected --model or --folds, got both: --folds trains networks of its own")
    frames = _labels(opened, opened.keypoints)
    folder = opened.models_dir / model_folders.CROSS_VALIDATION
    settings = project_settings(opened, {})
    _say_start(settings)
    with progress_bars.folds(folds) as progress:
        evaluation = cross_validate(
            frames, opened.keypoints, _definition(opened, frames), settings, folds, progress=progress
        )
    spread = _labeller_spread(opened)
    _write(
        evaluation,
        folder,
        [],
        judged_on="cross-validation",
        folds=folds,
        settings=settings.to_dict(),
        **spread,
    )
    console.say(f"{folds} networks, each judged on the frames that it was not trained on")
    show_evaluation(evaluation)
    _show_labeller_spread(evaluation, **spread)
    console.say(f"Figures: {folder}")


def project_settings(project: Project, given: dict[str, Any]) -> TrainingSettings:
    """Training settings: as given, else as in bendtrack.toml, else the defaults of `models.learning.settings`."""
    from ...models.learning.settings import TrainingSettings

    stored = {k: v for k, v in project.settings.training.model_dump().items() if v is not None}
    # A weights file named in bendtrack.toml lies where the project says, from wherever it is called.
    if "init" in stored and (project.root / stored["init"]).is_file():
        stored["init"] = str(project.root / stored["init"])
    return TrainingSettings(**{**stored, **given})


def train_network(
    project: Project, folder: Path, settings: TrainingSettings, *, resume: bool = False
) -> Evaluation | None:
    """Train into a folder of the project, or go on with what was stopped there; judge it, and write all of it.

    Returns
    -------
    How the network does on the frames that were held out; None without any.
    """
    from ...models.evaluation import not_trained_on
    from ...models.learning.training import train
    from ...models.learning.training_state import STATE_FILE
    from . import progress_bars

    frames = _labels(project, project.keypoints)
    definition = _definition(project, frames)
    console.say(
        f"{'Going on with' if resume else 'Training'} '{folder.name}' on {len(frames)} labelled frames"
    )
    _say_start(settings)
    folder.mkdir(parents=True, exist_ok=True)
    state, stored = folder / STATE_FILE, folder / model_folders.SETTINGS_FILE
    remove_leftovers(folder)
    if not resume:
        state.unlink(missing_ok=True)
    atomic_write_text(stored, json.dumps(settings.to_dict(), indent=2) + "\n")
    try:
        with progress_bars.training(folder.name) as progress:
            checkpoint = train(
                frames,
                project.keypoints,
                definition,
                folder,
                settings,
                resume=state.is_file(),  # it may have been stopped before it saved anything
                progress=progress,
            )
    except BaseException:
        if state.is_file():
            console.say(
                f"Not finished: `bendtrack train {project.root} --resume` goes on with '{folder.name}'"
            )
        else:  # nothing was learnt, so nothing is left
            stored.unlink(missing_ok=True)
            with suppress(OSError):
                folder.rmdir()
        raise
    facts = checkpoint.training
    console.say(
        f"'{folder.name}': {facts['steps']} steps in {facts['minutes']:.1f} min, from {facts['started_from']} weights"
    )
    renamed = [f"{own} as {known}" for own, known in facts["known_before"].items() if own != known]
    if renamed:
        console.say(f"They knew {', '.join(renamed)}")
    held_out = not_trained_on(checkpoint, frames)
    if not held_out:
        console.say(
            "No frames were held out, so its error is not known; `bendtrack evaluate --folds 5` tells it"
        )
        return None
    evaluation = judge(folder, checkpoint, held_out)
    console.say(f"On the {len(held_out)} frames that were held out:")
    show_evaluation(evaluation)
    console.say(f"Network and figures: {folder}")
    return evaluation


def judge(folder: Path, checkpoint: Checkpoint, frames: list[LabelledFrame], **more: Any) -> Evaluation:
    """Evaluate a network on frames, and write evaluation.json (with `more` in it) and the figures into its folder."""
    from ...models.evaluation import evaluate
    from . import progress_bars

    with progress_bars.counting("evaluating") as progress:
        evaluation = evaluate(checkpoint, frames, progress=progress)
    _write(
        evaluation,
        folder,
        _training_rows(folder),
        judged_on="frames not trained on",
        model=folder.name,
        **more,
    )
    return evaluation


def show_evaluation(evaluation: Evaluation) -> None:
    """Print the errors as a table, with the length that decides how well an angle can be known."""
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
        f"The points of an end are L = {length:.0f} px apart: with {summary['n_trained']} labels of 1 px error"
        f" the angle can be known to {floor:.2f}° (label-noise floor)."
    )
    if length < _SHORT_END_PX:
        console.show(
            "Advice: L is short. Label points that lie farther apart on each end, or bring the camera nearer:"
            " twice the length halves the error of the angle."
        )


def _labeller_spread(project: Project) -> dict[str, Any]:
    """What evaluation.json says of the labeller's own spread; nothing where no frame was labelled twice."""
    from ...labeling.annotations import Annotations
    from ...labeling.repeats import project_spread

    spread = project_spread(Annotations(project))
    return {} if spread is None else {"labeller_spread": spread.to_json()}


def _show_labeller_spread(evaluation: Evaluation, labeller_spread: dict[str, Any] | None = None) -> None:
    """Print it beside the network's error, in the same measure."""
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


_SHORT_END_PX = 40
"""Under it the floor of thirty labels is above half a degree."""


def _write(evaluation: Evaluation, folder: Path, rows: list[dict[str, float]], **more: Any) -> None:
    from ...models.evaluation import write_evaluation
    from ...models.evaluation_figures import write_figures

    folder.mkdir(parents=True, exist_ok=True)
    write_evaluation(evaluation, folder / "evaluation.json", **more)
    write_figures(evaluation, rows, folder)


def _training_rows(folder: Path) -> list[dict[str, float]]:
    path = folder / "training.csv"
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def _labels(project: Project, keypoints: tuple[str, ...]) -> list[LabelledFrame]:
    from ...labeling.store import LabelStore

    if keypoints != project.keypoints:
        raise CheckpointError(
            f"expected a network that finds {', '.join(project.keypoints)}, got one that finds"
            f" {', '.join(keypoints)}: train a new one"
        )
    frames = LabelStore.of(project).read()
    if not frames:
        raise LabelError(
            f"expected labelled frames in {project.labels_dir}, got none: `bendtrack import` brings some"
        )
    return frames


def _definition(project: Project, frames: list[LabelledFrame]) -> Any:
    import numpy as np

    return project.angle_definition(np.stack([frame.xy for frame in frames]))


def _say_start(settings: TrainingSettings) -> None:
    from ...models.learning.initialisation import resolve_init

    start = resolve_init(settings.init, settings.backbone)
    words = f"Start: {settings.backbone} with {start} weights"
    if settings.init == "auto" and start == "random":
        words += ", as no others are on this machine (--init imagenet downloads some)"
    console.say(words)


def _stored_settings(folder: Path, given: dict[str, Any]) -> TrainingSettings:
    from ...models.learning.settings import TrainingSettings

    path = folder / model_folders.SETTINGS_FILE
    try:
        return TrainingSettings(**{**json.loads(path.read_text(encoding="utf-8")), **given})
    except (ValueError, TypeError) as error:
        raise TrainingError(f"--resume: expected training settings in {path}, got a damaged file") from error
