"""Training batches: targets lie on the marks; occluded keypoints and those outside are marked as absent."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from bendtrack.models.data import augmentation as augment
from bendtrack.models.data.images import read_image
from bendtrack.models.data.prepared import PreparedFrame, prepare
from bendtrack.models.inference.affine import PATCH_SIDE
from bendtrack.models.inference.roi import reference_keypoints, region_of_interest
from bendtrack.models.training.batches import Batch, locator_batch, refiner_batch
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.types import LabelledFrame

MakeFrames = Callable[..., list[LabelledFrame]]


@pytest.fixture
def prepared(make_frames: MakeFrames) -> list[PreparedFrame]:
    frames = make_frames(np.linspace(0, 190, 6))
    pictures = [read_image(frame) for frame in frames]
    xy = np.stack([frame.xy for frame in frames])
    region = region_of_interest(xy, (160, 120))
    return [prepare(picture, points, region) for picture, points in zip(pictures, xy, strict=True)]


@pytest.fixture
def plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Geometry only: the colours stay, so that a disc can be found by its colour."""
    monkeypatch.setattr(augment, "change_image", lambda image, rng: image)
    monkeypatch.setattr(
        augment, "occlude", lambda image, rng, share=0.5: (image, np.zeros(image.shape[:2], np.uint8))
    )


def red_disc(image: np.ndarray) -> np.ndarray:
    """Centre of the red disc (base_1) in a picture (3, H, W)."""
    r, g, b = image.astype(float)
    weight = np.clip(r - np.maximum(g, b) - 60, 0, None)
    y, x = np.mgrid[: image.shape[1], : image.shape[2]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@pytest.mark.usefixtures("plain")
def test_crop_and_patch_targets_lie_on_the_marks(prepared: list[PreparedFrame]) -> None:
    reference = reference_keypoints(np.stack([frame.xy for frame in prepared]))
    checked = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        crops = locator_batch(dict(enumerate(prepared)), [seed % 6], (160, 128), rng)
        patches = refiner_batch(dict(enumerate(prepared)), [seed % 6], reference, rng)
        for batch in (crops, patches):
            for image, xy in zip(batch.images, batch.xy, strict=True):
                # The disc whole in the picture, so that its centroid is its centre.
                if np.all((xy[0] > 9) & (xy[0] < np.array(image.shape[:0:-1]) - 10)):
                    np.testing.assert_allclose(red_disc(image), xy[0], atol=0.25)
                    checked += 1
    assert checked >= 12


@pytest.mark.usefixtures("plain")
def test_patches_show_the_ends_upright_whatever_the_bend(prepared: list[PreparedFrame]) -> None:
    reference = reference_keypoints(np.stack([frame.xy for frame in prepared]))
    rng = np.random.default_rng(0)
    batch = refiner_batch(dict(enumerate(prepared)), list(range(6)), reference, rng, elsewhere=0)
    tip = batch.xy[2::4]
    direction = np.rad2deg(np.arctan2(*(tip[:, 3] - tip[:, 2]).T[::-1]))
    assert np.abs(direction).max() < 40
    centre = batch.xy[np.arange(24), np.tile(np.arange(4), 6)]
    assert np.abs(centre - (PATCH_SIDE - 1) / 2).max() < 17


def same(first: Batch, second: Batch) -> bool:
    return bool(np.array_equal(first.images, second.images) and np.array_equal(first.xy, second.xy))


def test_a_batch_depends_on_its_seed_alone(prepared: list[PreparedFrame]) -> None:
    frames = dict(enumerate(prepared))
    draws = [locator_batch(frames, [0, 1], (160, 128), np.random.default_rng(s)) for s in (1, 1, 2)]
    assert same(draws[0], draws[1])
    assert not same(draws[0], draws[2])


def test_missing_labels_are_unknown_and_get_no_patch(prepared: list[PreparedFrame]) -> None:
    prepared[0].xy[2] = np.nan
    reference = reference_keypoints(np.stack([frame.xy for frame in prepared]))
    frames, rng = dict(enumerate(prepared)), np.random.default_rng(0)
    assert locator_batch(frames, [0], (160, 128), rng).known.tolist() == [[True, True, False, True]]
    assert len(refiner_batch(frames, [0], reference, rng, elsewhere=0).images) == 3


def test_patches_elsewhere_are_along_the_body_or_anywhere(prepared: list[PreparedFrame]) -> None:
    reference = reference_keypoints(np.stack([frame.xy for frame in prepared]))
    frames, rng = dict(enumerate(prepared)), np.random.default_rng(0)
    batch = refiner_batch(frames, list(range(6)), reference, rng, max_keypoints=1, elsewhere=30)
    assert len(batch.images) == 6 * 31
    near = np.arange(len(batch.images)) % 31 == 0
    assert batch.present[near].any(axis=1).all()
    # Some show no keypoint at all, even of a body this small, and all of them may be learnt from.
    assert batch.known.all()
    assert 0.15 < (~batch.present[~near].any(axis=1)).mean() < 0.8
    # They do not all show the same place: somewhere they are far from every keypoint, somewhere near one.
    away = np.linalg.norm(batch.xy[~near] - (PATCH_SIDE - 1) / 2, axis=2).min(axis=1)
    assert away.min() < PATCH_SIDE / 2
    assert away.max() > PATCH_SIDE


def test_an_occluder_hides_what_its_mask_says() -> None:
    image = np.full((90, 120, 3), 100, np.uint8)
    image[40:50, 55:65] = 250
    rng = np.random.default_rng(3)
    seen = [augment.occlude(image, rng) for _ in range(160)]
    for picture, mask in seen:
        assert np.array_equal(picture[mask == 0], image[mask == 0])
    assert 50 <= sum(mask.any() for _, mask in seen) < 110
    assert 3 <= sum(mask[45, 60] > 0 for _, mask in seen) < 40


@pytest.mark.parametrize("change", [augment.change_light, augment.blur, augment.add_noise])
def test_changes_of_light_blur_and_noise_keep_a_mark_in_its_place(change: Callable[..., np.ndarray]) -> None:
    y, x = np.mgrid[:64, :64]
    spot = (120 * np.exp(-((x - 30.4) ** 2 + (y - 33.7) ** 2) / 50) + 60).astype(np.uint8)
    image = np.repeat(spot[..., None], 3, axis=2)
    for seed in range(10):
        out = change(image, np.random.default_rng(seed)).astype(float).mean(axis=2)
        assert out.shape == (64, 64)
        weight = np.clip(out - np.median(out) - 20, 0, None)
        centre = np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()
        np.testing.assert_allclose(centre, [30.4, 33.7], atol=0.5)


def test_a_missing_image_is_named(tmp_path: object) -> None:
    with pytest.raises(LabelError, match=r"expected an image at .*nowhere\.png"):
        read_image(LabelledFrame("v", tmp_path / "nowhere.png", np.zeros((4, 2)), "a"))
