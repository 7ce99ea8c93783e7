"""The cascade of two networks: a locator on the whole region of interest at low resolution, and a refiner on a patch
around each located keypoint, rotated upright. The refiner therefore sees every tip in one orientation, whatever the
bend, so thirty labels of it add up. How the two are applied to frames is in `inference.coarse_to_fine`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from ...tracker.types import Detections, FloatArray, Frames, ImageArray
from ..inference.coarse_to_fine import LOCATOR_MULTIPLE, CoarseToFineEstimator
from ..inference.roi import RegionOfInterest
from .end_regressor import EndRegressionNetwork, TorchEndRegressor
from .heatmap_network import CONVOLUTIONS, HeatmapNetwork
from .heatmaps import decode

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

    def finder(self, peaks: int = 1) -> CoarseToFineEstimator:
        """The coarse-to-fine estimator with these networks, in float32 on the device of their weights.

        Parameters
        ----------
        peaks : int
            As `CoarseToFineEstimator`'s.
        """
        self.eval()
        locate, refine = TorchPredictor(self.locator, peaks), TorchPredictor(self.refiner)
        return CoarseToFineEstimator(
            locate, refine, peaks, TorchEndRegressor(self.aligner) if self.aligner else None
        )

    def detect(self, frames: Frames, region: RegionOfInterest, reference: Sequence[int]) -> Detections:
        """`CoarseToFineEstimator.detect` with these networks."""
        return self.finder().detect(frames, region, reference)


class TorchPredictor:
    """A network as a `coarse_to_fine.Predictor`.

    Parameters
    ----------
    network : HeatmapNetwork
        In evaluation mode.
    peaks : int
        Positions for each keypoint, as `heatmaps.decode`'s.
    """

    def __init__(self, network: HeatmapNetwork, peaks: int = 1) -> None:
        self.network = network
        self.peaks = peaks

    @torch.inference_mode()
    def __call__(self, pictures: ImageArray) -> Detections:
        """All keypoints in images (N, 3, H, W) uint8 RGB: positions and covariances in their px."""
        # TensorFloat-32 would change positions by up to a tenth of a px on a GPU.
        with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            found = decode(self.network(torch.from_numpy(pictures).to(self.network.mean.device)), self.peaks)
        return Detections(_float64(found.xy), _float64(found.likelihood), _float64(found.covariance))


def _float64(values: torch.Tensor) -> FloatArray:
    return values.cpu().numpy().astype(np.float64)
