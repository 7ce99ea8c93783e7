"""The latest rendered pictures, kept where the networks learn, and batches cut from them there.

To draw a picture takes far longer than to learn from it: each is kept for a while, and every time that its turn comes
it is cut, turned and changed anew. What a batch shows depends on (seed, step) and on which pictures are there only.
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
from .gpu_augmentation import changed, covered

Rng = np.random.Generator

PATCH_SHARES = (0.15, 0.35)
"""How much of the body's length a patch shows: around `regions.PATCH_BODY_SHARE`."""

PATCH_SHIFTS_PX = (4.0, 9.0)
PATCH_TURNS_DEG = (10.0, 25.0)
"""Standard deviations of where a patch is cut, half of them each: what a project's locator leaves, and what one does
that has not seen the actuator before."""

FURTHEST_PX = 22.0
"""No keypoint lies further from the middle of its patch along x or y."""

ELSEWHERE = 0.15
"""Share of patches that are cut anywhere along the body or in the picture."""

_MIDDLE = (IMAGE_SIDE - 1) / 2


class ImagePool:
    """So many pictures on a device, the oldest giving way to new ones.

    Parameters
    ----------
    size : pictures that are kept
    device : where they lie and batches are cut
    """

    def __init__(self, size: int, device: torch.device) -> None:
        self.size, self.device = size, device
        self.seen = 0
        k = len(REFERENCE)
        self._pictures = torch.empty((size, 3, IMAGE_SIDE, IMAGE_SIDE), dtype=torch.uint8, device=device)
        self._xy = np.empty((size, k, 2))
        self._visible = np.empty((size, k), bool)
        self._body_px = np.empty(size)

    def __len__(self) -> int:
        return min(self.seen, self.size)

    def add(self, new: RenderedBatch) -> None:
        """Take in pictures."""
        places = np.arange(self.seen, self.seen + len(new.images)) % self.size
        self._pictures[torch.from_numpy(places)] = torch.from_numpy(new.images).to(self.device)
        self._xy[places], self._visible[places], self._body_px[places] = new.xy, new.visible, new.body_px
        self.seen += len(places)

    def batches(self, count: int, fresh: int, patches: int, rng: Rng) -> tuple[Batch, Batch]:
        """A crop of each of `count` pictures for the locator, and so many patches of each for the refiner.

        fresh : of the pictures, so many are the ones taken in last
        """
        newest = np.arange(self.seen - min(fresh, count, len(self)), self.seen) % self.size
        others = rng.integers(0, len(self), count - len(newest))
        chosen = np.concatenate([newest, others])
        pictures = self._pictures[torch.from_numpy(chosen).to(self.device)].float()
        xy, visible = self._xy[chosen], self._visible[chosen]
        return (
            self._crops(pictures, xy, visible, rng),
            self._patches(pictures, xy, visible, self._body_px[chosen], patches, rng),
        )

    def _crops(self, pictures: Tensor, xy: np.ndarray, visible: np.ndarray, rng: Rng) -> Batch:
        n = len(pictures)
        # Shrunk by areas first, since a bilinear cut would skip pixels.
        small = F.avg_pool2d(pictures, IMAGE_SIDE // 128)
        scale = LOCATOR_INPUT / IMAGE_SIDE * np.exp(rng.uniform(-0.25, 0.2, n))
        turn = np.deg2rad(
            90 * rng.integers(0, 4, n) + np.where(rng.random(n) < 0.7, rng.uniform(-30, 30, n), 0)
        )
        middle = _MIDDLE + rng.uniform(-0.1, 0.1, (n, 2)) * IMAGE_SIDE
        return self._batch(
            small, xy, visible, middle[:, None], scale[:, None], turn[:, None], LOCATOR_INPUT, rng
        )

    def _patches(
        self, pictures: Tensor, xy: np.ndarray, visible: np.ndarray, body_px: np.ndarray, each: int, rng: Rng
    ) -> Batch:
        n, k = visible.shape
        rows = np.arange(n)[:, None]
        keypoint = rng.random((n, k)).argsort(axis=1)[:, :each]
        scale = np.minimum(
            PATCH_SIDE / (rng.uniform(*PATCH_SHARES, (n, each)) * body_px[:, None]), MAX_MAGNIFICATION
        )
        scale *= np.exp(rng.normal(0, 0.06, (n, each)))
        rough = rng.integers(0, 2, (n, each))
        shift = rng.normal(0, 1, (n, each, 2)) * np.choose(rough, PATCH_SHIFTS_PX)[..., None]
        middle = xy[rows, keypoint] + np.clip(shift, -FURTHEST_PX, FURTHEST_PX) / scale[..., None]
        turn = orientations(xy, REFERENCE)[rows, keypoint]
        turn = turn + np.deg2rad(rng.normal(0, 1, (n, each)) * np.choose(rough, PATCH_TURNS_DEG))
        # Elsewhere: between two keypoints and a little beside, or anywhere.
        one, other = (xy[rows, rng.integers(0, k, (n, each))] for _ in range(2))
        along = (
            one
            + rng.random((n, each, 1)) * (other - one)
            + rng.normal(0, 0.08, (n, each, 2)) * body_px[:, None, None]
        )
        anywhere = rng.random((n, each, 2)) * (IMAGE_SIDE - 1)
        beside = np.where(rng.random((n, each, 1)) < 0.5, along, anywhere)
        elsewhere = rng.random((n, each)) < ELSEWHERE
        middle = np.where(elsewhere[..., None], beside, middle)
        turn = np.where(elsewhere, rng.uniform(-np.pi, np.pi, (n, each)), turn)
        return self._batch(pictures, xy, visible, middle, scale, turn, PATCH_SIDE, rng)

    def _batch(
        self,
        pictures: Tensor,
        xy: np.ndarray,
        visible: np.ndarray,
        middle: np.ndarray,
        scale: np.ndarray,
        turn: np.ndarray,
        side: int,
        rng: Rng,
    ) -> Batch:
        """Views of pictures, M of each (N, M), half of them mirrored, covered and changed."""
        n, m = scale.shape
        mirror = np.where(rng.random((n, m)) < 0.5, -1.0, 1.0)
        cos, sin = np.cos(turn) * scale, np.sin(turn) * scale
        # As `views.centred_view`, and y turned about for those that are mirrored.
        matrix = np.stack([np.stack([cos, sin], -1), np.stack([-sin * mirror, cos * mirror], -1)], -2)
        offset = (side - 1) / 2 - np.einsum("nmij,nmj->nmi", matrix, middle)
        seen_xy = np.einsum("nmij,nkj->nmki", matrix, xy) + offset[:, :, None]
        images = _cut(pictures, np.linalg.inv(matrix), middle, side)
        seen_xy = seen_xy.reshape(n * m, -1, 2)
        inside = ((seen_xy >= -0.5) & (seen_xy <= side - 0.5)).all(axis=2)
        images, hidden = covered(images, seen_xy, rng)
        present = inside & ~hidden & np.repeat(visible, m, axis=0)
        to = self.device
        return Batch(
            images=changed(images, rng),
            xy=torch.from_numpy(seen_xy.astype(np.float32)).to(to),
            known=torch.ones(present.shape, dtype=torch.bool, device=to),
            present=torch.from_numpy(present).to(to),
        )


def _cut(pictures: Tensor, inverse: np.ndarray, middle: np.ndarray, side: int) -> Tensor:
    """Square views (N M, 3, side, side) of pictures (N, 3, h, w); outside a picture its border is repeated.

    inverse : (N, M, 2, 2) from input px to px of a picture of `IMAGE_SIDE`, about the middles (N, M, 2) of both
    """
    n, m = inverse.shape[:2]
    device = pictures.device
    step = torch.arange(side, device=device, dtype=torch.float32) - (side - 1) / 2
    grid = torch.stack(torch.meshgrid(step, step, indexing="xy"), dim=-1)
    turn, centre = (torch.from_numpy(part.astype(np.float32)).to(device) for part in (inverse, middle))
    at = torch.einsum("nmij,hwj->nmhwi", turn, grid) + centre[:, :, None, None]
    # What a picture's size is does not matter to `grid_sample`: -1 and 1 are its outer edges.
    at = (2 * at + 1) / IMAGE_SIDE - 1
    views = F.grid_sample(
        pictures,
        at.reshape(n, m * side, side, 2),
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    return views.reshape(n, 3, m, side, side).transpose(1, 2).reshape(n * m, 3, side, side)
