"""A replay pool of rendered images on the training device, and batches cut from it there.

Rendering an image takes far longer than a training step on it. Each is therefore kept for a while, and cut, rotated and
augmented anew every time that it is drawn. A batch depends only on its random generator and on the pool's contents.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..data.synthetic import IMAGE_SIDE, LOCATOR_INPUT, REFERENCE, RenderedBatch
from ..inference.affine import PATCH_SIDE
from ..inference.roi import MAX_MAGNIFICATION, orientations
from ..training.batches import Batch
from .gpu_augmentation import change_batch, occlude_batch

Rng = np.random.Generator

PATCH_SHARES = (0.15, 0.35)
"""Range of the share of the body's length that a patch shows: around `roi.PATCH_BODY_SHARE`."""

PATCH_SHIFT_SDS_PX = (4.0, 9.0)
PATCH_ROTATION_SDS_DEG = (10.0, 25.0)
"""Standard deviations of a patch's position (patch px) and rotation about its keypoint, half of the patches each: the
errors of a project's locator, and those of a locator that has not seen the actuator before."""

MAX_PATCH_SHIFT_PX = 22.0
"""Largest distance, patch px along x or y, of a keypoint from its patch's centre: it stays within the patch."""

ELSEWHERE_SHARE = 0.15
"""Share of patches that are cut anywhere along the body or in the image, instead of around a keypoint."""

_MIDDLE = (IMAGE_SIDE - 1) / 2


class ImagePool:
    """A ring buffer of rendered images on a device: new ones replace the oldest.

    Parameters
    ----------
    size : int
        Images that are kept.
    device : torch.device
        Where they are kept and batches are cut.

    Attributes
    ----------
    added : int
        Images added so far, or skipped where a pretraining is resumed.
    """

    def __init__(self, size: int, device: torch.device) -> None:
        self.size, self.device = size, device
        self.added = 0
        k = len(REFERENCE)
        self._images = torch.empty((size, 3, IMAGE_SIDE, IMAGE_SIDE), dtype=torch.uint8, device=device)
        self._xy = np.empty((size, k, 2))
        self._visible = np.empty((size, k), bool)
        self._body_px = np.empty(size)

    def __len__(self) -> int:
        return min(self.added, self.size)

    def add(self, new: RenderedBatch) -> None:
        """Add images; they replace the oldest where the pool is full."""
        places = np.arange(self.added, self.added + len(new.images)) % self.size
        self._images[torch.from_numpy(places)] = torch.from_numpy(new.images).to(self.device)
        self._xy[places], self._visible[places], self._body_px[places] = new.xy, new.visible, new.body_px
        self.added += len(places)

    def batches(self, count: int, fresh: int, patches: int, rng: Rng) -> tuple[Batch, Batch]:
        """Cut one crop of each of `count` images for the locator, and several patches of each for the refiner.

        Parameters
        ----------
        count : int
            Images drawn.
        fresh : int
            How many of them are the ones added last; the others are drawn at random.
        patches : int
            Of each image.
        rng : numpy Generator

        Returns
        -------
        locate, refine : Batch
            On the pool's device.
        """
        newest = np.arange(self.added - min(fresh, count, len(self)), self.added) % self.size
        others = rng.integers(0, len(self), count - len(newest))
        chosen = np.concatenate([newest, others])
        images = self._images[torch.from_numpy(chosen).to(self.device)].float()
        xy, visible = self._xy[chosen], self._visible[chosen]
        return (
            self._crops(images, xy, visible, rng),
            self._patches(images, xy, visible, self._body_px[chosen], patches, rng),
        )

    def _crops(self, images: Tensor, xy: np.ndarray, visible: np.ndarray, rng: Rng) -> Batch:
        n = len(images)
        # Averaged over areas first: a bilinear crop at this scale would skip pixels.
        small = F.avg_pool2d(images, IMAGE_SIDE // 128)
        scale = LOCATOR_INPUT / IMAGE_SIDE * np.exp(rng.uniform(-0.25, 0.2, n))
        turn = np.deg2rad(
            90 * rng.integers(0, 4, n) + np.where(rng.random(n) < 0.7, rng.uniform(-30, 30, n), 0)
        )
        middle = _MIDDLE + rng.uniform(-0.1, 0.1, (n, 2)) * IMAGE_SIDE
        return self._batch(
            small, xy, visible, middle[:, None], scale[:, None], turn[:, None], LOCATOR_INPUT, rng
        )

    def _patches(
        self, images: Tensor, xy: np.ndarray, visible: np.ndarray, body_px: np.ndarray, each: int, rng: Rng
    ) -> Batch:
        n, k = visible.shape
        rows = np.arange(n)[:, None]
        keypoint = rng.random((n, k)).argsort(axis=1)[:, :each]
        scale = np.minimum(
            PATCH_SIDE / (rng.uniform(*PATCH_SHARES, (n, each)) * body_px[:, None]), MAX_MAGNIFICATION
        )
        scale *= np.exp(rng.normal(0, 0.06, (n, each)))
        unseen = rng.integers(0, 2, (n, each))
        shift = rng.normal(0, 1, (n, each, 2)) * np.choose(unseen, PATCH_SHIFT_SDS_PX)[..., None]
        middle = (
            xy[rows, keypoint] + np.clip(shift, -MAX_PATCH_SHIFT_PX, MAX_PATCH_SHIFT_PX) / scale[..., None]
        )
        turn = orientations(xy, REFERENCE)[rows, keypoint]
        turn = turn + np.deg2rad(rng.normal(0, 1, (n, each)) * np.choose(unseen, PATCH_ROTATION_SDS_DEG))
        # Elsewhere: near a line between two keypoints, or anywhere.
        first, second = (xy[rows, rng.integers(0, k, (n, each))] for _ in range(2))
        along = (
            first
            + rng.random((n, each, 1)) * (second - first)
            + rng.normal(0, 0.08, (n, each, 2)) * body_px[:, None, None]
        )
        anywhere = rng.random((n, each, 2)) * (IMAGE_SIDE - 1)
        away = np.where(rng.random((n, each, 1)) < 0.5, along, anywhere)
        elsewhere = rng.random((n, each)) < ELSEWHERE_SHARE
        middle = np.where(elsewhere[..., None], away, middle)
        turn = np.where(elsewhere, rng.uniform(-np.pi, np.pi, (n, each)), turn)
        return self._batch(images, xy, visible, middle, scale, turn, PATCH_SIDE, rng)

    def _batch(
        self,
        images: Tensor,
        xy: np.ndarray,
        visible: np.ndarray,
        middle: np.ndarray,
        scale: np.ndarray,
        turn: np.ndarray,
        side: int,
        rng: Rng,
    ) -> Batch:
        """Views of images, M of each (N, M), half of them mirrored, with occluders and augmented."""
        n, m = scale.shape
        mirror = np.where(rng.random((n, m)) < 0.5, -1.0, 1.0)
        cos, sin = np.cos(turn) * scale, np.sin(turn) * scale
        # As `affine.centred_view`, with y inverted where a view is mirrored.
        matrix = np.stack([np.stack([cos, sin], -1), np.stack([-sin * mirror, cos * mirror], -1)], -2)
        offset = (side - 1) / 2 - np.einsum("nmij,nmj->nmi", matrix, middle)
        view_xy = np.einsum("nmij,nkj->nmki", matrix, xy) + offset[:, :, None]
        views = _cut(images, np.linalg.inv(matrix), middle, side)
        view_xy = view_xy.reshape(n * m, -1, 2)
        inside = ((view_xy >= -0.5) & (view_xy <= side - 0.5)).all(axis=2)
        views, occluded = occlude_batch(views, view_xy, rng)
        present = inside & ~occluded & np.repeat(visible, m, axis=0)
        to = self.device
        return Batch(
            images=change_batch(views, rng),
            xy=torch.from_numpy(view_xy.astype(np.float32)).to(to),
            known=torch.ones(present.shape, dtype=torch.bool, device=to),
            present=torch.from_numpy(present).to(to),
        )


def _cut(images: Tensor, inverse: np.ndarray, middle: np.ndarray, side: int) -> Tensor:
    """Square views of images; outside an image its border is repeated.

    Parameters
    ----------
    images : (N, 3, h, w) tensor
    inverse : (N, M, 2, 2) array
        From view px to px of an image of `IMAGE_SIDE`, about the centres of both.
    middle : (N, M, 2) array
        The views' centres, px of an image of `IMAGE_SIDE`.
    side : int
        Of the views, px.

    Returns
    -------
    (N M, 3, side, side) tensor
    """
    n, m = inverse.shape[:2]
    device = images.device
    step = torch.arange(side, device=device, dtype=torch.float32) - (side - 1) / 2
    grid = torch.stack(torch.meshgrid(step, step, indexing="xy"), dim=-1)
    turn, centre = (torch.from_numpy(part.astype(np.float32)).to(device) for part in (inverse, middle))
    at = torch.einsum("nmij,hwj->nmhwi", turn, grid) + centre[:, :, None, None]
    # -1 and 1 are an image's outer edges to `grid_sample`, whatever its size.
    at = (2 * at + 1) / IMAGE_SIDE - 1
    views = F.grid_sample(
        images,
        at.reshape(n, m * side, side, 2),
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    return views.reshape(n, 3, m, side, side).transpose(1, 2).reshape(n * m, 3, side, side)
