"""Pretraining: both networks are trained on the canonical keypoints of an endless stream of rendered actuators.

Runs for hours next to other work, or for minutes on a GPU; can be stopped at any time and resumed. The result is a
checkpoint like any other: initial weights for `training`, and a zero-shot network for actuators without labels. Images
come from `data.synthetic`, batches from `image_pool`.
"""

from __future__ import annotations

import hashlib
import json
import math
import multiprocessing
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from ...tracker.angle import AngleDefinition
from ...tracker.errors import TrainingError, WeightsError
from ...tracker.synthetic.stream import KEYPOINTS, KINDS, Sample
from ...tracker.types import BoolArray, Detections, FloatArray
from ..data.prepared import PreparedFrame
from ..data.synthetic import (
    IMAGE_SIDE,
    IMAGE_WH,
    LOCATOR_INPUT,
    REFERENCE,
    RenderedBatch,
    render_batch,
    rendered_samples,
)
from ..inference.calibration import Calibration, reference_peaks, typical_scale
from ..inference.coarse_to_fine import concatenated
from ..inference.crops import CropGeometry
from ..inference.metadata import later_than
from ..inference.roi import RegionOfInterest
from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint, best_device
from ..networks.initialisation import random_cascade
from ..training.optimisation import TwoNetworkTrainer
from ..training.schedule import Schedule
from ..training.settings import check_counts, check_start
from ..training.state import STATE_FILE, TrainingState, load_state, save_state, write_rows
from ..training.trainer import Progress
from ..training.transfer import ENDS, keypoint_mapping, source_checkpoint, transfer_weights
from .figure import write_curve
from .image_pool import ImagePool

PREFETCH_STEPS = 4
"""Steps whose images each rendering process has ready ahead of time."""

LOCATED_WITHIN = 0.05
"""A keypoint counts as located within this distance of the truth, in body lengths."""

STEPS_TO_TIME = 100
"""Steps after which the schedule is fitted to a time limit: the first ones are slower than the rest."""

WARMUP_STEPS = 200
"""Steps in which the learning rate rises: longer than in a training, which starts from better weights."""


@dataclass(frozen=True)
class PretrainingSettings:
    """Settings of a pretraining; they are saved with the checkpoint, so their names are part of its format.

    Attributes
    ----------
    backbone : str
        A key of `heatmap_network.BACKBONES`.
    steps : int
        Training steps; a resumed pretraining may be given more.
    pictures : int
        Images newly rendered for each step.
    pool : int
        Latest images that batches are drawn from.
    batch : int
        Images in a step, the new ones among them; each gives the locator one crop.
    patches : int
        Patches of each image for the refiner.
    judged : int
        Validation images, which are not trained on.
    judge_every : int
        Steps between validations; the state is saved at each.
    learning_rate, weight_decay : float
        AdamW's.
    decay_share : float
        Share of the steps in which the learning rate falls to zero.
    cell_weight : float
        `NetworkOptimiser`'s.
    average : float
        Decay of the exponential moving average of the weights.
    seed : int
        Every random draw follows from it; validation images are rendered with the next seed.
    kinds : tuple of str
        Kinds of extras that are drawn on top of the looks, of `stream.KINDS`. Validation images have none: their errors
        compare with those of earlier networks.
    init : str
        "random", "actuator" (the shipped network), or the path of a network of ours; its `seed` must differ from this
        one's, so that the images are new to it.

    Raises
    ------
    TrainingError
        A setting is out of its range.
    """

    backbone: str = "resnet18"
    steps: int = 30_000
    pictures: int = 16
    pool: int = 4096
    batch: int = 32
    patches: int = 2
    judged: int = 128
    judge_every: int = 250
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    decay_share: float = 0.4
    cell_weight: float = 1.0
    average: float = 0.998
    seed: int = 0
    kinds: tuple[str, ...] = KINDS
    init: str = "random"

    def __post_init__(self) -> None:
        check_start(self.backbone, self.seed)
        check_counts(steps=self.steps, pictures=self.pictures, pool=self.pool, batch=self.batch)
        check_counts(patches=self.patches, judged=self.judged, judge_every=self.judge_every)
        if not self.pictures <= self.batch <= self.pool:
            raise TrainingError(
                f"expected pictures <= batch <= pool, got {self.pictures}, {self.batch}, {self.pool}"
            )
        for kind in self.kinds:
            if kind not in KINDS:
                raise TrainingError(f"kinds: expected one of {', '.join(KINDS)}, got {kind!r}")

    @property
    def identity(self) -> str:
        """SHA-256 of what a resumed pretraining must share with the stopped one: all but its length and validation."""
        free = ("steps", "decay_share", "judged", "judge_every")
        settings = {k: v for k, v in asdict(self).items() if k not in free}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def usual_settings(**given: Any) -> PretrainingSettings:
    """Default settings for this machine's device.

    A GPU takes a step far faster than a CPU renders its images: there batches are larger, and the pool is as large as
    half of the GPU's memory allows.

    Parameters
    ----------
    **given
        Settings that replace the defaults.

    Returns
    -------
    PretrainingSettings

    Raises
    ------
    TrainingError
        A setting is out of its range.
    """
    device = best_device()
    if device.type != "cuda":
        return PretrainingSettings(**given)
    room = torch.cuda.get_device_properties(device).total_memory // 2
    pool = max(512, min(room // (3 * IMAGE_SIDE**2), 250_000))
    usual = {
        "pictures": 36,
        "batch": 512,
        "patches": 4,
        "average": 0.999,
        "decay_share": 0.5,
        "judge_every": 1000,
    }
    return PretrainingSettings(**{**usual, "pool": pool, **given})


def pretrain(
    folder: Path,
    settings: PretrainingSettings | None = None,
    *,
    resume: bool = False,
    stop_after_s: float | None = None,
    max_s: float | None = None,
    workers: int = 1,
    progress: Callable[[Progress], None] | None = None,
) -> Checkpoint:
    """Pretrain a cascade on rendered actuators and save it in `folder`.

    Parameters
    ----------
    folder : Path
        Receives weights.safetensors, checkpoint.json, training.csv and learning-curve.png, and the state file as long
        as steps are left.
    settings : PretrainingSettings, optional
    resume : bool
        Continue from the state file in `folder`.
    stop_after_s : float, optional
        Stop after so many seconds, within the schedule; checkpoint and state are saved.
    max_s : float, optional
        Shorten the schedule to end after so many seconds, counted from the first step.
    workers : int
        Processes that render images.
    progress : callable, optional
        Called after each step.

    Returns
    -------
    Checkpoint
        The averaged network, saved in float16; its keypoints are `stream.KEYPOINTS`.

    Raises
    ------
    TrainingError
        The loss is not finite, there is no state file that fits, or the initial network was trained on these images.
    WeightsError
        `settings.init` is no network that fits.
    """
    pretrainer = _Pretrainer(Path(folder), settings or PretrainingSettings(), resume=resume)
    pretrainer.run(stop_after_s, max_s, workers, progress)
    checkpoint = pretrainer.finish()
    checkpoint.save(Path(folder), half=True)
    write_curve(pretrainer.rows, Path(folder))
    if pretrainer.step == pretrainer.schedule.total:
        pretrainer.state_file.unlink(missing_ok=True)
    return checkpoint


class _Pretrainer:
    """One pretraining: its networks, and the state that its steps change.

    Parameters
    ----------
    folder : Path
        Where the state is saved.
    settings : PretrainingSettings
    resume : bool
        Begin with the state file in `folder`.

    Raises
    ------
    TrainingError, WeightsError
        As `pretrain`'s.
    """

    def __init__(self, folder: Path, settings: PretrainingSettings, *, resume: bool) -> None:
        self.folder, self.settings = folder, settings
        self.state_file = folder / STATE_FILE
        self.device = best_device()
        network = random_cascade(settings.backbone, len(KEYPOINTS), settings.seed)
        if (
            settings.init != "random" and not resume
        ):  # a resumed pretraining has its weights in the state file
            _load_initial_weights(network, settings)
        self.networks = TwoNetworkTrainer(
            network.to(self.device),
            average=settings.average,
            weight_decay=settings.weight_decay,
            cell_weight=settings.cell_weight,
        )
        self.schedule = Schedule(settings.steps, settings.decay_share, warmup=WARMUP_STEPS)
        self.step, self.elapsed_s = 0, 0.0
        self.rows: list[dict[str, float]] = []
        if resume:
            state = self._saved_state()
            self.step, self.elapsed_s, self.rows = state.step, state.elapsed_s, state.rows
        self.validation = list(rendered_samples(settings.seed + 1, range(settings.judged)))

    def run(
        self,
        stop_after_s: float | None,
        max_s: float | None,
        workers: int,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        """Train until the schedule ends, or until it is time to stop."""
        settings = self.settings
        # At first the pool holds one batch; of a resumed pretraining, all images that it still held.
        count = settings.batch + self.step * settings.pictures
        pool = ImagePool(settings.pool, self.device)
        pool.added = first = max(count - settings.pool, 0)
        stop_s = math.inf if stop_after_s is None else self.elapsed_s + stop_after_s
        over = self.step >= self.schedule.total
        with (
            _rendered(settings, first, count, workers) as rendered,
            self.networks,
            torch.backends.cudnn.flags(enabled=True, benchmark=True),
        ):
            while pool.added < count:
                pool.add(next(rendered))
            begun = time.monotonic() - self.elapsed_s
            while not over:
                rng = np.random.default_rng([settings.seed, 8, self.step])
                locate, refine = pool.batches(settings.batch, settings.pictures, settings.patches, rng)
                rate = settings.learning_rate * self.schedule.factor(self.step)
                loss = self.networks.learn(locate, [refine], self.step, rate)
                self.step += 1
                pool.add(next(rendered))
                self.elapsed_s = time.monotonic() - begun
                if max_s is not None and self.step >= STEPS_TO_TIME:
                    self.schedule.fit(self.step, self.elapsed_s, max_s)
                over = self.step == self.schedule.total or self.elapsed_s >= stop_s
                if self.step % settings.judge_every == 0 or over:
                    self._evaluate(loss, rate)
                    self.elapsed_s = time.monotonic() - begun
                    self.save_state()
                if progress:
                    left = self.elapsed_s / self.step * (self.schedule.total - self.step)
                    px = self.rows[-1]["refined_px"] if self.rows else math.nan
                    total = self.schedule.total
                    progress(Progress(self.step, total, loss, px, math.nan, self.elapsed_s, left))

    def _evaluate(self, loss: float, rate: float) -> None:
        """Validate the averaged networks, each by itself, on images that are not trained on."""
        located, refined = _validation_errors(self.networks.average, self.validation)
        self.rows.append(
            {
                "step": self.step,
                "elapsed_s": round(self.elapsed_s, 1),
                "loss": round(loss, 5),
                "located_share": round(float((located <= LOCATED_WITHIN).mean()), 4),
                "located_median": round(float(np.median(located)), 4),
                "refined_px": round(float(np.median(refined)), 4),
                "learning_rate": rate,
            }
        )

    def finish(self) -> Checkpoint:
        """The averaged networks as a checkpoint."""
        network = self.networks.average
        found, visible = _detected(network, self.validation)
        peaks = reference_peaks(found.likelihood, visible)
        width, height = IMAGE_WH
        # Every video gets its own region and scales; these are the ones trained on.
        region = RegionOfInterest(IMAGE_WH, 0, 0, width, height, LOCATOR_INPUT / max(IMAGE_WH), 1.0)
        return Checkpoint(
            network=network.cpu().eval(),
            backbone=self.settings.backbone,
            keypoints=KEYPOINTS,
            # Of the keypoints along the midline only the distance from it is certain, not the position on it.
            definition=AngleDefinition("two-vector", ENDS),
            regions=(region,),
            reference=REFERENCE,
            kind="pretrained",
            calibration=Calibration(self._spread_scale(), 0.0, 1, peaks),
            training={
                "settings": asdict(self.settings),
                "started_from": self.settings.init,
                "steps": self.step,
                "steps_planned": self.schedule.total,
                "pictures": self.settings.batch + self.step * self.settings.pictures,
                "minutes": round(self.elapsed_s / 60, 2),
                "judged": self.rows[-1],
                "trained_at": later_than(None),
            },
        )

    def _spread_scale(self) -> float:
        """Factor on the ends' predicted covariances, from patches around the truth: a wrong detection is no spread."""
        estimator = self.networks.average.estimator()
        ends = [KEYPOINTS.index(name) for name in ENDS]
        near = concatenated(
            [estimator.refine(s.image[None], f.xy[None], _geometry(f)) for s, f in self.validation]
        )
        truth = np.stack([np.where(s.visible[:, None], f.xy, np.nan) for s, f in self.validation])
        found = Detections(near.xy[:, ends], near.likelihood[:, ends], near.covariance[:, ends])
        return typical_scale(found, truth[:, ends])

    def save_state(self) -> None:
        """Write all that a resumed pretraining needs, and training.csv."""
        self.folder.mkdir(parents=True, exist_ok=True)
        no_labels = np.empty((0, len(KEYPOINTS), 2))
        state = TrainingState(
            identity=self.settings.identity,
            step=self.step,
            elapsed_s=self.elapsed_s,
            schedule=self.schedule,
            rows=self.rows,
            best=None,
            best_step=0,
            targets=no_labels,
            start=self.settings.init,
            mapping={},
        )
        save_state(self.state_file, state, self.networks.optimisers)
        write_rows(self.folder, self.rows)

    def _saved_state(self) -> TrainingState:
        """The state that was last saved; its weights are loaded into the networks."""
        if not self.state_file.is_file():
            raise TrainingError(f"--resume: expected an unfinished pretraining in {self.folder}, got none")
        return load_state(self.state_file, self.networks.optimisers, self.settings.identity)


def _load_initial_weights(network: Cascade, settings: PretrainingSettings) -> None:
    """Load the weights that `settings.init` names into a network."""
    init = settings.init
    source = source_checkpoint(init, settings.backbone)
    if source is None or not set(ENDS) <= set(source.keypoints):
        raise WeightsError(
            f"--init: expected random, actuator, or a network with backbone {settings.backbone} that was"
            f" pretrained, got {init}"
        )
    source_seed = source.training["settings"]["seed"]
    if source.pretrained and source_seed in (settings.seed, settings.seed + 1):
        raise TrainingError(
            f"--seed: expected one whose pictures {init} has not seen, such as {source_seed + 2}, got {settings.seed}"
        )
    transfer_weights(network, KEYPOINTS, source, keypoint_mapping(KEYPOINTS, source.keypoints))


@contextmanager
def _rendered(
    settings: PretrainingSettings, first: int, count: int, workers: int
) -> Iterator[Iterator[RenderedBatch]]:
    """Images of the stream from index `first` on, rendered ahead of time by processes.

    They come in batches of as many as a step adds; the first batch may be smaller, so that one ends before `count`.
    """

    def batches_of_indices() -> Iterator[range]:
        start, stop = first, first + ((count - first) % settings.pictures or settings.pictures)
        while True:
            yield range(start, stop)
            start, stop = stop, stop + settings.pictures

    def batches() -> Iterator[RenderedBatch]:
        submitted = (
            pool.submit(render_batch, settings.seed, indices, settings.kinds)
            for indices in batches_of_indices()
        )
        ahead = deque(islice(submitted, PREFETCH_STEPS * workers))
        while True:
            yield ahead.popleft().result()
            ahead.append(next(submitted))

    # Not torch's DataLoader: its SIGCHLD handler needs more stack on processors with AMX than the small signal stacks
    # that some libraries set.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        max_workers=workers, mp_context=context, initializer=cv2.setNumThreads, initargs=(1,)
    )
    try:
        yield batches()
    finally:
        pool.shutdown(cancel_futures=True)


def _geometry(frame: PreparedFrame) -> CropGeometry:
    """How a rendered frame is cropped."""
    return CropGeometry(frame.region, REFERENCE)


def _validation_errors(
    network: Cascade, validation: list[tuple[Sample, PreparedFrame]]
) -> tuple[FloatArray, FloatArray]:
    """Distances of visible keypoints from the truth: the locator's in body lengths, and the refiner's in image px."""
    estimator = network.estimator()
    located, refined = [], []
    for sample, frame in validation:
        image, truth = sample.image[None], frame.xy[None]
        visible = sample.visible
        xy = estimator.propose(image, _geometry(frame)).xy
        length = np.linalg.norm(np.diff(frame.xy, axis=0), axis=1).sum()
        located.append(np.linalg.norm(xy - truth, axis=2)[0, visible] / length)
        # The refiner by itself: from the true positions.
        found = estimator.refine(image, truth, _geometry(frame))
        refined.append(np.linalg.norm(found.xy - truth, axis=2)[0, visible])
    return np.concatenate(located), np.concatenate(refined)


def _detected(
    network: Cascade, validation: list[tuple[Sample, PreparedFrame]]
) -> tuple[Detections, BoolArray]:
    """Detections of both networks together in validation images, and which keypoints (N, K) are visible."""
    estimator = network.estimator()
    found = concatenated(
        [estimator.detect(sample.image[None], _geometry(frame)) for sample, frame in validation]
    )
    return found, np.stack([sample.visible for sample, _ in validation])
