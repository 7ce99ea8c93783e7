"""Joint registration of moving ends: all crops of an end, in one video, are registered to their mean.

An end is rigid, so images show how it lies in two frames relative to each other far more exactly than two clicks do,
and with other errors than the network's: outlines, marks and chambers count as far as they look alike wherever the end
turns; light and background hardly do. Compared are the features of the first residual stage of the shipped network.
Where the end lies on average is not estimated here: labels and network say it (`robust_fit`).

All frames are registered at once (congealing, Learned-Miller 2006), each by Gauss-Newton steps (inverse compositional,
Baker & Matthews 2004), every feature weighted by the inverse of its variance over the frames.
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
from .geometry import FrameGeometry

WINDOW_SD_PX = END_SIDE / 4
"""Standard deviation, px of the end's crop, of the Gaussian window that weights features by their distance from the
crop's centre: the end fills its middle."""

STEPS = 8
"""Gauss-Newton steps. With twelve, crops agree better with each other but their poses less with the truth (rendered
actuators)."""

GAUSS_NEWTON_LIMIT_PX, GAUSS_NEWTON_LIMIT_RAD = 2.0, 0.1
"""Largest step along either axis (px of the end's crop) and in rotation (rad): a linearised step further than that is
not valid."""

VARIANCE_FLOOR = 0.01
"""Least variance of a feature at any position, as a share of its variance over all positions and frames: few frames
can agree by chance, and their weight would be infinite."""

MIN_FRAMES, MAX_FRAMES = 5, 128
"""Frames registered at once: with fewer than the first the features' variance is not known, more than the second would
not fit into memory."""


def shipped_features() -> FirstStage:
    """The first stage of the shipped ResNet-18 network in evaluation mode, whatever backbone is in training."""
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
    """Positions with the moving ends registered to each other, their mean pose unchanged.

    An end is two keypoints that are each other's reference.

    Parameters
    ----------
    frames : sequence of N PreparedFrame
    xy : (N, K, 2) float array
        Positions to start from, px.
    known : (N, K) bool array
        Which of them are trusted; an end with another keypoint stays where it is.
    reference : sequence of K int
        From `roi.reference_keypoints`.
    videos : sequence of N str
        The video that each frame is from; each is registered by itself.
    features : FirstStage
        In evaluation mode.

    Returns
    -------
    (N, K, 2) float array
        px.
    """
    geometry = FrameGeometry.of([frame.region for frame in frames], reference, videos)
    registered = xy.copy()
    for end, rows in moving_ends(xy, known, geometry):
        for video in sorted({geometry.videos[i] for i in rows}):
            of_video = [i for i in rows if geometry.videos[i] == video]
            # Every part holds frames from all over the video.
            parts = -(-len(of_video) // MAX_FRAMES)
            for part in (of_video[first::parts] for first in range(parts)):
                registered[np.ix_(part, end)] = _registered(
                    [frames[i] for i in part], xy[np.ix_(part, end)], features
                )
    return registered


def moving_ends(
    xy: FloatArray, known: BoolArray, geometry: FrameGeometry
) -> Iterator[tuple[list[int], list[int]]]:
    """The ends that move, each with the frames that show it.

    Parameters
    ----------
    xy : (N, K, 2) float array
        Positions, px.
    known : (N, K) bool array
        Which of them are trusted.
    geometry : FrameGeometry
        Of the N frames.

    Yields
    ------
    end : list of int
        Its two keypoints.
    frames : list of int
        Frames in which both are trusted, of the videos in which both move. A video with fewer than `MIN_FRAMES` such
        frames is skipped.
    """
    reference = geometry.reference
    for end in ([k, p] for k, p in enumerate(reference) if k < p and reference[p] == k):
        rows: list[int] = []
        for _, of_video in geometry.frames_by_video():
            own = np.flatnonzero(of_video & known[:, end].all(axis=1)).tolist()
            if len(own) >= MIN_FRAMES and np.ptp(xy[own][:, end], axis=0).any(axis=1).all():
                rows += own
        if rows:
            yield end, rows


def _registered(frames: Sequence[PreparedFrame], xy: FloatArray, features: FirstStage) -> FloatArray:
    """`register_ends` for one end (N, 2, 2) px in frames of one video."""
    views = [frame.fine_view for frame in frames]
    ends = np.stack([view.to_input(own) for view, own in zip(views, xy, strict=True)])
    zoom = END_MAGNIFICATION * np.array([frame.region.magnification for frame in frames])
    middle = ends.mean(axis=1)
    half: FloatArray = (ends[:, 1] - ends[:, 0]) / 2
    shift, turn = np.zeros_like(middle), np.zeros(len(frames))
    for _ in range(STEPS):
        direction = np.arctan2(half[:, 1], half[:, 0]) + turn
        crops = [
            centred_view(at, (END_SIDE, END_SIDE), by, towards).cut(frame.fine)
            for frame, at, by, towards in zip(frames, middle + shift, zoom, direction, strict=True)
        ]
        images = torch.from_numpy(stacked(crops))
        with torch.inference_mode():
            step: FloatArray = _gauss_newton_step(features(images.to(features.mean.device)))
        shift += turned(step[:, :2] / zoom[:, None], direction)
        turn += step[:, 2]
    # A frame that was carried far looks unlike the others: there the end stays where it was.
    far = (np.linalg.norm(shift, axis=1) * zoom > MAX_STEP_PX) | (np.abs(turn) > MAX_STEP_RAD)
    shift[far], turn[far] = 0.0, 0.0
    half = turned(half, turn)
    ends = (middle + shift)[:, None] + np.stack([-half, half], axis=1)
    return np.stack([view.to_source(own) for view, own in zip(views, ends, strict=True)])


def appearance(features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Statistics of crops that show the same object.

    Parameters
    ----------
    features : (N, C, h, w) tensor

    Returns
    -------
    mean, variance : (C, h, w) tensors
        Over the N crops, the variance with its floor.
    weight : (C, h, w) tensor
        `window` over the variance.
    """
    mean, variance = features.mean(dim=0), features.var(dim=0, correction=0)
    floor = VARIANCE_FLOOR * features.var(dim=(0, 2, 3), correction=0)[:, None, None]
    variance = variance + floor + 1e-9
    return mean, variance, window(features) / variance


def window(features: Tensor) -> Tensor:
    """Gaussian weights (h, w) of the positions of features (N, C, h, w), 1 at the crop's centre."""
    x, y = _positions(features)
    return torch.exp(-(x**2 + y**2) / (2 * WINDOW_SD_PX**2))


def _positions(features: Tensor) -> tuple[Tensor, Tensor]:
    """Positions of features (N, C, h, w) relative to the crop's centre, x and y (h, w) px."""
    h, w = features.shape[2:]
    y, x = (STRIDE * (torch.arange(side, device=features.device) - (side - 1) / 2) for side in (h, w))
    return x.expand(h, w), y[:, None].expand(h, w)


def _gauss_newton_step(features: Tensor) -> FloatArray:
    """The step that moves each crop's features towards the mean of the others.

    Parameters
    ----------
    features : (N, C, h, w) tensor

    Returns
    -------
    (N, 3) float array
        x and y px and rad about the crop's centre, minus their mean over the crops.
    """
    n = len(features)
    x, y = _positions(features)
    mean, variance, weight = appearance(features)
    slope_y, slope_x = torch.gradient(mean, spacing=float(STRIDE), dim=(1, 2))
    jacobian = torch.stack([slope_x, slope_y, slope_y * x - slope_x * y], dim=-1)
    # The difference from the mean of the other crops, without the crop itself.
    residual = (features - mean) * (n / (n - 1))
    # A position at which one frame looks unlike all others, for example in a shadow, counts little in that frame.
    robust = 1 / (1 + (residual**2 / variance).mean(dim=1))
    hessian = torch.einsum("chw,chwi,chwj->hwij", weight, jacobian, jacobian)
    hessian = torch.einsum("nhw,hwij->nij", robust, hessian)
    gradient = torch.einsum("nchw,chw,chwi->nhwi", residual, weight, jacobian)
    gradient = torch.einsum("nhw,nhwi->ni", robust, gradient)
    largest = np.array([GAUSS_NEWTON_LIMIT_PX, GAUSS_NEWTON_LIMIT_PX, GAUSS_NEWTON_LIMIT_RAD])
    solution = torch.linalg.solve(hessian.double(), gradient.double()).cpu().numpy()
    step: FloatArray = np.clip(-solution, -largest, largest)
    return step - step.mean(axis=0)
