"""Self-training: a network that knows actuators in general learns one from the frames in which it is sure of it.

Nobody has labelled anything. What it finds in frames spread over a video, where it is sure, stands for labels (Lee
2013), and as they are shown turned, hidden in part and in other light, while it found them as they are, it learns to
find the actuator where it was not sure of it (Xie et al. 2020). Where it is not sure, what looks most like the moving
end is mostly something else, and it learns that too.
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
"""As of a training from what ships, but short: half a minute on two cores, and an average that forgets sooner."""

REPLAY_FRAMES = 48
"""Rendered frames that are shown again."""

MOST = 4
"""Keypoints of a frame that the refiner is shown at once, drawn anew each time."""

ODD = 1.4
"""How much less alike a moving end may look than they usually do, to learn from it."""


def alike(
    probe_frames: Frames, examples: PseudoLabels, region: RegionOfInterest, features: FirstStage
) -> BoolArray:
    """Of the frames (N,) in which the moving end is right, those in which it looks as it does in most.

    Another end that is found now and then, such as a pen's, or a tip that is half hidden, would be learnt by heart.
    The parameters are those of `self_train`; `features` is what ends are compared by.
    """
    rows = np.flatnonzero(examples.right).tolist()
    cut = [crop_end(probe_frames[i], examples.xy[i, MOVING], region).picture for i in rows]
    with torch.inference_mode():
        seen = features(torch.from_numpy(stacked(cut)).to(features.mean.device))
        scale = seen.std(dim=(0, 2, 3), correction=0)[:, None, None] + 1e-9
        away = ((seen - seen.median(dim=0).values) / scale).abs().mean(dim=1)
        apart: FloatArray = (away * window(seen)).sum(dim=(1, 2)).cpu().numpy()
    kept = examples.right.copy()
    kept[rows] = apart <= ODD * np.median(apart)
    return kept


def self_train(
    network: Cascade,
    probe_frames: Frames,
    examples: PseudoLabels,
    region: RegionOfInterest,
    reference: Sequence[int],
    progress: Callable[[int, int | None], None] | None = None,
) -> Cascade:
    """A network like `network`, which stays as it is, that has learnt an actuator.

    Parameters
    ----------
    network : finds the stream's keypoints; computes where it lies
    glimpses : (N, H, W, 3) uint8 RGB
    examples : what it learns in them; in one or more they are right
    region : of frames of this size
    partner : from `regions.partners`
    progress : called after each step with the number of steps done and to be done
    """
    own = {
        i: prepare(probe_frames[i], examples.xy[i], region) for i in np.flatnonzero(examples.right).tolist()
    }
    lessons = BatchSampler(
        rendered_frames(SETTINGS.seed, range(REPLAY_FRAMES), KEYPOINTS, {name: name for name in KEYPOINTS}),
        crop_wh([region]),
        reference,
        SETTINGS.batch_frames,
        SETTINGS.seed,
        most=MOST,
        refiner_batches=1,
        wrong=[
            _not_it(probe_frames[i], examples.xy[i], examples.wrong[i], region)
            for i in np.flatnonzero(examples.wrong.any(axis=1)).tolist()
        ],
    )
    pair = TwoNetworkTrainer(
        copy.deepcopy(network),
        average=SETTINGS.average,
        weight_decay=SETTINGS.weight_decay,
        locator_share=SETTINGS.locator_share_from(START),
    )
    schedule = Schedule(SETTINGS.steps_for(len(own), START), SETTINGS.decay_share)
    rate = SETTINGS.learning_rate_from(START)
    with ThreadPoolExecutor(max_workers=1) as pool, pair:
        following = pool.submit(lessons.batches, 0, own)
        for step in range(schedule.total):
            locate, refine = following.result()
            following = pool.submit(lessons.batches, step + 1, own)
            pair.learn(locate, refine, step, rate * schedule.factor(step))
            if progress is not None:
                progress(step + 1, schedule.total)
    return pair.average.eval()


def _not_it(picture: ImageArray, xy: FloatArray, wrong: BoolArray, region: RegionOfInterest) -> PreparedFrame:
    """A frame that shows something else at positions (K, 2) px of those points of the moving end that are wrong (2,);
    of the others nothing is said."""
    said, in_sight = np.full_like(xy, np.nan), np.ones(len(xy), bool)
    said[MOVING], in_sight[MOVING] = np.where(wrong[:, None], xy[MOVING], np.nan), ~wrong
    return prepare(picture, said, region, in_sight)
