"""A project's labels become a network: trained into models/<name>/, judged, its figures drawn.

How a network is trained is in `bendtrack.models`; which folder it goes into in `model_folders.py`.
"""

from __future__ import annotations

import csv
import json
import shlex
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import model_folders
from .reporting import SILENT, Reporter
from .tracker.atomic import atomic_write_text, remove_leftovers
from .tracker.errors import AngleError, BendtrackError, CheckpointError, LabelError, TrainingError
from .tracker.extras import training_packages_needed
from .tracker.folder_lock import FolderInUseError, folder_lock
from .tracker.links import make_folder

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from .models.evaluation import Evaluation
    from .models.networks.checkpoint import Checkpoint
    from .models.training.settings import TrainingSettings
    from .tracker.angle import AngleDefinition
    from .tracker.project import Project as ProjectFolder
    from .tracker.types import FloatArray, LabelledFrame


LEAST_SHARE_OF_STEPS = 0.25
"""Share of the planned steps below which a user is warned that the time limit was too short."""


@dataclass(frozen=True)
class TrainedNetwork:
    """A network that has been trained on a project's labels.

    Attributes
    ----------
    folder : Path
        models/<name>/ with the checkpoint, its settings, evaluation.json and figures.
    steps : int
        Training steps.
    minutes : float
        How long they took.
    evaluation : Evaluation or None
        Errors on the frames that were held out; None where none were.
    """

    folder: Path
    steps: int
    minutes: float
    evaluation: Evaluation | None

    @property
    def name(self) -> str:
        """What the network is called: the name of its folder."""
        return self.folder.name


class StoppedTraining(KeyboardInterrupt):
    """A training was interrupted; the message says what goes on with it."""


def planned_settings(project: ProjectFolder, given: Mapping[str, Any]) -> TrainingSettings:
    """Settle the training settings: as given, else as in bendtrack.toml, else the defaults.

    Parameters
    ----------
    project : tracker.project.Project
        Its [training] section counts.
    given : Mapping of str to object
        Fields of `models.TrainingSettings`.

    Returns
    -------
    TrainingSettings
        All settings.

    Raises
    ------
    TrainingError
        A value that cannot be.
    """
    with training_packages_needed("training"):
        from .models.training.settings import TrainingSettings

    stored = {k: v for k, v in project.settings.training.model_dump().items() if v is not None}
    # A weights file named in bendtrack.toml lies where the project says, from wherever it is called.
    if "init" in stored and (project.root / stored["init"]).is_file():
        stored["init"] = str(project.root / stored["init"])
    return TrainingSettings(**{**stored, **given})


def stored_settings(folder: Path, given: Mapping[str, Any]) -> TrainingSettings:
    """Read the settings that a training was started with.

    Parameters
    ----------
    folder : Path
        The folder of an unfinished training.
    given : Mapping of str to object
        Fields of `models.TrainingSettings` that take the place of what is stored.

    Returns
    -------
    TrainingSettings
        All settings.

    Raises
    ------
    TrainingError
        The file is damaged.
    """
    with training_packages_needed("training"):
        from .models.training.settings import TrainingSettings

    path = folder / model_folders.SETTINGS_FILE
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        stored.pop(model_folders.STARTED, None)
        return TrainingSettings(**{**stored, **given})
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise TrainingError(f"--resume: expected training settings in {path}, got a damaged file") from error


def train_network(
    project: ProjectFolder,
    folder: Path,
    settings: TrainingSettings,
    *,
    resume: bool = False,
    started_s: float | None = None,
    reporter: Reporter = SILENT,
) -> TrainedNetwork:
    """Train into a folder of the project, or go on with what was stopped there; judge it, and write all of it.

    Parameters
    ----------
    project : tracker.project.Project
        Its labels are learnt.
    folder : Path
        In the project's models/.
    settings : TrainingSettings
        How.
    resume : bool
        Whether to go on from the state in the folder.
    started_s : float or None
        `time.monotonic()` at which `settings.max_minutes` begin to count; None begins now.
    reporter : Reporter
        Is told what goes on.

    Returns
    -------
    TrainedNetwork
        With its errors on the frames that were held out.

    Raises
    ------
    LabelError
        There are no labels, or a picture cannot be read.
    TrainingError
        The loss is not finite, what was stopped does not fit, or another process trains into this folder.
    StoppedTraining
        Ctrl-C. Where a step was done, its state is saved.
    """
    make_folder(folder)
    try:
        with folder_lock(folder, wait=False):
            try:
                return _train_locked(project, folder, settings, resume, started_s, reporter)
            except BaseException:
                with suppress(OSError):  # where nothing was written, nothing is left
                    folder.rmdir()
                    folder.parent.rmdir()
                raise
    except FolderInUseError:
        raise TrainingError(
            f"expected a network that is not being trained, got '{folder.name}', which another process trains:"
            " wait for it, or train another with --name"
        ) from None


def _train_locked(
    project: ProjectFolder,
    folder: Path,
    settings: TrainingSettings,
    resume: bool,
    started_s: float | None,
    reporter: Reporter,
) -> TrainedNetwork:
    """`train_network`, in a folder that no other process trains into."""
    started_s = time.monotonic() if started_s is None else started_s
    frames = labels_of(project, project.keypoints)
    with training_packages_needed("training"):
        from .models.adaptation.propagated_frames import forget_propagated
        from .models.evaluation import not_trained_on
        from .models.training.state import STATE_FILE
        from .models.training.trainer import train

    reporter.say(
        f"{'Going on with' if resume else 'Training'} '{folder.name}' on {len(frames)} labelled frames"
    )
    _say_start(settings, reporter)
    state, stored = folder / STATE_FILE, folder / model_folders.SETTINGS_FILE
    remove_leftovers(folder)
    if not resume:
        state.unlink(missing_ok=True)
        forget_propagated(folder)
    propagated = _propagated(project, frames, folder, settings, reporter)
    definition = angle_of(project, [*frames, *propagated])
    started = {model_folders.STARTED: model_folders.start_of_training(project)}
    atomic_write_text(stored, json.dumps({**settings.to_dict(), **started}, indent=2) + "\n")
    again = ["bendtrack", "train", str(project.root)]
    try:
        with reporter.training(folder.name) as progress:
            checkpoint = train(
                [*frames, *propagated],
                project.keypoints,
                definition,
                folder,
                settings,
                resume=state.is_file(),  # it may have been stopped before it saved anything
                started_s=started_s,
                latest=model_folders.latest_training(project),
                signs=signs_of(project, [*frames, *propagated]),
                progress=progress,
            )
    except KeyboardInterrupt:
        # Its settings stay in any case, so that --resume goes on with the same ones.
        kept = "its state is saved" if state.is_file() else "no step was done yet"
        raise StoppedTraining(
            f"interrupted, {kept}: `{shlex.join([*again, '--resume'])}` goes on with '{folder.name}'"
        ) from None
    except BaseException:
        if state.is_file():
            reporter.say(f"Not finished: `{shlex.join([*again, '--resume'])}` goes on with '{folder.name}'")
        else:  # nothing was learnt, so nothing is left
            stored.unlink(missing_ok=True)
            forget_propagated(folder)
            with suppress(OSError):
                folder.rmdir()
        raise
    facts = checkpoint.training
    reporter.say(
        f"'{folder.name}': {facts['steps']} steps in {facts['minutes']:.1f} min, from {facts['started_from']} weights"
    )
    planned = settings.steps_for(len(facts["trained_on"]) + len(propagated), facts["started_from"])
    if settings.max_minutes is not None and facts["steps"] < LEAST_SHARE_OF_STEPS * planned:
        reporter.warn(
            f"{settings.max_minutes:g} min were enough for {facts['steps']} of {planned} steps:"
            " the network has learnt little; give it more time"
        )
    renamed = [f"{own} as {known}" for own, known in facts["known_before"].items() if own != known]
    if renamed:
        reporter.say(f"They knew {', '.join(renamed)}")
    held_out = not_trained_on(checkpoint, frames)
    evaluation = judge(folder, checkpoint, held_out, reporter) if held_out else None
    return TrainedNetwork(folder, facts["steps"], facts["minutes"], evaluation)


def is_trained_on_labels(project: ProjectFolder, folder: Path, settings: TrainingSettings) -> bool:
    """Whether a finished network was trained on a project's labels as they are now, with these settings.

    Parameters
    ----------
    project : tracker.project.Project
        Whose labels.
    folder : Path
        The network's.
    settings : TrainingSettings
        How it would be trained now.

    Returns
    -------
    bool
        False too where the network cannot be read.
    """
    from .models.adaptation.propagated_frames import read_propagated
    from .models.inference.metadata import read_metadata, weights_file
    from .models.training.training_data import settings_and_labels_sha256

    frames = labels_of(project, project.keypoints)
    frames += read_propagated(folder, frames)
    try:
        learnt = read_metadata(weights_file(folder)).training.get("settings_and_labels_sha256")
    except CheckpointError:
        return False
    return bool(learnt == settings_and_labels_sha256(frames, project.keypoints, settings))


def _propagated(
    project: ProjectFolder,
    frames: Sequence[LabelledFrame],
    folder: Path,
    settings: TrainingSettings,
    reporter: Reporter,
) -> list[LabelledFrame]:
    """Other frames of the videos with few labels, with the labels propagated to them."""
    from .labeling.video_record import remembered_video
    from .models.adaptation.propagated_frames import (
        pretrained_start,
        propagated_frames,
        videos_with_few_labels,
    )

    stems = videos_with_few_labels(frames)
    found = {stem: remembered_video(project.labels_dir / stem) for stem in stems}
    videos = {stem: video for stem, video in found.items() if video is not None}
    made: list[LabelledFrame] = []
    if videos:
        with reporter.counting(f"finding the actuator in {', '.join(videos)}", "steps") as progress:
            made = propagated_frames(frames, project.keypoints, videos, folder, settings, progress)
    used = list(dict.fromkeys(frame.video for frame in made))
    if used:
        reporter.say(f"Few frames are labelled: {len(made)} more of {', '.join(used)} are learnt from")
    unused = [stem for stem in stems if stem not in used]
    for stem in unused if unused and pretrained_start(settings) else ():
        why = (
            "the actuator is not found in its other frames"
            if stem in videos
            else "where its video lies is not known"
        )
        reporter.warn(
            f"{stem}: few frames are labelled, and {why}: only the labelled ones are learnt from; label ten or more"
        )
    return made


def evaluate_network(project: ProjectFolder, folder: Path, reporter: Reporter = SILENT) -> Evaluation:
    """Judge a network on the labels that it was not trained on; write evaluation.json and figures into its folder.

    Parameters
    ----------
    project : tracker.project.Project
        Its labels judge.
    folder : Path
        The network's, in models/.
    reporter : Reporter
        Is told what goes on.

    Returns
    -------
    Evaluation
        Errors in px and degrees.

    Raises
    ------
    LabelError
        There are no labels that it was not trained on.
    CheckpointError
        The network cannot be read, or finds other keypoints.
    """
    with training_packages_needed("evaluating"):
        from .models.evaluation import not_trained_on
        from .models.networks.checkpoint import load_checkpoint

    checkpoint = load_checkpoint(folder)
    frames = not_trained_on(checkpoint, labels_of(project, checkpoint.keypoints))
    if not frames:
        raise LabelError(
            f"expected labelled frames that '{folder.name}' was not trained on, got none:"
            " label more, train with --held-out 0.1, or use --folds 5"
        )
    reporter.say(f"'{folder.name}' on {len(frames)} frames that it was not trained on")
    return judge(folder, checkpoint, frames, reporter, **labeller_spread(project))


def cross_validated(project: ProjectFolder, folds: int, reporter: Reporter = SILENT) -> Evaluation:
    """Train `folds` networks, each judged on what it has not seen; write evaluation.json and figures.

    Parameters
    ----------
    project : tracker.project.Project
        Its labels train and judge.
    folds : int
        At least 2, at most the number of labelled frames.
    reporter : Reporter
        Is told what goes on.

    Returns
    -------
    Evaluation
        Errors in px and degrees of all labelled frames.

    Raises
    ------
    LabelError
        There are no labels.
    TrainingError
        `folds` does not fit the number of frames.
    """
    frames = labels_of(project, project.keypoints)
    with training_packages_needed("cross-validation"):
        from .models.cross_validation import cross_validate

    settings = planned_settings(project, {})
    _say_start(settings, reporter)
    with reporter.folds(folds) as progress:
        evaluation = cross_validate(
            frames, project.keypoints, angle_of(project, frames), settings, folds, progress=progress
        )
    make_folder(project.models_dir, parents=False)
    _write(
        evaluation,
        project.models_dir / model_folders.CROSS_VALIDATION,
        [],
        judged_on="cross-validation",
        folds=folds,
        settings=settings.to_dict(),
        **labeller_spread(project),
    )
    reporter.say(f"{folds} networks, each judged on the frames that it was not trained on")
    return evaluation


def judge(
    folder: Path,
    checkpoint: Checkpoint,
    frames: Sequence[LabelledFrame],
    reporter: Reporter = SILENT,
    **more: Any,
) -> Evaluation:
    """Evaluate a network on frames, and write evaluation.json (with `more` in it) and the figures into its folder.

    Parameters
    ----------
    folder : Path
        The network's.
    checkpoint : Checkpoint
        What lies in it.
    frames : sequence of LabelledFrame
        At least one.
    reporter : Reporter
        Is told how far it is.
    **more : object
        Further entries of evaluation.json.

    Returns
    -------
    Evaluation
        Errors in px and degrees.
    """
    from .models.evaluation import evaluate

    with reporter.counting("evaluating") as progress:
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


def labeller_spread(project: ProjectFolder) -> dict[str, Any]:
    """Give what evaluation.json says of the labeller's own spread; nothing where no frame was labelled twice.

    Parameters
    ----------
    project : tracker.project.Project
        Whose labels.

    Returns
    -------
    dict
        Empty, or with one entry "labeller_spread".
    """
    from .labeling.annotations import Annotations
    from .labeling.repeatability import project_repeatability

    spread = project_repeatability(Annotations(project))
    return {} if spread is None else {"labeller_spread": spread.to_json()}


def labels_of(project: ProjectFolder, keypoints: tuple[str, ...]) -> list[LabelledFrame]:
    """Read a project's labelled frames.

    Parameters
    ----------
    project : tracker.project.Project
        Whose labels.
    keypoints : tuple of str
        Those of the network that is meant; they must be the project's.

    Returns
    -------
    list of LabelledFrame
        At least one.

    Raises
    ------
    CheckpointError
        The network finds other keypoints.
    LabelError
        Nothing is labelled yet.
    """
    from .labeling.store import LabelStore

    if keypoints != project.keypoints:
        raise CheckpointError(
            f"expected a network that finds {', '.join(project.keypoints)}, got one that finds"
            f" {', '.join(keypoints)}: train a new one"
        )
    store = LabelStore.of(project)
    frames = store.read()
    if not frames:
        steps = [
            *model_folders.steps_to_labels(project),
            f"`bendtrack import {shlex.quote(str(project.root))} SOURCE` takes over labels of another program",
        ]
        raise LabelError(f"expected labelled frames in {project.labels_dir}, got none: {', '.join(steps)}")
    return frames


def angle_of(project: ProjectFolder, frames: Sequence[LabelledFrame]) -> AngleDefinition:
    """Give the project's angle, its sign from the labelled frames where the project leaves it to them.

    Parameters
    ----------
    project : tracker.project.Project
        Whose settings.
    frames : sequence of LabelledFrame
        Its labels.

    Returns
    -------
    AngleDefinition
        With the sign settled.

    Raises
    ------
    AngleError
        The sign is "auto" and no labelled frame has all points of the angle.
    """
    import numpy as np

    return project.angle_definition(np.stack([frame.xy for frame in frames]))


def signs_of(project: ProjectFolder, frames: Sequence[LabelledFrame]) -> dict[str, int]:
    """Give the sign of the angle for each actuator: two of them may bend to different sides of the picture.

    Parameters
    ----------
    project : tracker.project.Project
        Whose settings.
    frames : sequence of LabelledFrame
        Its labels.

    Returns
    -------
    dict of str to int
        Actuator -> +1 or -1; without the actuators whose labels do not tell.
    """
    import numpy as np

    labelled: dict[str, list[FloatArray]] = {}
    for frame in frames:
        labelled.setdefault(frame.actuator, []).append(frame.xy)
    signs = {}
    for actuator, xy in labelled.items():
        with suppress(AngleError):
            signs[actuator] = project.angle_definition(np.stack(xy)).sign
    return signs


def refuse_both(model: str | None, folds: int | None) -> None:
    """Refuse to judge one network and to cross-validate at once.

    Parameters
    ----------
    model : str or None
        Name of a network.
    folds : int or None
        Number of folds.

    Raises
    ------
    BendtrackError
        Both are given.
    """
    if model is not None and folds is not None:
        raise BendtrackError("expected --model or --folds, got both: --folds trains networks of its own")


def _write(evaluation: Evaluation, folder: Path, rows: list[dict[str, float]], **more: Any) -> None:
    from .models.evaluation import write_evaluation
    from .models.figures import write_figures

    make_folder(folder, parents=False)
    remove_leftovers(folder)  # of a process that was killed at this point
    write_evaluation(evaluation, folder / "evaluation.json", **more)
    write_figures(evaluation, rows, folder)


def _training_rows(folder: Path) -> list[dict[str, float]]:
    path = folder / "training.csv"
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    except (ValueError, TypeError, csv.Error) as error:  # only a figure is made from it
        raise TrainingError(
            f"{path}: expected the rows of a training, got a damaged file; remove it to go on without its figure"
        ) from error


def _say_start(settings: TrainingSettings, reporter: Reporter) -> None:
    from .models.networks.initialisation import resolve_init

    start = resolve_init(settings.init, settings.backbone)
    words = f"Start: {settings.backbone} with {start} weights"
    if settings.init == "auto" and start == "random":
        words += ", as no others are on this machine (--init imagenet downloads some)"
    reporter.say(words)
