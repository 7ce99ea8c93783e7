"""K-fold cross-validation: every labelled frame is evaluated once, by a network that was not trained on it.

How one network is trained is in `training`, how it is evaluated in `evaluation`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..tracker.angle import AngleDefinition
from ..tracker.errors import TrainingError
from ..tracker.types import LabelledFrame
from .evaluation import Evaluation, evaluate
from .inference.coarse_to_fine import concatenated
from .training.settings import TrainingSettings
from .training.trainer import Progress, train


def cross_validate(
    frames: Sequence[LabelledFrame],
    keypoints: Sequence[str],
    definition: AngleDefinition,
    settings: TrainingSettings,
    folds: int,
    *,
    progress: Callable[[int, Progress], None] | None = None,
) -> Evaluation:
    """Train `folds` networks, each without one fold of the frames, and evaluate each on its fold.

    Nothing is held out within a training: each network is trained on all other folds, and no choice in its training
    depends on the fold that it is evaluated on. The networks are not kept.

    Parameters
    ----------
    frames : sequence of LabelledFrame
        Every actuator's are spread over all folds; those without any label are skipped.
    keypoints : sequence of K str
    definition : AngleDefinition
    settings : TrainingSettings
        Of every training; its `held_out` is ignored.
    folds : int
        At least 2, at most the number of labelled frames.
    progress : callable, optional
        Called with the fold, from 0, and the progress of its training.

    Returns
    -------
    Evaluation
        Of all labelled frames.

    Raises
    ------
    TrainingError
        `folds` does not fit the number of frames, or a loss is not finite.
    LabelError
        A keypoint is labelled in one fold only, or an image cannot be read.
    WeightsError
        The initial weights cannot be loaded.
    """
    labelled = [frame for frame in frames if not np.isnan(frame.xy).all()]
    if not 2 <= folds <= len(labelled):
        raise TrainingError(
            f"--folds: expected 2 to {len(labelled)} (the number of labelled frames), got {folds}"
        )
    settings = replace(settings, held_out=0.0)
    fold_of = fold_of_each(labelled, folds, settings.seed)
    evaluations = []
    for fold in range(folds):
        rest = [frame for frame, own in zip(labelled, fold_of, strict=True) if own != fold]
        left_out = [frame for frame, own in zip(labelled, fold_of, strict=True) if own == fold]
        with tempfile.TemporaryDirectory(prefix="bendtrack-fold-") as folder:
            checkpoint = train(
                rest,
                keypoints,
                definition,
                Path(folder),
                settings,
                progress=partial(progress, fold) if progress else None,
            )
        evaluations.append(evaluate(checkpoint, left_out))
    return Evaluation(
        [frame for evaluation in evaluations for frame in evaluation.frames],
        concatenated([evaluation.found for evaluation in evaluations]),
        tuple(keypoints),
        definition,
        n_trained=round(len(labelled) * (folds - 1) / folds),
    )


def fold_of_each(frames: Sequence[LabelledFrame], folds: int, seed: int) -> list[int]:
    """Assign frames to folds at random, every actuator's evenly.

    Parameters
    ----------
    frames : sequence of N LabelledFrame
    folds : int
    seed : int

    Returns
    -------
    list of N int
        Each frame's fold, from 0.
    """
    rng = np.random.default_rng([seed, 3])
    fold_of = [0] * len(frames)
    assigned = 0
    for actuator in sorted({frame.actuator for frame in frames}):
        own = [i for i, frame in enumerate(frames) if frame.actuator == actuator]
        for i in rng.permutation(own).tolist():
            fold_of[i] = assigned % folds
            assigned += 1
    return fold_of
