"""A moving end is rigid: what is seen of it in all labelled frames of a video is laid over each other.

How an end lies in two frames relative to each other is seen in the pictures far more exactly than in two clicks, and
with other errors than a network's own: outlines, marks and chambers count as far as they look the same wherever the end
turns, light and background hardly do. What is compared are the features of the first residual stage of what comes with
bendtrack; where an end lies on average is what labels and network say (`consensus`).

All frames are aligned to their mean at once (congealing, Learned-Miller 2006), each by Gauss-Newton steps (Baker &
Matthews 2004, inverse compositional), every feature weighed by how little it varies from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray
from ..data.prepared import PreparedFrame
from ..inference.affine import centred_view, stacked
from ..inference.crops import END_MAGNIFICATION, END_SIDE, MAX_STEP_PX, MAX_STEP_RAD
from ..inference.roi import turned
from ..networks.checkpoint import load_checkpoint
from ..networks.heatmap_network import STRIDE, FirstStage, HeatmapNetwork
from ..networks.shipped import shipped_network

WINDOW = END_SIDE / 4
"""Standard deviation of how much a place counts by its distance from the end's middle, px of its closer picture."""

STEPS = 8
LARGEST_PX, LARGEST_RAD = 2.0, 0.1
"""Steps taken, and no step moves or turns an end further. With half as many again frames agree better with each other
but less with the truth."""

ALWAYS = 0.01
"""Share of a feature's variance over all places that it has everywhere, however little it varies in these frames."""

LEAST, MOST = 5, 128
"""Frames that are laid over each other at once: fewer do not tell what varies, more would fill the memory."""


def shipped_features() -> FirstStage:
    """What ends are compared by, whatever the backbone of the network that learns."""
    refiner: HeatmapNetwork = load_checkpoint(shipped_network("resnet18")).network.refiner
    return FirstStage(refiner).eval()


def register_ends(
    frames: Sequence[PreparedFrame],
    xy: FloatArray,
    known: BoolArray,
    reference: Sequence[int],
    videos: Sequence[str],
    features: FirstStage,
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
    features : what ends are compared by, in evaluation mode
    """
    better = xy.copy()
    for end, rows in moving_ends(xy, known, reference, videos):
        for video in sorted({videos[i] for i in rows}):
            of_video = [i for i in rows if videos[i] == video]
            # Every part has frames of the whole video.
            parts = -(-len(of_video) // MOST)
            for some in (of_video[part::parts] for part in range(parts)):
                better[np.ix_(some, end)] = _registered(
                    [frames[i] for i in some], xy[np.ix_(some, end)], features
                )
    return better


def moving_ends(
    xy: FloatArray, known: BoolArray, reference: Sequence[int], videos: Sequence[str]
) -> Iterator[tuple[list[int], list[int]]]:
    """Ends, the keypoints of each, and frames: those of videos that show it moving, in which it is known.

    As `registered`'s parameters; a video in which it is known in fewer than `LEAST` frames does not show that.
    """
    for end in ([k, p] for k, p in enumerate(reference) if k < p and reference[p] == k):
        rows: list[int] = []
        for video in sorted(set(videos)):
            own = [i for i, of in enumerate(videos) if of == video and known[i, end].all()]
            if len(own) >= LEAST and np.ptp(xy[own][:, end], axis=0).any(axis=1).all():
                rows += own
        if rows:
            yield end, rows


def _registered(frames: Sequence[PreparedFrame], xy: FloatArray, features: FirstStage) -> FloatArray:
    """`registered` for one end (N, 2, 2) in frames of one video."""
    views = [frame.fine_view for frame in frames]
    ends = np.stack([view.to_input(own) for view, own in zip(views, xy, strict=True)])
    zoom = END_MAGNIFICATION * np.array([frame.region.magnification for frame in frames])
    middle = ends.mean(axis=1)
    half: FloatArray = (ends[:, 1] - ends[:, 0]) / 2
    moved, turn = np.zeros_like(middle), np.zeros(len(frames))
    for _ in range(STEPS):
        direction = np.arctan2(half[:, 1], half[:, 0]) + turn
        pictures = [
            centred_view(at, (END_SIDE, END_SIDE), by, towards).cut(frame.fine)
            for frame, at, by, towards in zip(frames, middle + moved, zoom, direction, strict=True)
        ]
        images = torch.from_numpy(stacked(pictures))
        with torch.inference_mode():
            step: FloatArray = _step(features(images.to(features.mean.device)))
        moved += turned(step[:, :2] / zoom[:, None], direction)
        turn += step[:, 2]
    far = (np.linalg.norm(moved, axis=1) * zoom > MAX_STEP_PX) | (np.abs(turn) > MAX_STEP_RAD)
    moved[far], turn[far] = 0.0, 0.0
    half = turned(half, turn)
    ends = (middle + moved)[:, None] + np.stack([-half, half], axis=1)
    return np.stack([view.to_source(own) for view, own in zip(views, ends, strict=True)])


def appearance(seen: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Of what is seen in pictures that show the same, features (N, C, h, w): mean, variance, and weight (C, h, w)."""
    mean, variance = seen.mean(dim=0), seen.var(dim=0, correction=0)
    variance = variance + ALWAYS * seen.var(dim=(0, 2, 3), correction=0)[:, None, None] + 1e-9
    return mean, variance, window(seen) / variance


def window(seen: Tensor) -> Tensor:
    """How much places of features (N, C, h, w) count, (h, w), by how far they lie from an end's middle."""
    x, y = _places(seen)
    return torch.exp(-(x**2 + y**2) / (2 * WINDOW**2))


def _places(seen: Tensor) -> tuple[Tensor, Tensor]:
    """Where features (N, C, h, w) lie from the middle, x and y (h, w) px."""
    h, w = seen.shape[2:]
    y, x = (STRIDE * (torch.arange(side, device=seen.device) - (side - 1) / 2) for side in (h, w))
    return x.expand(h, w), y[:, None].expand(h, w)


def _step(seen: Tensor) -> FloatArray:
    """How far what is seen, features (N, C, h, w), lies off its mean: x and y px and radians about the middle, (N, 3),
    less their own mean."""
    n = len(seen)
    x, y = _places(seen)
    mean, variance, weight = appearance(seen)
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
