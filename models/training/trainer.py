"""The training loop: labelled frames in, a checkpoint out, and a state file so that a kill loses little.

How the two networks take a step is in `optimisation`, what they see in `batches`. Every random draw depends on
(seed, step) only, so a resumed training computes what an uninterrupted one does.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

import numpy as np
import torch

from ...tracker.angle import AngleDefinition, bending_angle
from ...tracker.errors import TrainingError
from ...tracker.interruption import stop_event
from ...tracker.links import make_folder
from ...tracker.types import Detections, FloatArray, LabelledFrame
from ..data.images import frame_id
from ..data.synthetic import rendered_frames
from ..denoising.registration import shipped_features
from ..denoising.targets import TargetDenoiser
from ..inference.calibration import (
    Calibration,
    calibrate,
    end_correlation,
    few_label_variance_px2,
    resting_scale,
)
from ..inference.coarse_to_fine import concatenated
from ..inference.crops import CropGeometry
from ..inference.metadata import later_than
from ..inference.roi import reference_distances
from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint, best_device
from ..networks.initialisation import random_cascade, resolve_init
from .batches import Batch, BatchSampler, crop_wh
from .initial_weights import load_initial_weights
from .optimisation import TwoNetworkTrainer
from .schedule import Schedule
from .settings import TrainingSettings
from .state import STATE_FILE, TrainingState, load_state, save_state, write_rows
from .training_data import TrainingData, load_training_data

EVALUATE_EVERY = 50
"""Steps between evaluations. The state is saved at each, so a kill costs at most the half minute that they take."""

CONSENSUS_FROM = 0.3
"""Share of the steps from which targets follow the averaged network; earlier its predictions are worse than clicks."""

FINISH_OF_PREPARATION = 1.6
"""Time from the last step to the checkpoint, as a multiple of the time for the first targets: both find the keypoints
in all frames and register the moving ends. Measured: 161 s and 104 s on a busy machine."""

REPLAY_FRAMES = 160
"""Rendered frames for experience replay, where the start is a network that knows actuators: thirty frames of one room
would make it forget other light and other backgrounds."""

CLEARLY_WORSE = 1.15
"""The best evaluation's weights are kept where the last held-out error is larger by this factor: held-out labels are
few and carry an error of their own, so a smaller difference says nothing."""

STEPS_TO_TIME = 10
"""Steps after which the schedule is fitted to a time limit: the first ones are slower than the rest."""


@dataclass(frozen=True)
class Progress:
    """Where a training stands after a step; the errors are those of the last evaluation.

    Attributes
    ----------
    step, total : int
        Steps taken, and steps planned (which may shrink).
    loss : float
        Of the step.
    held_out_px, held_out_deg : float
        Root mean square error on held-out frames, NaN without any.
    elapsed_s, left_s : float
        Seconds.
    """

    step: int
    total: int
    loss: float
    held_out_px: float
    held_out_deg: float
    elapsed_s: float
    left_s: float


def train(
    frames: Sequence[LabelledFrame],
    keypoints: Sequence[str],
    definition: AngleDefinition,
    folder: Path,
    settings: TrainingSettings | None = None,
    *,
    resume: bool = False,
    started_s: float | None = None,
    latest: datetime | None = None,
    signs: Mapping[str, int] | None = None,
    progress: Callable[[Progress], None] | None = None,
    evaluate_every: int = EVALUATE_EVERY,
) -> Checkpoint:
    """Train a cascade on labelled frames and save it in `folder`.

    Parameters
    ----------
    frames : sequence of LabelledFrame
        Those without any label are skipped.
    keypoints : sequence of K str
        Names of the keypoints.
    definition : AngleDefinition
        The angle, for errors in degrees and for the checkpoint.
    folder : Path
        Receives weights.safetensors, checkpoint.json and training.csv, and the state file while the training lasts.
    settings : TrainingSettings, optional
    resume : bool
        Continue from the state file in `folder`.
    started_s : float, optional
        `time.monotonic()` from which `settings.max_minutes` count, the end of training included. Default: now. In a
        resumed training, the time that was used before counts too.
    latest : datetime, optional
        When the newest network next to this one was trained: the time that the checkpoint records is later than it.
    signs : mapping from str to int, optional
        The angle's sign for each actuator, recorded in the checkpoint; the definition's own holds for all others.
    progress : callable, optional
        Called after each step.
    evaluate_every : int
        Steps between evaluations; the state is saved at each. A resumed training must be given the same.

    Returns
    -------
    Checkpoint
        The averaged network.

    Raises
    ------
    LabelError
        There are no labelled frames, or an image cannot be read.
    TrainingError
        The loss is not finite, or there is no state file that fits.
    WeightsError
        The initial weights cannot be loaded.
    KeyboardInterrupt
        Ctrl-C. A step that has begun is finished and its state saved first.
    """
    started_s = time.monotonic() if started_s is None else started_s
    settings = settings or TrainingSettings()
    data = load_training_data(frames, keypoints, settings)
    make_folder(folder)
    trainer = _Trainer(data, definition, Path(folder), settings, evaluate_every, resume=resume)
    trainer.run(started_s, progress)
    checkpoint = trainer.finish()
    training = {**checkpoint.training, "trained_at": later_than(latest), "signs": dict(signs or {})}
    checkpoint = replace(checkpoint, training=training)
    check_still_there(Path(folder))
    checkpoint.save(Path(folder))
    trainer.state_file.unlink(missing_ok=True)
    return checkpoint


def check_still_there(folder: Path) -> None:
    """Check that the folder that a training began in was not renamed or moved: nothing is written under its old name.

    Raises
    ------
    TrainingError
        It is gone.
    """
    if not folder.is_dir():
        raise TrainingError(
            f"{folder}: expected the folder that the training began in, got none; if it was renamed, train there"
            " with --resume, which goes on from the state saved last"
        )


class _Trainer:
    """One training: what does not change in it, and the networks and the state that its steps change.

    Parameters
    ----------
    data : TrainingData
    definition : AngleDefinition
    folder : Path
        Where the state is saved.
    settings : TrainingSettings
    evaluate_every : int
        Steps between evaluations.
    resume : bool
        Begin with the state file in `folder`.

    Raises
    ------
    TrainingError
        `resume`, and there is no state file that fits.
    WeightsError
        The initial weights cannot be loaded.
    KeyboardInterrupt
        Ctrl-C. A step that has begun is finished and its state saved first.
    """

    def __init__(
        self,
        data: TrainingData,
        definition: AngleDefinition,
        folder: Path,
        settings: TrainingSettings,
        evaluate_every: int = EVALUATE_EVERY,
        *,
        resume: bool = False,
    ) -> None:
        self.data, self.definition, self.folder, self.settings = data, definition, folder, settings
        self.evaluate_every = evaluate_every
        self.state_file = folder / STATE_FILE
        device = best_device()
        start = resolve_init(settings.init, settings.backbone)
        network = random_cascade(settings.backbone, len(data.keypoints), settings.seed)
        # A resumed training has its weights in the state file; those that it started from may be gone.
        mapping = {} if resume else load_initial_weights(network, start, settings.backbone, data)
        self.networks = TwoNetworkTrainer(
            network.to(device),
            average=settings.average,
            weight_decay=settings.weight_decay,
            locator_share=settings.locator_share_from(start),
        )
        self.state = (
            self._saved_state()
            if resume
            else TrainingState(
                identity=data.identity(settings),
                step=0,
                elapsed_s=0.0,
                schedule=Schedule(settings.steps_for(len(data.trained), start), settings.decay_share),
                rows=[],
                best=None,
                best_step=0,
                targets=np.array(data.labels, dtype=np.float64),
                start=start,
                mapping=mapping,
            )
        )
        last = self.state.rows[-1] if self.state.rows else {}
        self.held_out_px = last.get("held_out_px", math.nan)
        self.held_out_deg = last.get("held_out_deg", math.nan)
        knows_keypoints = self.state.start == "actuator" and bool(self.state.mapping)
        self.denoiser = _denoiser(data, settings, device if knows_keypoints else None)
        replay = (
            rendered_frames(settings.seed, range(REPLAY_FRAMES), data.keypoints, self.state.mapping)
            if knows_keypoints
            else []
        )
        self.sampler = BatchSampler(
            replay, crop_wh(data.regions), data.reference, settings.batch_frames, settings.seed
        )

    def run(self, started_s: float, progress: Callable[[Progress], None] | None) -> None:
        """Train until the schedule ends."""
        settings, state, schedule = self.settings, self.state, self.state.schedule
        begun = started_s - state.elapsed_s
        # How long all takes that comes after the last step; measured as soon as there is something to go by.
        finish_s = 0.0
        if settings.consensus and state.mapping and state.step == 0:
            known = np.isin(self.data.keypoints, list(state.mapping))
            prepared_s = time.monotonic()
            initial = self.denoiser.initial_targets(self.networks.average.estimator(), known)
            state.targets[self.data.trained] = initial
            finish_s = FINISH_OF_PREPARATION * (time.monotonic() - prepared_s)
        limit_s = None if settings.max_minutes is None else settings.max_minutes * 60
        first_step, first_s = state.step, time.monotonic() - begun
        with (
            ThreadPoolExecutor(max_workers=1) as pool,
            self.networks,
            stop_event(signal.SIGINT) as stop,
        ):
            batches = pool.submit(self._batches, state.step)
            while state.step < schedule.total:
                locate, refine = batches.result()
                batches = pool.submit(self._batches, state.step + 1)
                loss = self.networks.learn(locate, refine, state.step, self._learning_rate)
                state.step += 1
                state.elapsed_s = time.monotonic() - begun
                if limit_s is not None and state.step >= first_step + STEPS_TO_TIME:
                    # What comes before the first step is paid once, and what comes after the last one too.
                    step_s = (state.elapsed_s - first_s) / (state.step - first_step)
                    left_s = max(0.0, limit_s - state.elapsed_s - finish_s)
                    schedule.fit(state.step, step_s * state.step, step_s * state.step + left_s)
                if state.step % self.evaluate_every == 0 or state.step == schedule.total:
                    # An evaluation changes the targets: the batch drawn ahead is dropped and drawn again from the new
                    # ones, as a resumed training draws it.
                    batches.result()
                    self._evaluate(loss)
                    batches = pool.submit(self._batches, state.step)
                    # An evaluation detects the keypoints once, the end of training twice.
                    finish_s = max(finish_s, 2 * (time.monotonic() - begun - state.elapsed_s))
                    state.elapsed_s = time.monotonic() - begun
                    self.save_state()
                if progress:
                    progress(self._progress(loss))
                if stop.is_set():
                    self.save_state()
                    raise KeyboardInterrupt

    def _batches(self, step: int) -> tuple[Batch, list[Batch]]:
        """The batches of a step, for the locator and for the refiner."""
        return self.sampler.batches(
            step, {i: replace(self.data.prepared[i], xy=self.state.targets[i]) for i in self.data.trained}
        )

    @property
    def _learning_rate(self) -> float:
        state = self.state
        return self.settings.learning_rate_from(state.start) * state.schedule.factor(state.step)

    def _detect(self, network: Cascade, indices: Sequence[int]) -> Detections:
        data = self.data
        return concatenated(
            [
                network.detect(data.images[i][None], CropGeometry(data.prepared[i].region, data.reference))
                for i in indices
            ]
        )

    def _evaluate(self, loss: float) -> None:
        """Validate the averaged network on the held-out frames, and let the targets follow its predictions."""
        data, state = self.data, self.state
        if data.held_out:
            found = self._detect(self.networks.average, data.held_out).xy
            labels = data.labels[data.held_out]
            self.held_out_px = _rms(np.linalg.norm(found - labels, axis=2))
            angles = [bending_angle(xy, data.keypoints, self.definition)[0] for xy in (found, labels)]
            self.held_out_deg = _rms(angles[0] - angles[1])
            if state.schedule.validate(state.step, self.held_out_px):
                state.best = self.networks.state_of_average()
                state.best_step = state.step
        total = state.schedule.total
        if self.settings.consensus and CONSENSUS_FROM * total <= state.step < total:
            found = self._detect(self.networks.average, data.trained).xy
            state.targets[data.trained] = self.denoiser.targets(found)
        state.rows.append(
            {
                "step": state.step,
                "elapsed_s": round(state.elapsed_s, 1),
                "loss": round(loss, 5),
                "held_out_px": round(self.held_out_px, 4),
                "held_out_deg": round(self.held_out_deg, 4),
                "learning_rate": self._learning_rate,
            }
        )

    def _progress(self, loss: float) -> Progress:
        state = self.state
        left_s = state.elapsed_s / state.step * (state.schedule.total - state.step)
        return Progress(
            state.step,
            state.schedule.total,
            loss,
            self.held_out_px,
            self.held_out_deg,
            state.elapsed_s,
            left_s,
        )

    def finish(self) -> Checkpoint:
        """The averaged network as a checkpoint: of the last step, unless an earlier one was clearly better."""
        data, state, settings = self.data, self.state, self.settings
        network = self.networks.average
        step, held_out_px = state.step, self.held_out_px
        if state.best is not None and held_out_px > CLEARLY_WORSE * state.schedule.best_px:
            network.load_state_dict(state.best)
            step, held_out_px = state.best_step, state.schedule.best_px
        if self.denoiser.features is not None:
            found = self._detect(network, data.trained)
            network.aligner = self.denoiser.end_regressor(found.xy, settings.seed)
        found = self._detect(network, data.trained)
        labels, geometry = self.denoiser.labels, self.denoiser.geometry
        lengths = reference_distances(labels, data.reference, geometry.patch_scale)
        held_out = self._detect(network, data.held_out) if data.held_out else None
        actuators = sorted({data.frames[i].actuator for i in data.trained})
        calibration = self._calibration(network, found, held_out, len(actuators))
        training = {
            "settings": settings.to_dict(),
            "started_from": state.start,
            "known_before": state.mapping,
            "steps": state.step,
            "step_kept": step,
            "minutes": round(state.elapsed_s / 60, 2),
            "held_out_px": None if math.isnan(held_out_px) else held_out_px,
            "trained_on": [frame_id(data.frames[i]) for i in data.trained if not data.frames[i].propagated],
            "propagated": [frame_id(data.frames[i]) for i in data.trained if data.frames[i].propagated],
            "held_out": [frame_id(data.frames[i]) for i in data.held_out],
            "actuators": actuators,
            "settings_and_labels_sha256": state.identity,
        }
        return Checkpoint(
            network=network.cpu().eval(),
            backbone=settings.backbone,
            keypoints=data.keypoints,
            definition=self.definition,
            regions=data.regions,
            reference=data.reference,
            calibration=calibration,
            distance_range=tuple((float(low), float(high)) for low, high in lengths),
            training=training,
        )

    def _calibration(
        self, network: Cascade, found: Detections, held_out: Detections | None, actuators: int
    ) -> Calibration:
        """The calibration of a network, from what it finds in the frames trained on and in those held out."""
        data = self.data
        held_labels = data.labels[data.held_out] if data.held_out else None
        calibration = calibrate(found, self.denoiser.labels, held_out, held_labels, actuators)
        labelled = [i for i in data.trained if not data.frames[i].propagated]
        if len(labelled) < len(data.trained):
            # The propagated labels agree with each other: how far the clicks may be off they do not show.
            count = max(1, len(labelled) // actuators)
            variance_px2 = few_label_variance_px2(count, data.end_px(labelled))
            calibration = replace(calibration, label_sd_px=math.sqrt(count * variance_px2), n_labels=count)
        resting = resting_scale(found, self.denoiser.resting(found.xy))
        calibration = replace(calibration, resting_scale=resting)
        if network.aligner is None:
            return calibration
        calibrated, variance_px2 = calibration.apply(found), calibration.label_variance_px2
        turns = zip(network.aligner.pairs, network.aligner.turn_sd_rad, strict=True)
        return replace(
            calibration,
            end_correlation=tuple(
                (*end, end_correlation(calibrated, end, sd, variance_px2)) for end, sd in turns
            ),
        )

    def save_state(self) -> None:
        """Write all that a resumed training needs, and training.csv, each whole or not at all."""
        check_still_there(self.folder)
        save_state(self.state_file, self.state, self.networks.optimisers)
        if self.state.rows:  # none before the first evaluation
            write_rows(self.folder, self.state.rows)

    def _saved_state(self) -> TrainingState:
        """The state that was last saved; its weights are loaded into the networks."""
        if not self.state_file.is_file():
            raise TrainingError(f"--resume: expected an unfinished training in {self.folder}, got none")
        return load_state(self.state_file, self.networks.optimisers, self.data.identity(self.settings))


def _denoiser(data: TrainingData, settings: TrainingSettings, device: torch.device | None) -> TargetDenoiser:
    """The denoiser of the frames trained on; with a device, it registers moving ends there.

    Ends are registered by the shipped features, not by those of the network in training: its own features would come to
    agree with its errors.
    """
    features = shipped_features().to(device) if device is not None and settings.consensus else None
    return TargetDenoiser(
        [data.prepared[i] for i in data.trained],
        [data.images[i] for i in data.trained],
        [data.frames[i].video for i in data.trained],
        data.reference,
        settings.consensus,
        features,
    )


def _rms(values: FloatArray) -> float:
    """Root mean square of the values that are known, NaN where none is."""
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if known.size else float("nan")
