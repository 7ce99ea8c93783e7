"""Batches from the pool of rendered images: keypoints lie on the marks, occluded ones are marked as absent."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from bendtrack.models.data.synthetic import IMAGE_SIDE, REFERENCE, RenderedBatch, render_batch
from bendtrack.models.inference.roi import orientations
from bendtrack.models.pretraining.gpu_augmentation import change_batch, occlude_batch
from bendtrack.models.pretraining.image_pool import ImagePool
from bendtrack.models.training.batches import Batch

CPU = torch.device("cpu")


def dots(count: int) -> RenderedBatch:
    """Black pictures in which every keypoint is a bright spot, and where the spots are."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0.25, 0.75, (count, len(REFERENCE), 2)) * IMAGE_SIDE
    y, x = np.mgrid[:IMAGE_SIDE, :IMAGE_SIDE]
    level = np.zeros((count, IMAGE_SIDE, IMAGE_SIDE))
    for i, points in enumerate(xy):
        for px, py in points:
            level[i] += 255 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 3.0**2))
    pictures = np.repeat(np.minimum(level, 255).astype(np.uint8)[:, None], 3, axis=1)
    return RenderedBatch(pictures, xy, np.ones(xy.shape[:2], bool), np.full(count, 160.0))


def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing in the way, no change of light."""
    module = "bendtrack.models.pretraining.image_pool"
    monkeypatch.setattr(
        f"{module}.occlude_batch", lambda images, xy, rng: (images, np.zeros(xy.shape[:2], bool))
    )
    monkeypatch.setattr(f"{module}.change_batch", lambda images, rng: images)


def test_targets_of_a_batch_lie_on_the_marks(monkeypatch: pytest.MonkeyPatch) -> None:
    plain(monkeypatch)
    pool = ImagePool(4, CPU)
    pool.add(dots(4))
    for batch in pool.batches(16, 4, 4, np.random.default_rng(1)):
        side = batch.images.shape[-1]
        images, xy, present = batch.images[:, 0].numpy(), batch.xy.numpy(), batch.present.numpy()
        dark = []
        for image, points, inside in zip(images, xy, present, strict=True):
            for x, y in points[inside]:
                if 3 < x < side - 4 and 3 < y < side - 4:
                    dark.append(image[round(y), round(x)])
        assert len(dark) > 40
        # A spot is a few px wide in every view: a px beside it is clearly darker.
        assert np.percentile(dark, 2) > 170


def test_patches_are_cut_around_keypoints_and_rotated_upright() -> None:
    pool = ImagePool(16, CPU)
    pool.add(render_batch(5, range(16)))
    locate, refine = pool.batches(16, 8, 3, np.random.default_rng(2))
    assert locate.images.shape == (16, 3, 96, 96)
    assert refine.images.shape == (48, 3, 64, 64)
    assert locate.known.all()
    assert refine.known.all()
    xy = refine.xy.numpy()
    distance = np.linalg.norm(xy - 31.5, axis=2)
    # All but those that are cut elsewhere.
    assert (distance.min(axis=1) < 32).mean() > 0.8
    nearest = distance.argmin(axis=1)
    turn = np.degrees([orientations(points, REFERENCE)[k] for points, k in zip(xy, nearest, strict=True)])
    assert np.median(np.abs(turn)) < 30


def test_a_batch_depends_on_its_seed_and_on_the_images_only() -> None:
    def batches(seed: int) -> tuple[Batch, Batch]:
        pool = ImagePool(6, CPU)
        pool.add(render_batch(5, range(6)))
        return pool.batches(8, 2, 2, np.random.default_rng(seed))

    one, again, other = batches(1), batches(1), batches(2)
    for a, b in zip(one, again, strict=True):
        assert torch.equal(a.images, b.images)
        assert torch.equal(a.xy, b.xy)
    assert not torch.equal(one[0].images, other[0].images)


def test_new_images_replace_the_oldest() -> None:
    pool = ImagePool(4, CPU)
    pool.add(render_batch(5, range(3)))
    assert len(pool) == 3
    pool.add(render_batch(5, range(3, 6)))
    assert (len(pool), pool.added) == (4, 6)


def test_occluders_hide_the_keypoints_under_them() -> None:
    rng = np.random.default_rng(3)
    images = torch.full((200, 3, 40, 40), -1.0)
    xy = rng.uniform(0, 39, (200, 5, 2))
    occluded, hidden = occlude_batch(images, xy, rng)
    assert 0.01 < hidden.mean() < 0.1
    column, row = np.round(xy).astype(int).transpose(2, 0, 1)
    touched = occluded.numpy()[np.arange(200)[:, None], 0, row, column] != -1.0
    # Of one colour it shows; cut from another of these pictures, which look alike, it does not.
    assert touched[~hidden].mean() < 0.02
    assert 0.3 < touched[hidden].mean() < 0.7


def test_augmented_images_stay_in_range() -> None:
    images = torch.rand(64, 3, 16, 16, generator=torch.Generator().manual_seed(0)) * 255
    images = change_batch(images, np.random.default_rng(4))
    assert images.shape == (64, 3, 16, 16)
    assert 0 <= float(images.min()) < float(images.max()) <= 255
    grey = (images.amax(dim=1) - images.amin(dim=1)).mean(dim=(1, 2))
    assert (grey < 25).sum() >= 1
