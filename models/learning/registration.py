"""A moving end is rigid: what is seen of it in all labelled frames of a video is laid over each other.

How an end lies in two frames relative to each other is seen in the pictures far more exactly than in two clicks, and
with other errors than a network's own: outlines, marks and chambers count as far as they look the same wherever the end
turns, light and background hardly do. What is compared are the features of the first residual stage of what comes with
bendtrack; where an end lies on average is what labels and network say (`consensus`).

All frames are aligned to their mean at once (congealing, Learned-Miller 2006), each by Gauss-Newton steps (Baker &
Matthews 2004, inverse compositional), every feature weighed by how little it varies from frame to frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray
from ..checkpoint import load_checkpoint
from ..finding.regions import turned
from ..finding.views import PATCH_SIDE, centred_view
from ..network import STRIDE, HeatmapNetwork
from ..shipped import shipped_network
from .dataset import PreparedFrame

CLOSER = 2.0
"""Pictures of an end show as much as a refiner's patch, so many times as large, features two of its px apart."""

SIDE = round(CLOSER * PATCH_SIDE)

WINDOW = SIDE / 4
"""Standard deviation of how much a place counts by its distance from the end's middle, px of such a picture."""

STEPS = 8
LARGEST_PX, LARGEST_RAD = 2.0, 0.1
"""Steps taken, and no step moves or turns an end further. With half as many again frames agree better with each other
but less with the truth."""

FAR_PX, FAR_RAD = 8.0, 0.25
"""An end that all steps together carry further does not look like the others: it stays where it was."""

ALWAYS = 0.01
"""Share of a feature's variance over all places that it has everywhere, however little it varies in these frames."""

LEAST, MOST = 5, 128
"""Frames that are laid over each other at once: fewer do not tell what varies, more would fill the memory."""


def shipped_refiner() -> HeatmapNetwork:
    """The network whose first features ends are compared by, whatever the backbone of the one that learns."""
    refiner: HeatmapNetwork = load_checkpoint(shipped_network("resnet18")).network.refiner
    return refiner.eval()


def registered(
    frames: Sequence[PreparedFrame],
    xy: FloatArray,
    known: BoolArray,
    partner: Sequence[int],
    videos: Sequence[str],
    features: HeatmapNetwork,
) -> FloatArray:
    """Positions of moving ends that make their pictures the same, near to the given ones and with the same mean.

    An end is two keypoints that are each other's partner.

    Parameters
    ----------
    frames : N frames
    xy : (N, K, 2) px
    known : (N, K), which positions are believed; an end with another stays where it is
    partner : from `regions.partners`
    videos : which video each of the frames is from
    features : the network whose first ones are compared, in evaluation mode
    """
    xy = xy.copy()
    ends = [(k, p) for k, p in enumerate(partner) if k < p and partner[p] == k]
    for end in map(list, ends):
        for video in sorted(set(videos)):
            rows = [i for i, own in enumerate(videos) if own == video and known[i, end].all()]
            moves = len(rows) >= LEAST and np.ptp(xy[rows][:, end], axis=0).any(axis=1).all()
            # Every part has frames of the whole video.
            parts = -(-len(rows) // MOST)
            for some in (rows[part::parts] for part in range(parts if moves else 0)):
                xy[np.ix_(some, end)] = _registered(
                    [frames[i] for i in some], xy[np.ix_(some, end)], features
                )
    return xy


def _registered(frames: Sequence[PreparedFrame], xy: FloatArray, features: HeatmapNetwork) -> FloatArray:
    """`registered` for one end (N, 2, 2) in frames of one video."""
    views = [frame.fine_view for frame in frames]
    ends = np.stack([view.to_input(own) for view, own in zip(views, xy, strict=True)])
    zoom = CLOSER * np.array([frame.region.magnification for frame in frames])
    middle = ends.mean(axis=1)
    half: FloatArray = (ends[:, 1] - ends[:, 0]) / 2
    moved, turn = np.zeros_like(middle), np.zeros(len(frames))
    for _ in range(STEPS):
        direction = np.arctan2(half[:, 1], half[:, 0]) + turn
        pictures = [
            centred_view(at, (SIDE, SIDE), by, towards).cut(frame.fine)
            for frame, at, by, towards in zip(frames, middle + moved, zoom, direction, strict=True)
        ]
        images = torch.from_numpy(np.ascontiguousarray(np.stack(pictures).transpose(0, 3, 1, 2)))
        with torch.inference_mode():
            step: FloatArray = _step(features.first_features(images.to(features.mean.device)))
        moved += turned(step[:, :2] / zoom[:, None], direction)
        turn += step[:, 2]
    far = (np.linalg.norm(moved, axis=1) * zoom > FAR_PX) | (np.abs(turn) > FAR_RAD)
    moved[far], turn[far] = 0.0, 0.0
    half = turned(half, turn)
    ends = (middle + moved)[:, None] + np.stack([-half, half], axis=1)
    return np.stack([view.to_source(own) for view, own in zip(views, ends, strict=True)])


def _step(seen: Tensor) -> FloatArray:
    """How far what is seen, features (N, C, h, w), lies off its mean: x and y px and radians about the middle, (N, 3),
    less their own mean."""
    n, _, h, w = seen.shape
    y, x = (STRIDE * (torch.arange(side, device=seen.device) - (side - 1) / 2) for side in (h, w))
    x, y = x.expand(h, w), y[:, None].expand(h, w)
    mean, variance = seen.mean(dim=0), seen.var(dim=0, correction=0)
    variance = variance + ALWAYS * seen.var(dim=(0, 2, 3), correction=0)[:, None, None] + 1e-9
    weight = torch.exp(-(x**2 + y**2) / (2 * WINDOW**2)) / variance
    slope_y, slope_x = torch.gradient(mean, spacing=float(STRIDE), dim=(1, 2))
    slope = torch.stack([slope_x, slope_y, slope_y * x - slope_x * y], dim=-1)
    # Against the mean of all others.
    off = (seen - mean) * (n / (n - 1))
    # A place where a frame looks like no other, such as under a shadow, counts little in it.
    usual = 1 / (1 + (off**2 / variance).mean(dim=1))
    square = torch.einsum("chw,chwi,chwj->hwij", weight, slope, slope)
    square = torch.einsum("nhw,hwij->nij", usual, square)
    toward = torch.einsum("nchw,chw,chwi->nhwi", off, weight, slope)
    toward = torch.einsum("nhw,nhwi->ni", usual, toward)
    largest = np.array([LARGEST_PX, LARGEST_PX, LARGEST_RAD])
    solved = torch.linalg.solve(square.double(), toward.double()).cpu().numpy()
    step: FloatArray = np.clip(-solved, -largest, largest)
    return step - step.mean(axis=0)
