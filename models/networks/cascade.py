"""The cascade of two networks: a locator on the whole region of interest at low resolution, and a refiner on a patch
around each located keypoint, rotated upright. The refiner therefore sees every tip in one orientation, whatever the
bend, so thirty labels of it add up. How the two are applied to frames is in `inference.coarse_to_fine`.
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import torch
from torch import nn

from ...tracker.types import Detections, FloatArray, Frames, ImageArray
from ..inference.coarse_to_fine import LOCATOR_MULTIPLE, CoarseToFineEstimator
from ..inference.crops import CropGeometry
from .end_regressor import EndRegressionNetwork, TorchEndRegressor
from .heatmap_network import CONVOLUTIONS, HeatmapNetwork
from .heatmaps import decode
from .torch_threads import limited_threads

LOCATOR_STAGES = 4
"""Residual stages of the locator. To find any actuator in a whole image it needs the fourth; on thirty frames of one
actuator three are as accurate."""

REFINER_STAGES = 3
REFINER_WIDTH = 32
"""Residual stages of the refiner and channels of its decoder. The receptive field of two stages covers a patch, but
weighs little of what lies off its centre, such as the sides of a wide end. A wider decoder gains nothing."""

assert LOCATOR_MULTIPLE == 2 ** (LOCATOR_STAGES + 1)


class Cascade(nn.Module):
    """Locator and refiner for K keypoints, with random weights.

    Parameters
    ----------
    backbone : str
        A key of `heatmap_network.BACKBONES`.
    n_keypoints : int
        K.
    locator_stages, refiner_stages : int
        Residual stages of each network.

    Attributes
    ----------
    locator, refiner : HeatmapNetwork
    aligner : EndRegressionNetwork or None
        The end-pose regressor of the moving ends, under the name that it has in checkpoints; None where none is fitted.
    """

    aligner: EndRegressionNetwork | None

    def __init__(
        self,
        backbone: str,
        n_keypoints: int,
        locator_stages: int = LOCATOR_STAGES,
        refiner_stages: int = REFINER_STAGES,
    ) -> None:
        super().__init__()
        self.locator = HeatmapNetwork(backbone, locator_stages, n_keypoints, convolutions=CONVOLUTIONS)
        self.refiner = HeatmapNetwork(
            backbone, refiner_stages, n_keypoints, convolutions=CONVOLUTIONS, width=REFINER_WIDTH
        )
        self.aligner = None

    @classmethod
    def of(cls, locator: HeatmapNetwork, refiner: HeatmapNetwork) -> Cascade:
        """A cascade of two networks, which keep their weights: nothing is copied."""
        whole = cls.__new__(cls)
        nn.Module.__init__(whole)
        whole.locator, whole.refiner, whole.aligner = locator, refiner, None
        return whole

    def estimator(self, candidates: int = 1, threads: int | None = None) -> CoarseToFineEstimator:
        """The networks at work in float32, where their weights lie.

        Parameters
        ----------
        candidates : int, optional
            As `CoarseToFineEstimator`'s.
        threads : int, optional
            Cores for torch in each call; by default as many as torch is set to.
        """
        self.eval()
        locator = TorchPredictor(self.locator, candidates, threads)
        refiner = TorchPredictor(self.refiner, threads=threads)
        regressor = TorchEndRegressor(self.aligner) if self.aligner else None
        return CoarseToFineEstimator(locator, refiner, candidates, regressor)

    def detect(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """`CoarseToFineEstimator.detect` with these networks."""
        return self.estimator().detect(frames, geometry)


class TorchPredictor:
    """A network as a `Predictor`.

    Parameters
    ----------
    network : HeatmapNetwork
    candidates : int, optional
        Candidate peaks that are read for each keypoint.
    threads : int, optional
        Cores for torch in each call; by default as many as torch is set to.
    """

    def __init__(self, network: HeatmapNetwork, candidates: int = 1, threads: int | None = None) -> None:
        self.network = network
        self.candidates = candidates
        self.threads = threads

    @torch.inference_mode()
    def __call__(self, images: ImageArray) -> Detections:
        """Predict every keypoint in images (N, 3, H, W) uint8."""
        threads = limited_threads(self.threads) if self.threads else nullcontext()
        # TensorFloat-32 would round a GPU's positions by up to a tenth of a px; float32 is what is promised.
        with threads, torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            maps = self.network(torch.from_numpy(images).to(self.network.mean.device))
            found = decode(maps, self.candidates)
        return Detections(_float64(found.xy), _float64(found.likelihood), _float64(found.covariance))


def _float64(values: torch.Tensor) -> FloatArray:
    return values.cpu().numpy().astype(np.float64)
