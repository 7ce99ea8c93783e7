"""The end-pose regressor: a linear map from first-stage features of an end's crop to the error of its pose.

How it is fitted is in `denoising.end_regression`.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from ...tracker.types import FloatArray, ImageArray
from ..inference.crops import END_SIDE
from .heatmap_network import CONVOLUTIONS, STRIDE, FirstStage, HeatmapNetwork


class EndRegressionNetwork(nn.Module):
    """Pose errors of E ends in crops that were cut where the ends were found. Its weights are zero until it is fitted.

    Parameters
    ----------
    ends : int
        E.

    Attributes
    ----------
    first : FirstStage
        The first stage of the shipped network, which computes the features.
    ends : (E, 2) int64 tensor
        The two keypoints of each end.
    slope : (E, 3, C, h, w) tensor
        Weights of the features.
    rest : (E, 3) tensor
        Intercepts. The names of buffers are those of checkpoints.
    turn_sd_rad : list of float
        For each end the cross-validated standard deviation of its rotation, rad, from the fit; not in checkpoints.
    """

    ends: Tensor
    slope: Tensor
    rest: Tensor

    def __init__(self, ends: int) -> None:
        super().__init__()
        self.turn_sd_rad: list[float] = []
        self.first = FirstStage(HeatmapNetwork("resnet18", 1, 1, convolutions=CONVOLUTIONS))
        side = END_SIDE // STRIDE
        self.register_buffer("ends", torch.zeros(ends, 2, dtype=torch.int64))
        self.register_buffer("slope", torch.zeros(ends, 3, self.first.channels, side, side))
        self.register_buffer("rest", torch.zeros(ends, 3))

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The two keypoints of each end."""
        return tuple((first, second) for first, second in self.ends.tolist())

    def forward(self, images: Tensor) -> Tensor:
        """Pose corrections (N, E, 3) for `crops.move_ends`, from crops (N, 3, END_SIDE, END_SIDE) uint8 RGB."""
        features = self.first(images).flatten(1)
        steps: Tensor = (features @ self.slope.flatten(2).flatten(0, 1).T).unflatten(1, self.rest.shape)
        return steps + self.rest


class TorchEndRegressor:
    """An `EndRegressionNetwork` as a `coarse_to_fine.EndRegressor`."""

    def __init__(self, network: EndRegressionNetwork) -> None:
        self.network = network
        self.ends = network.pairs

    @torch.inference_mode()
    def __call__(self, images: ImageArray) -> FloatArray:
        """Pose corrections (N, E, 3) in crops (N, 3, END_SIDE, END_SIDE) uint8 RGB."""
        with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            steps = self.network(torch.from_numpy(images).to(self.network.rest.device))
        return steps.cpu().numpy().astype(np.float64)
