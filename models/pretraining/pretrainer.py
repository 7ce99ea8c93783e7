"""Pretraining: both networks learn the canonical points of actuators in general, from rendered ones without end.

Runs for hours beside other work, or minutes where there is a GPU, can be stopped at any time and goes on where it was.
The result is a checkpoint like any other: a start for `training.py`, and what finds an actuator that nobody has
labelled. Pictures come from `rendered.py`, batches of them from `picture_pool.py`.
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
from ...tracker.synthetic.stream import KEYPOINTS, Sample
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
from ..inference.roi import RegionOfInterest
from ..networks.cascade import Cascade
from ..networks.checkpoint import Checkpoint, best_device
from ..training.optimisation import TwoNetworkTrainer
from ..training.schedule import Schedule
from ..training.settings import check_counts, check_start
from ..training.state import STATE_FILE, TrainingState, load_state, save_state, write_rows
from ..training.trainer import Progress
from ..training.transfer import ENDS, keypoint_mapping, source_checkpoint, transfer_weights
from .figure import write_curve
from .image_pool import ImagePool

AHEAD = 4
"""Steps for which each process that draws has pictures ready."""

FOUND_SHARE = 0.05
"""A keypoint counts as found within so much of the body's length."""


@dataclass(frozen=True)
class PretrainingSettings:
    """Settings of a pretraining; they travel with the checkpoint.

    Attributes
    ----------
    backbone : a key of `network.BACKBONES`
    steps : training steps; a pretraining that is resumed may be given more
    pictures : new ones in a step
    pool : the latest pictures, so many, that are learnt from
    batch : of these, so many in a step, the new ones among them; each gives the locator a crop
    patches : of each, for the refiner
    judged : pictures that are not trained on, to judge by
    judge_every : steps between looks at those; each is also where the state is saved
    learning_rate, weight_decay : AdamW's
    decay_share : share of the steps in which the learning rate falls to zero
    cell_weight : `NetworkOptimiser`'s
    average : how much of the averaged weights is kept each step
    seed : everything random follows from it; pictures that judge are drawn with the next one
    init : "random", "actuator" (the network that comes with bendtrack), or the path of a network of ours: both start
        from its weights, and `seed` must be another than its own for the pictures to be new
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
    init: str = "random"

    def __post_init__(self) -> None:
        check_start(self.backbone, self.seed)
        check_counts(steps=self.steps, pictures=self.pictures, pool=self.pool, batch=self.batch)
        check_counts(patches=self.patches, judged=self.judged, judge_every=self.judge_every)
        if not self.pictures <= self.batch <= self.pool:
            raise TrainingError(
                f"expected pictures <= batch <= pool, got {self.pictures}, {self.batch}, {self.pool}"
            )

    @property
    def identity(self) -> str:
        """Hash of what a resumed pretraining must have in common with the stopped one: all but its length."""
        free = ("steps", "decay_share", "judged", "judge_every")
        settings = {k: v for k, v in asdict(self).items() if k not in free}
        return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def usual_settings(**given: Any) -> PretrainingSettings:
    """The settings for the device that is there, but for those given.

    A GPU learns from a picture far faster than a processor draws one: larger batches, of pictures that are kept for as
    long as half of its memory allows.
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
    folder : receives weights.safetensors, checkpoint.json, training.csv, learning-curve.png and, as long as steps are
        left, the state
    resume : go on from the state in `folder`
    stop_after_s : stop then, in the middle of the schedule; what is there is saved, and so is the state
    max_s : the schedule is shortened to end by then, counted from the first step
    workers : processes that draw pictures

    Returns
    -------
    Checkpoint
        The averaged network; its keypoints are `stream.KEYPOINTS`. In the file it is in float16.

    Raises
    ------
    TrainingError
        The loss is not finite, there is nothing fitting to resume, or the network begun with has seen these pictures.
    WeightsError
        `settings.init` names no network that fits.
    """
    pretrainer = _Pretrainer(Path(folder), settings or PretrainingSettings(), resume)
    if resume:
        pretrainer.restore()
    pretrainer.run(stop_after_s, max_s, workers, progress)
    checkpoint = pretrainer.finish()
    checkpoint.save(Path(folder), half=True)
    write_curve(pretrainer.rows, Path(folder))
    if pretrainer.step == pretrainer.schedule.total:
        pretrainer.state_file.unlink(missing_ok=True)
    return checkpoint


class _Pretrainer:
    """The state of one pretraining and the steps that change it."""

    def __init__(self, folder: Path, settings: PretrainingSettings, resume: bool) -> None:
        self.folder, self.settings = folder, settings
        self.state_file = folder / STATE_FILE
        self.device = best_device()
        torch.manual_seed(settings.seed)
        network = Cascade(settings.backbone, len(KEYPOINTS))
        if settings.init != "random" and not resume:  # what is resumed has its weights
            self._start_from(network)
        self.pair = TwoNetworkTrainer(
            network.to(self.device),
            average=settings.average,
            weight_decay=settings.weight_decay,
            cell_weight=settings.cell_weight,
        )
        self.schedule = Schedule(settings.steps, settings.decay_share, warmup=200)
        self.step, self.elapsed_s = 0, 0.0
        self.rows: list[dict[str, float]] = []
        self.judged = list(rendered_samples(settings.seed + 1, range(settings.judged)))

    def _start_from(self, network: Cascade) -> None:
        init = self.settings.init
        source = source_checkpoint(init, self.settings.backbone)
        if source is None or not set(ENDS) <= set(source.keypoints):
            raise WeightsError(
                f"--init: expected random, actuator, or a network with backbone {self.settings.backbone} that was"
                f" pretrained, got {init}"
            )
        own = source.training["settings"]["seed"]
        if source.pretrained and own in (self.settings.seed, self.settings.seed + 1):
            raise TrainingError(
                f"--seed: expected one whose pictures {init} has not seen, such as {own + 2}, got {self.settings.seed}"
            )
        transfer_weights(network, KEYPOINTS, source, keypoint_mapping(KEYPOINTS, source.keypoints))

    def run(
        self,
        stop_after_s: float | None,
        max_s: float | None,
        workers: int,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        """Train until the schedule ends, or until it is time to stop."""
        settings = self.settings
        # As many as a batch takes are there at first; of a pretraining that goes on, all that were still there.
        count = settings.batch + self.step * settings.pictures
        pool = ImagePool(settings.pool, self.device)
        pool.seen = first = max(count - settings.pool, 0)
        stop_s = math.inf if stop_after_s is None else self.elapsed_s + stop_after_s
        over = self.step >= self.schedule.total
        with (
            _drawn(settings, first, count, workers) as drawn,
            self.pair,
            torch.backends.cudnn.flags(enabled=True, benchmark=True),
        ):
            while pool.seen < count:
                pool.add(next(drawn))
            begun = time.monotonic() - self.elapsed_s
            while not over:
                rng = np.random.default_rng([settings.seed, 8, self.step])
                locate, refine = pool.batches(settings.batch, settings.pictures, settings.patches, rng)
                rate = settings.learning_rate * self.schedule.factor(self.step)
                loss = self.pair.learn(locate, [refine], self.step, rate)
                self.step += 1
                pool.add(next(drawn))
                self.elapsed_s = time.monotonic() - begun
                if max_s is not None and self.step >= 100:
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
        """Judge the averaged networks on pictures that are not trained on, each network by itself."""
        located, refined = _judge(self.pair.average, self.judged)
        self.rows.append(
            {
                "step": self.step,
                "elapsed_s": round(self.elapsed_s, 1),
                "loss": round(loss, 5),
                "located_share": round(float((located <= FOUND_SHARE).mean()), 4),
                "located_median": round(float(np.median(located)), 4),
                "refined_px": round(float(np.median(refined)), 4),
                "learning_rate": rate,
            }
        )

    def finish(self) -> Checkpoint:
        """The averaged networks as a checkpoint."""
        network = self.pair.average
        found, known = _found(network, self.judged)
        peaks = reference_peaks(found.likelihood, known)
        width, height = IMAGE_WH
        # Where and at which scales to look is found anew for every video; this is what the networks have seen.
        region = RegionOfInterest(IMAGE_WH, 0, 0, width, height, LOCATOR_INPUT / max(IMAGE_WH), 1.0)
        return Checkpoint(
            network=network.cpu().eval(),
            backbone=self.settings.backbone,
            keypoints=KEYPOINTS,
            # Points along the midline are surer of their distance from it than of their place on it.
            definition=AngleDefinition("two-vector", ENDS),
            regions=(region,),
            reference=REFERENCE,
            calibration=Calibration(self._spread_scale(), 0.0, 1, peaks),
            training={
                "settings": asdict(self.settings),
                "started_from": self.settings.init,
                "steps": self.step,
                "steps_planned": self.schedule.total,
                "pictures": self.settings.batch + self.step * self.settings.pictures,
                "minutes": round(self.elapsed_s / 60, 2),
                "judged": self.rows[-1],
            },
        )

    def _spread_scale(self) -> float:
        """How uncertain the ends are, seen from near where they are: what lies elsewhere altogether is not a spread."""
        finder = self.pair.average.finder()
        ends = [KEYPOINTS.index(name) for name in ENDS]
        near = concatenated(
            [finder.refined(s.picture[None], f.xy[None], f.region, REFERENCE) for s, f in self.judged]
        )
        truth = np.stack([np.where(s.visible[:, None], f.xy, np.nan) for s, f in self.judged])
        found = Detections(near.xy[:, ends], near.likelihood[:, ends], near.covariance[:, ends])
        return typical_scale(found, truth[:, ends])

    def save_state(self) -> None:
        """Write all that `restore` needs, and training.csv."""
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
        save_state(self.state_file, state, self.pair.learners)
        write_rows(self.folder, self.rows)

    def restore(self) -> None:
        """Go back to where a stopped pretraining last saved its state."""
        if not self.state_file.is_file():
            raise TrainingError(f"--resume: expected an unfinished pretraining in {self.folder}, got none")
        state = load_state(self.state_file, self.pair.learners, self.settings.identity)
        self.step, self.elapsed_s, self.rows = state.step, state.elapsed_s, state.rows


@contextmanager
def _drawn(
    settings: PretrainingSettings, first: int, count: int, workers: int
) -> Iterator[Iterator[RenderedBatch]]:
    """The stream's pictures from number `first` on, drawn ahead by processes, as many at a time as a step takes in; one
    time ends with number `count`."""

    def numbers() -> Iterator[range]:
        start, stop = first, first + ((count - first) % settings.pictures or settings.pictures)
        while True:
            yield range(start, stop)
            start, stop = stop, stop + settings.pictures

    def pictures() -> Iterator[RenderedBatch]:
        asked = (pool.submit(render_batch, settings.seed, indices) for indices in numbers())
        ahead = deque(islice(asked, AHEAD * workers))
        while True:
            yield ahead.popleft().result()
            ahead.append(next(asked))

    # Not torch's loader: its handler of SIGCHLD and the large frames of processors with AMX do not go together with the
    # small signal stacks that some libraries set.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(
        max_workers=workers, mp_context=context, initializer=cv2.setNumThreads, initargs=(1,)
    )
    try:
        yield pictures()
    finally:
        pool.shutdown(cancel_futures=True)


def _judge(network: Cascade, judged: list[tuple[Sample, PreparedFrame]]) -> tuple[FloatArray, FloatArray]:
    """Distances of visible keypoints from the truth: located, over the body's length; refined, px of the picture."""
    finder = network.finder()
    located, refined = [], []
    for sample, frame in judged:
        picture, truth = sample.picture[None], frame.xy[None]
        seen = sample.visible
        xy, _ = finder.located(picture, frame.region)
        length = np.linalg.norm(np.diff(frame.xy, axis=0), axis=1).sum()
        located.append(np.linalg.norm(xy - truth, axis=2)[0, seen] / length)
        # The refiner by itself: from where the keypoints are.
        found = finder.refined(picture, truth, frame.region, REFERENCE)
        refined.append(np.linalg.norm(found.xy - truth, axis=2)[0, seen])
    return np.concatenate(located), np.concatenate(refined)


def _found(network: Cascade, judged: list[tuple[Sample, PreparedFrame]]) -> tuple[Detections, BoolArray]:
    """What both networks together find in pictures, and which keypoints (N, K) can be seen."""
    finder = network.finder()
    found = concatenated(
        [finder.detect(sample.picture[None], frame.region, REFERENCE) for sample, frame in judged]
    )
    return found, np.stack([sample.visible for sample, _ in judged])
