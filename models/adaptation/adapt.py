"""Adaptation to one video without labels: what `localization.localize.find_actuator` asks a pretrained network for.

Where the network is not sure of the actuator everywhere, it is fitted to the video (`self_training.py`). The moving
end's crops are registered to each other (`denoising/registration.py`), and an end regressor is fitted to them
(`denoising/end_regression.py`), as in a training; only that no label says where the end lies on average.
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
from ..inference.coarse_to_fine import CoarseToFineEstimator, EndRegressor
from ..inference.metadata import CheckpointMetadata
from ..inference.roi import RegionOfInterest
from ..localization.localize import MIN_SURE
from ..localization.probe_frames import PseudoLabels
from ..networks.checkpoint import load_checkpoint
from ..networks.conversion import compiled_end_regressor, compiled_networks
from ..networks.end_regressor import EndRegressionNetwork, TorchEndRegressor
from ..networks.heatmap_network import FirstStage
from ..networks.torch_threads import limited_threads
from .averaging import AveragedPredictor
from .self_training import self_train, typical_appearance

SEED = 0
"""The same video is measured the same way again."""


@dataclass(frozen=True, kw_only=True)
class VideoAdaptation:
    """Fits a pretrained network to one video.

    Attributes
    ----------
    file : Path
        The network's checkpoint.
    metadata : CheckpointMetadata
    source : CoarseToFineEstimator
        The network before adaptation.
    device : str
        Where torch computes.
    compiled : bool
        Whether fitted networks are compiled for the CPU, or run in torch.
    workers, threads : int
        As `OpenVINOPredictor`'s.
    progress : callable or None
        Called with the number of self-training steps done and to be done.
    """

    file: Path
    metadata: CheckpointMetadata
    source: CoarseToFineEstimator
    device: str
    compiled: bool
    workers: int
    threads: int
    progress: Callable[[int, int | None], None] | None

    @cached_property
    def features(self) -> FirstStage:
        """The features that ends are compared by."""
        return shipped_features().to(self.device)

    def fit_network(
        self, probe_frames: Frames, labels: PseudoLabels, region: RegionOfInterest
    ) -> CoarseToFineEstimator | None:
        """Self-train on the probe frames, and average with the source network.

        Parameters
        ----------
        probe_frames : ndarray of uint8, shape (N, H, W, 3)
        labels : PseudoLabels
        region : RegionOfInterest
            Of frames of this size.

        Returns
        -------
        CoarseToFineEstimator or None
            None where there are too few pseudo-labels, or training fails.
        """
        with limited_threads(self.threads):
            kept = typical_appearance(probe_frames, labels, region, self.features)
            if kept.sum() < MIN_SURE:
                return None
            labels = replace(labels, positive=kept)
            network = load_checkpoint(self.file).network.to(torch.device(self.device))
            try:
                network = self_train(
                    network, probe_frames, labels, region, self.metadata.reference, self.progress
                )
            except TrainingError:  # the source network measures as well as it can
                return None
            candidates = self.metadata.candidates
            if self.compiled:
                estimator = compiled_networks(network, candidates, self.workers, self.threads)
            else:
                estimator = network.estimator(candidates)
        averaged = AveragedPredictor(estimator.refiner, self.source.refiner)
        return replace(estimator, refiner=averaged, stages=self.source.stages)

    def fit_ends(
        self,
        probe_frames: Frames,
        xy: FloatArray,
        inlier: BoolArray,
        region: RegionOfInterest,
        base_moves: bool = False,
    ) -> tuple[FloatArray, EndRegressor | None]:
        """`register_and_fit`, with the regressor ready to run."""
        with limited_threads(self.threads):
            registered, network = register_and_fit(
                probe_frames, xy, inlier, region, self.metadata.reference, self.features, base_moves
            )
            if network is None:
                return registered, None
            if self.compiled:
                return registered, compiled_end_regressor(network, self.workers, self.threads)
        return registered, TorchEndRegressor(network)


def register_and_fit(
    probe_frames: Frames,
    xy: FloatArray,
    inlier: BoolArray,
    region: RegionOfInterest,
    reference: Sequence[int],
    features: FirstStage,
    base_moves: bool = False,
) -> tuple[FloatArray, EndRegressionNetwork | None]:
    """Register the moving end over the probe frames, and fit an end regressor to it.

    Parameters
    ----------
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB.
    xy : ndarray of float, shape (N, K, 2)
        Positions found in them, px; the last two keypoints are the moving end.
    inlier : ndarray of bool, shape (N,)
        Frames that are used; positions in the others stay.
    region : RegionOfInterest
        Of frames of this size.
    reference : sequence of int
        From `roi.reference_keypoints`.
    features : FirstStage
        The features that ends are compared by. The regressor lies on their device.
    base_moves : bool, optional
        Whether the first two keypoints, the fixed end, move too and are treated like the last two.

    Returns
    -------
    xy : ndarray of float, shape (N, K, 2)
        Positions with the moving end registered.
    network : EndRegressionNetwork or None
        None where the end's crops do not show its pose.
    """
    rows = np.flatnonzero(inlier).tolist()
    images, regions, video = [probe_frames[i] for i in rows], [region] * len(rows), ["probe"] * len(rows)
    moving = np.zeros((len(rows), xy.shape[1]), bool)
    moving[:, -2:] = True
    moving[:, :2] = base_moves
    frames = [prepare(image, own, region) for image, own in zip(images, xy[rows], strict=True)]
    registered = xy.copy()
    registered[rows] = register_ends(frames, xy[rows], moving, reference, video, features)
    network = fit_end_regression(images, regions, registered[rows], moving, reference, video, features, SEED)
    return registered, network
