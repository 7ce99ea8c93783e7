"""Where an end lies, told from a closer picture of it: the first residual stage of a network, and what is linear in it.

How that is learnt is in `learning/alignment.py`.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from ...tracker.types import FloatArray, ImageArray
from ..inference.crops import END_SIDE
from .heatmap_network import CONVOLUTIONS, STRIDE, FirstStage, HeatmapNetwork


class EndRegressionNetwork(nn.Module):
    """How far E ends would lie off in pictures that are cut where they may be.

    Parameters
    ----------
    ends : E

    Attributes
    ----------
    first : the first stage of the shipped network, which sees the picture
    ends : (E, 2) int64, the keypoints of each end
    slope : (E, 3, C, h, w), how much each of its features counts toward a step
    rest : (E, 3), the step where it sees nothing
    """

    ends: Tensor
    slope: Tensor
    rest: Tensor

    def __init__(self, ends: int) -> None:
        super().__init__()
        self.first = FirstStage(HeatmapNetwork("resnet18", 1, 1, convolutions=CONVOLUTIONS))
        side = END_SIDE // STRIDE
        self.register_buffer("ends", torch.zeros(ends, 2, dtype=torch.int64))
        self.register_buffer("slope", torch.zeros(ends, 3, self.first.channels, side, side))
        self.register_buffer("rest", torch.zeros(ends, 3))

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The keypoints of each end."""
        return tuple((first, second) for first, second in self.ends.tolist())

    def forward(self, images: Tensor) -> Tensor:
        """Steps (N, E, 3) as `finding.patches.move_ends` takes them, from (N, 3, END_SIDE, END_SIDE) uint8."""
        seen = self.first(images).flatten(1)
        steps: Tensor = (seen @ self.slope.flatten(2).flatten(0, 1).T).unflatten(
            1, self.rest.shape
        ) + self.rest
        return steps


class TorchEndRegressor:
    """An `EndRegressionNetwork` as a `EndRegressor`."""

    def __init__(self, aligner: EndRegressionNetwork) -> None:
        self.aligner = aligner
        self.ends = aligner.pairs

    @torch.inference_mode()
    def __call__(self, images: ImageArray) -> FloatArray:
        """Steps (N, E, 3) from images (N, 3, END_SIDE, END_SIDE) uint8."""
        with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            steps = self.aligner(torch.from_numpy(images).to(self.aligner.rest.device))
        return steps.cpu().numpy().astype(np.float64)
