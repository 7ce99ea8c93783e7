"""Training: labelled frames in, a checkpoint out. The loop, and what is saved so that a kill loses little.

How the two networks take a step is in `pair.py`. Every random draw depends on (seed, step) only, so a training that is
resumed goes on as if it had not stopped.
"""

from __future__ import annotations

import hashlib
import json
import math
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ...tracker.angle import AngleDefinition, bending_angle
from ...tracker.errors import LabelError, TrainingError
from ...tracker.interruption import stop_event
from ...tracker.types import Detections, FloatArray, LabelledFrame
from ..data.images import frame_id, read_image
from ..data.prepared import prepare
from ..data.synthetic import rendered_frames
from ..denoising.registration import shipped_features
from ..denoising.robust_fit import systematic_bias
from ..denoising.targets import TargetDenoiser
from ..inference.bias import correct_bias
from ..inference.calibration import calibrate
from ..inference.coarse_to_fine import concatenated
from ..inference.crops import CropGeometry
from ..inference.roi import reference_distances, reference_keypoints, regions_of_interest
from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint, best_device
from ..networks.initialisation import load_backbone, resolve_init, starting_weights
from .batches import Batch, BatchSampler, crop_wh
from .keypoint_matching import match_keypoints
from .optimisation import TwoNetworkTrainer
from .schedule import Schedule
from .settings import TrainingSettings
from .split import split
from .state import STATE_FILE, TrainingState, load_state, save_state, write_rows
from .transfer import keypoint_mapping, source_checkpoint, transfer_weights

EVALUATE_EVERY = 50
"""Steps between evaluations; each is also where the state is saved: a kill costs half a minute."""

CONSENSUS_FROM = 0.3
"""Share of the steps after which positions follow the averaged network: before, it knows less than a click."""

FINISH_OF_PREPARATION = 1.6
"""Time from the last step to the checkpoint, as a multiple of the time for the first targets: both find the keypoints
in all frames and register the moving ends. Measured: 161 s and 104 s on a busy machine."""

REPLAY_FRAMES = 160
"""Rendered frames that a network which knows actuators is shown again: what it knows of them in other light and before
other backgrounds must not be lost on thirty frames of one room."""


@dataclass(frozen=True)
class Progress:
    """What a training tells after every evaluation, and after each step with the errors left as they were.

    Attributes
    ----------
    step, total : steps done and to be done (the latter may shrink)
    loss : of the step
    held_out_px, held_out_deg : root mean square error on held-out frames, NaN without any
    elapsed_s, left_s : seconds
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
    progress: Callable[[Progress], None] | None = None,
) -> Checkpoint:
    """Train a cascade on labelled frames and save it in `folder`.

    Parameters
    ----------
    frames : labelled frames; those without any label are passed over
    keypoints : names of the K keypoints
    definition : the angle, for errors in degrees and for the checkpoint
    folder : receives weights.safetensors, checkpoint.json and training.csv, and while it lasts the state
    resume : go on from the state in `folder`
    started_s : `time.monotonic()` from which `settings.max_minutes` count, the end of training included; None begins
        now. Where a state is resumed, the time that was used before it counts too.

    Returns
    -------
    Checkpoint
        The averaged network.

    Raises
    ------
    LabelError
        No labelled frames, or a picture that cannot be read.
    TrainingError
        The loss is not finite, or there is nothing fitting to resume.
    WeightsError
        The starting weights cannot be had.
    KeyboardInterrupt
        Ctrl-C. Once the first step has begun, it is finished and its state saved before.
    """
    started_s = time.monotonic() if started_s is None else started_s
    settings = settings or TrainingSettings()
    labelled = [frame for frame in frames if not np.isnan(frame.xy).all()]
    if not labelled:
        raise LabelError(f"training: expected frames with labels, got {len(frames)} without any")
    missing = [n for k, n in enumerate(keypoints) if all(np.isnan(f.xy[k]).any() for f in labelled)]
    if missing:
        raise LabelError(
            f"training: expected every keypoint in some frame, got none for {', '.join(missing)}"
        )
    trainer = _Trainer(labelled, tuple(keypoints), definition, Path(folder), settings, resume)
    if resume:
        trainer.restore()
    trainer.run(started_s, progress)
    checkpoint = trainer.finish()
    checkpoint.save(Path(folder))
    trainer.state_file.unlink(missing_ok=True)
    return checkpoint


class _Trainer:
    """The state of one training and the steps that change it."""

    def __init__(
        self,
        frames: Sequence[LabelledFrame],
        keypoints: tuple[str, ...],
        definition: AngleDefinition,
        folder: Path,
        settings: TrainingSettings,
        resume: bool,
    ) -> None:
        self.frames, self.keypoints, self.definition = frames, keypoints, definition
        self.folder = folder
        self.device = best_device()
        self.trained, self.held = split(frames, settings.held_out, settings.seed)
        self.start = resolve_init(settings.init, settings.backbone)
        self.mapping: dict[str, str] = {}
        self.settings = settings
        self._load_pictures()
        torch.manual_seed(settings.seed)
        network = Cascade(settings.backbone, len(keypoints))
        if not resume:  # a training that is resumed has its weights; those that it started from may be gone
            self._start_from(network)
        network.to(self.device)
        self.pair = TwoNetworkTrainer(
            network,
            average=settings.average,
            weight_decay=settings.weight_decay,
            locator_share=settings.locator_share_from(self.start),
        )
        self.schedule = Schedule(settings.steps_for(len(self.trained), self.start), settings.decay_share)
        self.step, self.elapsed_s = 0, 0.0
        # How long all takes that comes after the last step; measured as soon as there is something to go by.
        self.finish_s = 0.0
        self.rows: list[dict[str, float]] = []
        self.best: dict[str, Tensor] | None = None
        self.best_step = 0
        self.last_px = self.last_deg = float("nan")
        if not resume:
            self._plan_lessons()

    def _start_from(self, network: Cascade) -> None:
        source = source_checkpoint(self.start, self.settings.backbone)
        if source is not None:
            self.mapping = self._counterparts(source)
            transfer_weights(network, self.keypoints, source, self.mapping)
            return
        weights = starting_weights(self.start, self.settings.backbone)
        if weights is not None:
            load_backbone(network.locator, weights, self.start)
            load_backbone(network.refiner, weights, self.start)

    def _counterparts(self, source: Checkpoint) -> dict[str, str]:
        """The parent's keypoint for each of ours that it knows."""
        if set(self.keypoints) & set(source.keypoints):
            return keypoint_mapping(self.keypoints, source.keypoints)
        own = self.trained
        told = match_keypoints(
            source,
            self.keypoints,
            self.labels[own],
            [self.pictures[i] for i in own],
            [self.frames[i].video for i in own],
        )
        return keypoint_mapping(self.keypoints, source.keypoints, told)

    def _load_pictures(self) -> None:
        pictures = [read_image(frame) for frame in self.frames]
        sizes = [(p.shape[1], p.shape[0]) for p in pictures]
        labels = np.stack([frame.xy for frame in self.frames]).astype(np.float64)
        self.regions = regions_of_interest(labels, sizes)
        regions = {region.frame_wh: region for region in self.regions}
        self.reference = tuple(reference_keypoints(labels))
        self.prepared = [
            prepare(picture, xy, regions[size])
            for picture, xy, size in zip(pictures, labels, sizes, strict=True)
        ]
        self.labels = labels
        self.targets = labels.copy()
        # Pictures are kept for evaluation at the scales that detection cuts itself.
        self.pictures = pictures

    def _plan_lessons(self) -> None:
        """By what and beside what the labels are learnt, once it is known which keypoints the network knew."""
        knows_them = self.start == "actuator" and bool(self.mapping)
        replay = (
            rendered_frames(self.settings.seed, range(REPLAY_FRAMES), self.keypoints, self.mapping)
            if knows_them
            else []
        )
        # Not those of the network that learns: they would come to agree with its own errors.
        features = shipped_features().to(self.device) if knows_them and self.settings.consensus else None
        self.evidence = TargetDenoiser(
            [self.prepared[i] for i in self.trained],
            [self.pictures[i] for i in self.trained],
            [self.frames[i].video for i in self.trained],
            self.reference,
            self.settings.consensus,
            features,
        )
        self.lessons = BatchSampler(
            replay, crop_wh(self.regions), self.reference, self.settings.batch_frames, self.settings.seed
        )

    @property
    def state_file(self) -> Path:
        """Where a training that is not finished keeps its state."""
        return self.folder / STATE_FILE

    @property
    def identity(self) -> str:
        """Hash of all that a resumed training must have in common with the stopped one."""
        settings = {**self.settings.to_dict(), "max_minutes": None}
        digest = hashlib.sha256(json.dumps([settings, list(self.keypoints)], sort_keys=True).encode())
        for frame in self.frames:
            digest.update(f"{frame_id(frame)} {frame.actuator}".encode())
            digest.update(np.ascontiguousarray(frame.xy, dtype=np.float64).tobytes())
        return digest.hexdigest()

    def run(self, started_s: float, progress: Callable[[Progress], None] | None) -> None:
        """Train until the schedule ends."""
        begun = started_s - self.elapsed_s
        if self.settings.consensus and self.mapping and self.step == 0:
            known = np.isin(self.keypoints, list(self.mapping))
            prepared_s = time.monotonic()
            self.targets[self.trained] = self.evidence.known_before(self.pair.average.estimator(), known)
            self.finish_s = FINISH_OF_PREPARATION * (time.monotonic() - prepared_s)
        limit_s = None if self.settings.max_minutes is None else self.settings.max_minutes * 60
        first_step, first_s = self.step, time.monotonic() - begun
        with (
            ThreadPoolExecutor(max_workers=1) as pool,
            self.pair,
            stop_event(signal.SIGINT) as stop,
        ):
            batches = pool.submit(self._batches, self.step)
            while self.step < self.schedule.total:
                locate, refine = batches.result()
                batches = pool.submit(self._batches, self.step + 1)
                loss = self.pair.learn(locate, refine, self.step, self._learning_rate)
                self.step += 1
                self.elapsed_s = time.monotonic() - begun
                if limit_s is not None and self.step >= first_step + 10:
                    # What came before the first step is paid once, and what comes after the last one too.
                    step_s = (self.elapsed_s - first_s) / (self.step - first_step)
                    left_s = max(0.0, limit_s - self.elapsed_s - self.finish_s)
                    self.schedule.fit(self.step, step_s * self.step, step_s * self.step + left_s)
                if self.step % EVALUATE_EVERY == 0 or self.step == self.schedule.total:
                    # A batch is drawn from the targets as they are when its step comes: the one drawn ahead is
                    # drawn again when they change, so that a resumed training sees the same.
                    batches.result()
                    self._evaluate(loss)
                    batches = pool.submit(self._batches, self.step)
                    # An evaluation finds the keypoints once, the end of training twice.
                    self.finish_s = max(self.finish_s, 2 * (time.monotonic() - begun - self.elapsed_s))
                    self.elapsed_s = time.monotonic() - begun
                    self.save_state()
                if progress:
                    progress(self._progress(loss))
                if stop.is_set():
                    self.save_state()
                    raise KeyboardInterrupt

    def _batches(self, step: int) -> tuple[Batch, list[Batch]]:
        """What the locator and the refiner learn from in a step."""
        return self.lessons.batches(
            step, {i: replace(self.prepared[i], xy=self.targets[i]) for i in self.trained}
        )

    @property
    def _learning_rate(self) -> float:
        return self.settings.learning_rate_from(self.start) * self.schedule.factor(self.step)

    def _detect(self, network: Cascade, indices: Sequence[int]) -> Detections:
        return concatenated(
            [
                network.detect(self.pictures[i][None], CropGeometry(self.prepared[i].region, self.reference))
                for i in indices
            ]
        )

    def _evaluate(self, loss: float) -> None:
        """Judge the averaged network on the held-out frames, and let the targets follow it."""
        if self.held:
            found = self._detect(self.pair.average, self.held).xy
            self.last_px = _rms(np.linalg.norm(found - self.labels[self.held], axis=2))
            angles = [
                bending_angle(xy, self.keypoints, self.definition)[0]
                for xy in (found, self.labels[self.held])
            ]
            self.last_deg = _rms(angles[0] - angles[1])
            if self.schedule.judge(self.step, self.last_px):
                self.best = self.pair.state_of_average()
                self.best_step = self.step
        total = self.schedule.total
        if self.settings.consensus and CONSENSUS_FROM * total <= self.step < total:
            found = self._detect(self.pair.average, self.trained).xy
            self.targets[self.trained] = self.evidence.less_noisy(found)
        self.rows.append(
            {
                "step": self.step,
                "elapsed_s": round(self.elapsed_s, 1),
                "loss": round(loss, 5),
                "held_out_px": round(self.last_px, 4),
                "held_out_deg": round(self.last_deg, 4),
                "learning_rate": self._learning_rate,
            }
        )

    def _progress(self, loss: float) -> Progress:
        left = self.elapsed_s / self.step * (self.schedule.total - self.step)
        return Progress(
            self.step, self.schedule.total, loss, self.last_px, self.last_deg, self.elapsed_s, left
        )

    def finish(self) -> Checkpoint:
        """The averaged network as a checkpoint: the last, unless an earlier one was clearly better."""
        network = self.pair.average
        step, held_out_px = self.step, self.last_px
        # Held-out labels are few and carry their own error, so only a clear difference counts.
        if self.best is not None and self.last_px > 1.15 * self.schedule.best_px:
            network.load_state_dict(self.best)
            step, held_out_px = self.best_step, self.schedule.best_px
        if self.evidence.features is not None:
            found = self._detect(network, self.trained)
            network.aligner = self.evidence.aligner(found.xy, self.settings.seed)
        found = self._detect(network, self.trained)
        own, scales = self.evidence.labels, self.evidence.patch_scale
        offset = systematic_bias(found.xy, self.evidence.less_noisy(found.xy), self.reference, scales)
        found = replace(found, xy=correct_bias(found.xy, offset, self.reference, scales))
        lengths = reference_distances(own, self.reference, scales)
        held = None
        if self.held:
            held = self._detect(network, self.held)
            scales = np.array([self.prepared[i].region.refiner_scale for i in self.held])
            held = replace(held, xy=correct_bias(held.xy, offset, self.reference, scales))
        calibration = calibrate(found, own, held, self.labels[self.held] if self.held else None)
        training = {
            "settings": self.settings.to_dict(),
            "started_from": self.start,
            "known_before": self.mapping,
            "steps": self.step,
            "step_kept": step,
            "minutes": round(self.elapsed_s / 60, 2),
            "held_out_px": None if math.isnan(held_out_px) else held_out_px,
            "trained_on": [frame_id(self.frames[i]) for i in self.trained],
            "held_out": [frame_id(self.frames[i]) for i in self.held],
            "settings_and_labels_sha256": self.identity,
        }
        return Checkpoint(
            network=network.cpu().eval(),
            backbone=self.settings.backbone,
            keypoints=self.keypoints,
            definition=self.definition,
            regions=self.regions,
            reference=self.reference,
            calibration=calibration,
            systematic_bias=tuple(tuple((float(x), float(y)) for x, y in of) for of in offset),
            distance_range=tuple((float(low), float(high)) for low, high in lengths),
            training=training,
        )

    def save_state(self) -> None:
        """Write all that `restore` needs, and training.csv, both whole or not at all."""
        self.folder.mkdir(parents=True, exist_ok=True)
        save_state(
            self.state_file,
            TrainingState(
                identity=self.identity,
                step=self.step,
                elapsed_s=self.elapsed_s,
                schedule=self.schedule,
                rows=self.rows,
                best=self.best,
                best_step=self.best_step,
                targets=self.targets,
                start=self.start,
                mapping=self.mapping,
            ),
            self.pair.learners,
        )
        if self.rows:  # none before the first evaluation
            write_rows(self.folder, self.rows)

    def restore(self) -> None:
        """Go back to where a killed training last saved its state."""
        if not self.state_file.is_file():
            raise TrainingError(f"--resume: expected an unfinished training in {self.folder}, got none")
        state = load_state(self.state_file, self.pair.learners, self.identity)
        self.step, self.elapsed_s, self.schedule = state.step, state.elapsed_s, state.schedule
        self.rows, self.best, self.best_step = state.rows, state.best, state.best_step
        self.targets, self.start, self.mapping = state.targets, state.start, state.mapping
        self._plan_lessons()
        if self.rows:
            self.last_px, self.last_deg = self.rows[-1]["held_out_px"], self.rows[-1]["held_out_deg"]


def _rms(values: FloatArray) -> float:
    known = values[~np.isnan(values)]
    return float(np.sqrt((known**2).mean())) if known.size else float("nan")
