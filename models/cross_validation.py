"""K-fold cross-validation: every labelled frame judged once by a network that has not seen it."""

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
    """Train `folds` networks, each without one part of the frames, and judge each on that part.

    Nothing is held out within a fold, so each network learns from all of the other parts, and no choice in its
    training has seen the part that it is judged on. The networks are not kept.

    Parameters
    ----------
    frames : labelled frames; every actuator's are spread over all parts
    folds : at least 2, at most the number of labelled frames
    progress : is told the fold (from 0) and its training's progress

    Raises
    ------
    TrainingError
        `folds` does not fit the number of frames.
    """
    labelled = [frame for frame in frames if not np.isnan(frame.xy).all()]
    if not 2 <= folds <= len(labelled):
        raise TrainingError(
            f"--folds: expected 2 to {len(labelled)} (the number of labelled frames), got {folds}"
        )
    settings = replace(settings, held_out=0.0)
    part = fold_of_each(labelled, folds, settings.seed)
    evaluations = []
    for fold in range(folds):
        rest = [frame for frame, own in zip(labelled, part, strict=True) if own != fold]
        left_out = [frame for frame, own in zip(labelled, part, strict=True) if own == fold]
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
    """Which part each frame belongs to: random, every actuator's frames spread evenly."""
    rng = np.random.default_rng([seed, 3])
    part = [0] * len(frames)
    dealt = 0
    for actuator in sorted({frame.actuator for frame in frames}):
        own = [i for i, frame in enumerate(frames) if frame.actuator == actuator]
        for i in rng.permutation(own).tolist():
            part[i] = dealt % folds
            dealt += 1
    return part
