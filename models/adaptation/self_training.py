"""Self-training: a pretrained network is fitted to one actuator from the frames in which it is sure of it.

Nobody has labelled anything. What the network finds in probe frames, where it is sure, are pseudo-labels (Lee 2013).
It found them in the frames as they are, and is trained on the frames turned, partly covered and in other light: so it
learns to find the actuator where it was not sure of it (noisy student, Xie et al. 2020). Where it is not sure, what
looks most like the moving end is mostly something else: such places are negatives.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from ...tracker.synthetic.stream import KEYPOINTS
from ...tracker.types import BoolArray, FloatArray, Frames, ImageArray
from ..data.prepared import PreparedFrame, prepare
from ..data.synthetic import rendered_frames
from ..denoising.registration import window
from ..inference.affine import stacked
from ..inference.crops import crop_end
from ..inference.roi import RegionOfInterest
from ..localization.probe_frames import MOVING, PseudoLabels
from ..networks.cascade import Cascade
from ..networks.heatmap_network import FirstStage
from ..training.batches import BatchSampler, crop_wh
from ..training.optimisation import TwoNetworkTrainer
from ..training.schedule import Schedule
from ..training.settings import TrainingSettings

START = "actuator"
SETTINGS = TrainingSettings(init=START, steps=100, average=0.95)
"""Settings of a training from the shipped network, but short: half a minute on two cores, with a shorter average."""

REPLAY_FRAMES = 48
"""Rendered frames for experience replay."""

KEYPOINTS_PER_FRAME = 4
"""Keypoints of a frame in each of the refiner's batches, drawn anew each time."""

MAX_DISTANCE = 1.4
"""Largest distance in appearance of a moving end from the typical one, in medians of all, to learn from it."""


def typical_appearance(
    probe_frames: Frames, labels: PseudoLabels, region: RegionOfInterest, features: FirstStage
) -> BoolArray:
    """Outlier rejection: of the positive frames, those in which the moving end looks as it does in most.

    A pen that is taken for the end now and then, or a tip that is half hidden, would be learnt by heart.

    Parameters
    ----------
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB.
    labels : PseudoLabels
    region : RegionOfInterest
        Of frames of this size.
    features : FirstStage
        The features that ends are compared by.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    rows = np.flatnonzero(labels.positive).tolist()
    crops = [crop_end(probe_frames[i], labels.xy[i, MOVING], region).image for i in rows]
    with torch.inference_mode():
        seen = features(torch.from_numpy(stacked(crops)).to(features.mean.device))
        scale = seen.std(dim=(0, 2, 3), correction=0)[:, None, None] + 1e-9
        away = ((seen - seen.median(dim=0).values) / scale).abs().mean(dim=1)
        distance: FloatArray = (away * window(seen)).sum(dim=(1, 2)).cpu().numpy()
    kept = labels.positive.copy()
    kept[rows] = distance <= MAX_DISTANCE * np.median(distance)
    return kept


def self_train(
    network: Cascade,
    probe_frames: Frames,
    labels: PseudoLabels,
    region: RegionOfInterest,
    reference: Sequence[int],
    progress: Callable[[int, int | None], None] | None = None,
) -> Cascade:
    """Fit a copy of a network to the pseudo-labels.

    Parameters
    ----------
    network : Cascade
        Finds the stream's keypoints; stays as it is. Training runs on its device.
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB.
    labels : PseudoLabels
        At least one frame is positive.
    region : RegionOfInterest
        Of frames of this size.
    reference : sequence of int
        From `roi.reference_keypoints`.
    progress : callable, optional
        Called after each step with the number of steps done and to be done.

    Returns
    -------
    Cascade
        The averaged weights.

    Raises
    ------
    TrainingError
        The loss is not finite.
    """
    prepared = {
        i: prepare(probe_frames[i], labels.xy[i], region) for i in np.flatnonzero(labels.positive).tolist()
    }
    sampler = BatchSampler(
        rendered_frames(SETTINGS.seed, range(REPLAY_FRAMES), KEYPOINTS, {name: name for name in KEYPOINTS}),
        crop_wh([region]),
        reference,
        SETTINGS.batch_frames,
        SETTINGS.seed,
        max_keypoints=KEYPOINTS_PER_FRAME,
        refiner_batches=1,
        negatives=[
            _negative_frame(probe_frames[i], labels.xy[i], labels.negative[i], region)
            for i in np.flatnonzero(labels.negative.any(axis=1)).tolist()
        ],
    )
    trainer = TwoNetworkTrainer(
        copy.deepcopy(network),
        average=SETTINGS.average,
        weight_decay=SETTINGS.weight_decay,
        locator_share=SETTINGS.locator_share_from(START),
    )
    schedule = Schedule(SETTINGS.steps_for(len(prepared), START), SETTINGS.decay_share)
    rate = SETTINGS.learning_rate_from(START)
    with ThreadPoolExecutor(max_workers=1) as pool, trainer:
        batches = pool.submit(sampler.batches, 0, prepared)
        for step in range(schedule.total):
            locate, refine = batches.result()
            batches = pool.submit(sampler.batches, step + 1, prepared)
            trainer.learn(locate, refine, step, rate * schedule.factor(step))
            if progress is not None:
                progress(step + 1, schedule.total)
    return trainer.average.eval()


def _negative_frame(
    image: ImageArray, xy: FloatArray, negative: BoolArray, region: RegionOfInterest
) -> PreparedFrame:
    """A frame that shows something else at some positions of the moving end.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W, 3)
    xy : ndarray of float, shape (K, 2)
        Positions, px.
    negative : ndarray of bool, shape (2,)
        Points of the moving end that are negatives; all other keypoints are unlabelled in the frame.
    region : RegionOfInterest
        Of frames of this size.
    """
    labels, in_sight = np.full_like(xy, np.nan), np.ones(len(xy), bool)
    labels[MOVING], in_sight[MOVING] = np.where(negative[:, None], xy[MOVING], np.nan), ~negative
    return prepare(image, labels, region, in_sight)
