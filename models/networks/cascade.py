"""The two networks together: a locator that sees the whole working region small, and a refiner that looks at a patch
around each keypoint, turned upright by what was located. The refiner therefore sees every tip in the same attitude,
whatever the bend, and thirty labels of it add up. How they are put to work is in `finder.py`.
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
"""Who looks for any actuator in a whole picture needs the fourth residual stage; on thirty frames of one actuator three
find as much."""

REFINER_STAGES = 3
REFINER_WIDTH = 32
"""Two stages reach a whole patch, but weigh little of what lies away from its middle: a wide end's sides. Nothing is
gained by a wider way up."""

assert LOCATOR_MULTIPLE == 2 ** (LOCATOR_STAGES + 1)


class Cascade(nn.Module):
    """Locator and refiner for K keypoints.

    Parameters
    ----------
    backbone : a key of `network.BACKBONES`
    n_keypoints : K
    locator_stages, refiner_stages : residual stages that each has

    Attributes
    ----------
    aligner : tells how moving ends lie; None where nobody has learnt that
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
        """Two networks as one cascade, sharing their weights."""
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
