"""The heatmap network: a truncated ResNet, a decoder with lateral connections up to stride 4, and one head.

Losses on the head's maps, and their decoding to positions, are in `heatmaps`; which part of a frame is the input is in
`inference.roi`. The input is plain RGB: normalisation is part of the network, as buffers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torchvision.models import resnet18, resnet34, resnet50

BACKBONES = {"resnet18": resnet18, "resnet34": resnet34, "resnet50": resnet50}

CONVOLUTIONS = 2
"""3 x 3 convolutions kept of each stage, half of a ResNet-18's: as accurate as all on thirty frames of one actuator."""

STRIDE = 4
"""Input px per heatmap cell. Cell (row, column) covers input px STRIDE * column - 0.5 to STRIDE * column + 3.5."""

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

# Initial bias of the heatmaps, a probability of 0.01: nearly every cell is empty, and from 0.5 the first hundred steps
# would go into learning that (Lin et al. 2017, focal loss, section 4.1).
_EMPTY_CELL_LOGIT = -4.6


class Maps(NamedTuple):
    """The network's output for N images, K keypoints and h x w cells.

    Attributes
    ----------
    heat : (N, K, h, w) tensor
        Logits; their sigmoid is high at the cell that holds the keypoint.
    offset : (N, K, 2, h, w) tensor
        From the cell's centre to the keypoint, x and y in input px.
    spread : (N, K, 3, h, w) tensor
        Log sd along x and along y (of input px), and atanh of their correlation.
    """

    heat: Tensor
    offset: Tensor
    spread: Tensor


class HeatmapNetwork(nn.Module):
    """Maps of K keypoints at stride 4 from RGB images.

    Parameters
    ----------
    backbone : str
        "resnet18", "resnet34" or "resnet50": torchvision's, so its weights fit.
    stages : int
        Residual stages kept, of four; the receptive field of 3 is about 200 px.
    n_keypoints : int
        K.
    convolutions : int, optional
        3 x 3 convolutions kept of each stage, the first ones; all by default.
    width : int
        Channels of the decoder.
    """

    mean: Tensor
    std: Tensor
    cell_spread: Tensor

    def __init__(
        self,
        backbone: str,
        stages: int,
        n_keypoints: int,
        *,
        convolutions: int | None = None,
        width: int = 64,
    ) -> None:
        super().__init__()
        resnet = BACKBONES[backbone](weights=None)
        self.n_keypoints = n_keypoints
        # torchvision's names are kept, so that its state dicts load.
        self.conv1, self.bn1 = resnet.conv1, resnet.bn1
        bottleneck = backbone == "resnet50"
        # A bottleneck block holds one 3 x 3 convolution, a plain one two.
        blocks = convolutions if convolutions is None or bottleneck else convolutions // 2
        kept = [resnet.layer1, resnet.layer2, resnet.layer3, resnet.layer4][:stages]
        self.stages = nn.ModuleList([stage[:blocks] for stage in kept])
        expansion = 4 if bottleneck else 1
        self.channels = [64 * 2**i * expansion for i in range(stages)]
        self.lateral = nn.ModuleList([nn.Conv2d(c, width, 1, bias=False) for c in self.channels])
        self.smooth = nn.Sequential(
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
            nn.Conv2d(width, width, 3, padding=1, bias=False),
            nn.BatchNorm2d(width),
            nn.ReLU(inplace=True),
        )
        self.head = nn.Conv2d(width, n_keypoints * 6, 1)
        nn.init.normal_(self.head.weight, std=0.001)
        bias = torch.zeros(n_keypoints * 6)
        bias[:n_keypoints] = _EMPTY_CELL_LOGIT
        self.head.bias = nn.Parameter(bias)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1) * 255, persistent=False)
        cell = torch.tensor([math.log(STRIDE), math.log(STRIDE), 0.0]).view(1, 1, 3, 1, 1)
        self.register_buffer("cell_spread", cell, persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1) * 255, persistent=False)

    def forward(self, images: Tensor) -> Maps:
        """Maps of images.

        Parameters
        ----------
        images : (N, 3, H, W) tensor
            RGB, uint8, or float in [0, 255]; H and W are multiples of 2**(stages + 1).

        Returns
        -------
        Maps
            With h = H / STRIDE and w = W / STRIDE.
        """
        x = _stem(images, self)
        features = []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        up = self.lateral[-1](features[-1])
        for lateral, feature in zip(self.lateral[-2::-1], features[-2::-1], strict=True):
            up = F.interpolate(up, scale_factor=2.0, mode="bilinear", align_corners=False) + lateral(feature)
        maps = self.head(self.smooth(up)).float()
        n, _, h, w = maps.shape
        k = self.n_keypoints
        # The head's offsets and log spreads are in cells, the maps' in px: a head of zeros then means a spread of one
        # cell, and both losses are of the heatmap loss's size.
        return Maps(
            heat=maps[:, :k],
            offset=maps[:, k : 3 * k].reshape(n, k, 2, h, w) * STRIDE,
            spread=maps[:, 3 * k :].reshape(n, k, 3, h, w) + self.cell_spread,
        )


class FirstStage(nn.Module):
    """A network up to its first residual stage, whose weights it shares.

    Parameters
    ----------
    network : HeatmapNetwork

    Attributes
    ----------
    channels : int
        Of its features.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, network: HeatmapNetwork) -> None:
        super().__init__()
        self.conv1, self.bn1, self.stage = network.conv1, network.bn1, network.stages[0]
        self.channels = network.channels[0]
        self.register_buffer("mean", network.mean, persistent=False)
        self.register_buffer("std", network.std, persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """Features (N, channels, H / STRIDE, W / STRIDE) of images as `HeatmapNetwork.forward` takes them."""
        features: Tensor = self.stage(_stem(images, self))
        return features


def _stem(images: Tensor, network: HeatmapNetwork | FirstStage) -> Tensor:
    """Normalisation, and ResNet's layers before its first residual stage."""
    x = (images.to(network.mean.dtype) - network.mean) / network.std
    x = x.contiguous(memory_format=torch.channels_last)
    return F.max_pool2d(F.relu(network.bn1(network.conv1(x))), 3, stride=2, padding=1)
