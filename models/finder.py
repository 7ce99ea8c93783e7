"""How two trained networks find keypoints in frames: locate them in the working region, then look closely at each.

Knows networks only as functions from pictures to positions (`Reader`), so torch and compiled engines share every line
of it. The networks themselves are in `cascade.py`, compiled ones in `engine.py`, videos in `following.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..tracker.types import Detections, FloatArray, ImageArray
from .regions import WorkingRegion, patch_directions
from .views import View, patch_view, resize, resized_view

LOCATOR_MULTIPLE = 16
"""The locator's input sides are multiples of this: its three stages halve them four times."""

COLLAPSE_LIKELIHOOD = 0.15
"""A keypoint whose peak in the working region is under this is sought in the whole frame: a bend beyond the labelled
ones may carry the tip out of the region. (Peaks of what is there are 0.4 to 0.9.)"""

MAX_INPUT_PX = 1 << 20
"""Input px that go through a network at once: its first layer's maps take 64 bytes for each."""


class Reader(Protocol):
    """A network as a function."""

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8 RGB, positions and covariances in their own px."""


@dataclass(frozen=True)
class Finder:
    """Locator and refiner at work.

    Attributes
    ----------
    locate : reads the working region
    refine : reads patches; patch i of a frame is asked for keypoint i only
    """

    locate: Reader
    refine: Reader

    def detect(
        self, frames: Sequence[ImageArray] | ImageArray, region: WorkingRegion, partner: Sequence[int]
    ) -> Detections:
        """Find the keypoints in RGB frames of one size, (N, H, W, 3) uint8, each by itself.

        Parameters
        ----------
        region : where to look, made for frames of this size (`Header.region_for`)
        partner : from `regions.partners`
        """
        xy, likelihood = self._located(frames, region)
        everything = region.whole_frame()
        lost = np.flatnonzero(likelihood.min(axis=1) < COLLAPSE_LIKELIHOOD).tolist()
        for i in lost if region != everything else []:
            elsewhere, score = self._located(frames[i : i + 1], everything)
            better = (score[0] > likelihood[i]) & (likelihood[i] < COLLAPSE_LIKELIHOOD)
            xy[i, better], likelihood[i, better] = elsewhere[0, better], score[0, better]
        found = self.refined(frames, xy, region, partner)
        # Both must have seen it: a locator that guesses through a hand, or a patch that shows something else.
        return Detections(found.xy, np.minimum(likelihood, found.likelihood), found.covariance)

    def refined(
        self,
        frames: Sequence[ImageArray] | ImageArray,
        xy: FloatArray,
        region: WorkingRegion,
        partner: Sequence[int],
    ) -> Detections:
        """Look closely at each keypoint, near where it is thought to be, xy (N, K, 2) px."""
        n, k = xy.shape[:2]
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
        read = _read(self.refine, patches)
        own = np.arange(n * k)
        channel = own % k
        matrices = np.stack([view.matrix for view in views])
        inverse = np.linalg.inv(matrices[:, :, :2])
        refined = np.einsum("nij,nj->ni", inverse, read.xy[own, channel] - matrices[:, :, 2])
        covariance = inverse @ read.covariance[own, channel] @ inverse.transpose(0, 2, 1)
        return Detections(
            refined.reshape(n, k, 2),
            read.likelihood[own, channel].reshape(n, k),
            covariance.reshape(n, k, 2, 2),
        )

    def _located(
        self, frames: Sequence[ImageArray] | ImageArray, region: WorkingRegion
    ) -> tuple[FloatArray, FloatArray]:
        view = region.locator_view(LOCATOR_MULTIPLE)
        read = _read(self.locate, [_region_picture(frame, region, view) for frame in frames])
        return view.to_source(read.xy), read.likelihood.copy()


def joined(parts: Sequence[Detections]) -> Detections:
    """Detections of several batches as one."""
    return Detections(
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.likelihood for part in parts]),
        np.concatenate([part.covariance for part in parts]),
    )


def _read(reader: Reader, pictures: Sequence[ImageArray]) -> Detections:
    """Pictures (H, W, 3) of one size, a few at a time so that memory stays flat whatever their size."""
    at_once = max(1, MAX_INPUT_PX // (pictures[0].shape[0] * pictures[0].shape[1]))
    parts = []
    for start in range(0, len(pictures), at_once):
        stacked = np.stack(pictures[start : start + at_once])
        parts.append(reader(np.ascontiguousarray(stacked.transpose(0, 3, 1, 2))))
    return parts[0] if len(parts) == 1 else joined(parts)


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
