"""The two networks together: a locator that sees the whole working region small, and a refiner that looks at each
keypoint closely, turned upright by what was located. The refiner therefore sees every tip in the same attitude,
whatever the bend, and thirty labels of it add up.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import nn

from ..tracker.types import Detections, FloatArray, ImageArray
from .dataset import patch_view
from .heatmaps import Decoded, decode
from .network import HeatmapNetwork
from .regions import WorkingRegion, patch_directions
from .views import View, resize, resized_view

LOCATOR_STAGES = 3
"""Three of the four residual stages see the whole body at the locator's scale; the fourth doubles the time of a
training step and found nothing more."""

REFINER_STAGES = 2
"""Two stages see a whole patch."""

COLLAPSE_LIKELIHOOD = 0.15
"""A keypoint whose peak in the working region is under this is sought in the whole frame: a bend beyond the labelled
ones may carry the tip out of the region. (Peaks of what is there are 0.4 to 0.9.)"""

MAX_INPUT_PX = 1 << 20
"""Input px that go through a network at once: its first layer's maps take 64 bytes for each."""


class Cascade(nn.Module):
    """Locator and refiner for K keypoints.

    Parameters
    ----------
    backbone : a key of `network.BACKBONES`
    n_keypoints : K
    """

    def __init__(self, backbone: str, n_keypoints: int) -> None:
        super().__init__()
        self.locator = HeatmapNetwork(backbone, LOCATOR_STAGES, n_keypoints)
        self.refiner = HeatmapNetwork(backbone, REFINER_STAGES, n_keypoints)

    @property
    def locator_multiple(self) -> int:
        """The locator's input sides are multiples of this."""
        return 2 ** (LOCATOR_STAGES + 1)

    @torch.inference_mode()
    def detect(
        self, frames: Sequence[ImageArray] | ImageArray, region: WorkingRegion, partner: Sequence[int]
    ) -> Detections:
        """Find the keypoints in RGB frames of one size, (N, H, W, 3) uint8.

        Parameters
        ----------
        region : where to look, made for frames of this size (`Checkpoint.region_for`)
        partner : from `regions.partners`
        """
        self.eval()
        xy, likelihood = self._locate(frames, region)
        everything = region.whole_frame()
        lost = np.flatnonzero(likelihood.min(axis=1) < COLLAPSE_LIKELIHOOD).tolist()
        for i in lost if region != everything else []:
            elsewhere, score = self._locate(frames[i : i + 1], everything)
            better = (score[0] > likelihood[i]) & (likelihood[i] < COLLAPSE_LIKELIHOOD)
            xy[i, better], likelihood[i, better] = elsewhere[0, better], score[0, better]
        return self._refine(frames, xy, likelihood, region, partner)

    def _locate(
        self, frames: Sequence[ImageArray] | ImageArray, region: WorkingRegion
    ) -> tuple[FloatArray, FloatArray]:
        view = region.locator_view(self.locator_multiple)
        found = _decoded(self.locator, [_region_picture(frame, region, view) for frame in frames])
        return view.to_source(_float64(found.xy)), _float64(found.likelihood)

    def _refine(
        self,
        frames: Sequence[ImageArray] | ImageArray,
        xy: FloatArray,
        likelihood: FloatArray,
        region: WorkingRegion,
        partner: Sequence[int],
    ) -> Detections:
        n, k = likelihood.shape
        views: list[View] = []
        patches: list[ImageArray] = []
        for frame, located in zip(frames, xy, strict=True):
            fine, fine_view = _fine_picture(frame, located, region)
            points = fine_view.to_input(located)
            directions = patch_directions(points, partner)
            for i in range(k):
                view = patch_view(points[i], region.magnification, directions[i])
                patches.append(view.cut(fine))
                views.append(view.after(fine_view))
        found = _decoded(self.refiner, patches)
        own = torch.arange(n * k)
        channel = own % k
        patch_xy = _float64(found.xy[own, channel])
        patch_covariance = _float64(found.covariance[own, channel])
        refined = np.empty((n * k, 2))
        covariance = np.empty((n * k, 2, 2))
        for i, view in enumerate(views):
            refined[i] = view.to_source(patch_xy[i])
            covariance[i] = view.covariance_to_source(patch_covariance[i])
        # Both must have seen it: a locator that guesses through a hand, or a patch that shows something else.
        seen = np.minimum(likelihood, _float64(found.likelihood[own, channel]).reshape(n, k))
        return Detections(refined.reshape(n, k, 2), seen, covariance.reshape(n, k, 2, 2))


def joined(parts: Sequence[Detections]) -> Detections:
    """Detections of several batches as one."""
    return Detections(
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.likelihood for part in parts]),
        np.concatenate([part.covariance for part in parts]),
    )


def _decoded(network: HeatmapNetwork, pictures: Sequence[ImageArray]) -> Decoded:
    """Positions in pictures of one size, a few at a time so that memory stays flat whatever their size."""
    device = network.mean.device
    at_once = max(1, MAX_INPUT_PX // (pictures[0].shape[0] * pictures[0].shape[1]))
    parts = []
    # TensorFloat-32 would round a GPU's positions by up to a tenth of a px; float32 is what is promised.
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        for start in range(0, len(pictures), at_once):
            batch = np.ascontiguousarray(np.stack(pictures[start : start + at_once]).transpose(0, 3, 1, 2))
            parts.append(decode(network(torch.from_numpy(batch).to(device))))
    return Decoded(*(torch.cat(part).cpu() for part in zip(*parts, strict=True)))


def _float64(values: torch.Tensor) -> FloatArray:
    return values.numpy().astype(np.float64)


def _region_picture(frame: ImageArray, region: WorkingRegion, view: View) -> ImageArray:
    """The frame through the region's view; shrunk by areas, since a bilinear cut would skip pixels."""
    w, h = view.size_wh
    # So many px of the frame fill the input; the frame's border is repeated where they reach beyond it.
    right = min(frame.shape[1], region.left + int(np.ceil(w / region.locator_scale)) + 2)
    bottom = min(frame.shape[0], region.top + int(np.ceil(h / region.locator_scale)) + 2)
    small = resize(frame[region.top : bottom, region.left : right], region.locator_scale)[:h, :w]
    missing_h, missing_w = h - small.shape[0], w - small.shape[1]
    return np.pad(small, ((0, missing_h), (0, missing_w), (0, 0)), mode="edge")


def _fine_picture(frame: ImageArray, located: FloatArray, region: WorkingRegion) -> tuple[ImageArray, View]:
    """What patches are cut from: the frame, or where the refiner looks at it smaller, the body's part of it."""
    scale = region.fine_scale
    h, w = frame.shape[:2]
    if scale == 1.0:
        return frame, resized_view(1.0, (0, 0), (w, h))
    reach = 64 / scale
    left, top = (int(v) for v in np.clip(located.min(axis=0) - reach, 0, (w - 2, h - 2)))
    right, bottom = (int(v) for v in np.clip(located.max(axis=0) + reach, (left + 2, top + 2), (w, h)))
    box = resize(frame[top:bottom, left:right], scale)
    return box, resized_view(scale, (left, top), (box.shape[1], box.shape[0]))
