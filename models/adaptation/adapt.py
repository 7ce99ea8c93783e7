"""What is learnt of an actuator that nobody has labelled, from frames spread over its video, and put to work.

Where the network is not sure of it everywhere, it learns it (`learning.self_training`). What is seen of the moving end
is laid over each other (`learning.registration`), and from there it is learnt how it lies in closer pictures
(`learning.alignment`), as in a training; only that no label says where it lies on average.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from ...tracker.errors import TrainingError
from ...tracker.types import BoolArray, FloatArray, Frames
from ..data.prepared import prepare
from ..denoising.end_regression import fit_end_regression
from ..denoising.registration import register_ends, shipped_features
from ..export import compiled_end_regressor, compiled_networks
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.metadata import CheckpointMetadata
from ..inference.roi import RegionOfInterest
from ..localization.localize import LEAST_SURE
from ..localization.probe_frames import PseudoLabels
from ..networks.checkpoint import load_checkpoint
from ..networks.end_regressor import EndRegressionNetwork, TorchEndRegressor
from ..networks.heatmap_network import FirstStage
from .averaging import AveragedPredictor
from .self_training import alike, self_train

SEED = 0
"""The same video is measured the same way again."""


@dataclass(frozen=True, kw_only=True)
class VideoAdaptation:
    """Learns a video's actuator for a pretrained network, as `finding.sighting.sight` asks for it.

    Attributes
    ----------
    file, header : the network's checkpoint, and what it means
    before : the network at work before it has learnt anything
    device : where torch computes
    compiled : whether what is learnt is compiled for the CPU, or runs in torch
    workers, threads : as `compiled.OpenVINOPredictor`'s
    progress : called with the number of steps of a self-training done and to be done
    """

    file: Path
    header: CheckpointMetadata
    before: CoarseToFineEstimator
    device: str
    compiled: bool
    workers: int
    threads: int
    progress: Callable[[int, int | None], None] | None

    @cached_property
    def features(self) -> FirstStage:
        """What ends are compared by."""
        return shipped_features().to(self.device)

    def taught(
        self, probe_frames: Frames, examples: PseudoLabels, region: RegionOfInterest
    ) -> CoarseToFineEstimator | None:
        """A finder that has learnt the actuator, held back by what it was; None where there is too little to learn."""
        torch.set_num_threads(self.threads)
        right = alike(probe_frames, examples, region, self.features)
        if right.sum() < LEAST_SURE:
            return None
        examples = replace(examples, right=right)
        network = load_checkpoint(self.file).network.to(torch.device(self.device))
        try:
            network = self_train(
                network, probe_frames, examples, region, self.header.reference, self.progress
            )
        except TrainingError:  # it measures as well as it can without
            return None
        if self.compiled:
            finder = compiled_networks(network, self.header.peaks, self.workers, self.threads)
        else:
            finder = network.finder(self.header.peaks)
        return replace(finder, refine=AveragedPredictor(finder.refine, self.before.refine))

    def closer(
        self, probe_frames: Frames, xy: FloatArray, same: BoolArray, region: RegionOfInterest
    ) -> tuple[FloatArray, EndRegressor | None]:
        """`closer_look`, with an aligner at work."""
        torch.set_num_threads(self.threads)
        better, aligner = closer_look(probe_frames, xy, same, region, self.header.reference, self.features)
        if aligner is None:
            return better, None
        if self.compiled:
            return better, compiled_end_regressor(aligner, self.workers, self.threads)
        return better, TorchEndRegressor(aligner)


def closer_look(
    probe_frames: Frames,
    xy: FloatArray,
    same: BoolArray,
    region: RegionOfInterest,
    reference: Sequence[int],
    features: FirstStage,
) -> tuple[FloatArray, EndRegressionNetwork | None]:
    """Positions with the moving end's laid over each other, and what tells how it lies; None where pictures do not.

    Parameters
    ----------
    glimpses : (N, H, W, 3) uint8 RGB
    xy : (N, K, 2) px, found in them; the last two keypoints are the moving end
    same : (N,) bool, the frames that count; in the others nothing moves
    region : of frames of this size
    partner : from `regions.partners`
    features : what ends are compared by; the aligner is afterwards where they are
    """
    rows = np.flatnonzero(same).tolist()
    pictures, regions, video = [probe_frames[i] for i in rows], [region] * len(rows), ["glimpses"] * len(rows)
    moving = np.zeros((len(rows), xy.shape[1]), bool)
    moving[:, -2:] = True
    frames = [prepare(picture, own, region) for picture, own in zip(pictures, xy[rows], strict=True)]
    better = xy.copy()
    better[rows] = register_ends(frames, xy[rows], moving, reference, video, features)
    aligner = fit_end_regression(pictures, regions, better[rows], moving, reference, video, features, SEED)
    return better, aligner
