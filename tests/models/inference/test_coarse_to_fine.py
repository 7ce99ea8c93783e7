"""Coarse-to-fine estimator and keypoint tracker with predictors whose output is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.coarse_to_fine import (
    CoarseToFineEstimator,
    Estimate,
    average_predictions,
    predicted_at,
)
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest, reference_distances
from bendtrack.models.inference.stages import StageSettings
from bendtrack.models.inference.tracking import CHECK_EVERY, FRAMES_AHEAD, REST_PREDICTIONS, KeypointTracker
from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.types import Detections

SIZE_WH = (320, 240)
REGION = RegionOfInterest(SIZE_WH, 0, 0, *SIZE_WH, 0.5, 1.5)
GEOMETRY = CropGeometry(REGION, (1, 2, 1))
COLOURS = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250]])
BACKGROUND = 60


def frame_of(xy: np.ndarray) -> np.ndarray:
    """A frame with a soft coloured spot at each of three points (3, 2)."""
    x, y = np.meshgrid(np.arange(SIZE_WH[0]), np.arange(SIZE_WH[1]))
    image = np.full((SIZE_WH[1], SIZE_WH[0], 3), BACKGROUND, float)
    for (px, py), colour in zip(xy, COLOURS, strict=True):
        spot = np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 4.0**2))
        image += spot[..., None] * (colour - BACKGROUND)
    return np.clip(image.round(), 0, 255).astype(np.uint8)


class SpotPredictor:
    """Predicts the centre of gravity of each colour, and counts the images that it was given."""

    covariance = np.diag([4.0, 1.0])

    def __init__(self) -> None:
        self.shown = 0

    def __call__(self, images: np.ndarray) -> Detections:
        self.shown += len(images)
        n, _, h, w = images.shape
        x, y = np.meshgrid(np.arange(w), np.arange(h))
        values = images.astype(float)
        xy, likelihood = np.zeros((n, 3, 2)), np.zeros((n, 3))
        for k in range(3):
            others = [c for c in range(3) if c != k]
            weight = np.clip(values[:, k] - values[:, others].max(axis=1) - 30, 0, None)
            total = weight.sum(axis=(1, 2)) + 1e-9
            xy[:, k] = np.stack([(weight * x).sum((1, 2)), (weight * y).sum((1, 2))], axis=1) / total[:, None]
            likelihood[:, k] = np.where(weight.max(axis=(1, 2)) > 40, 0.8, 0.01)
        return Detections(xy, likelihood, np.broadcast_to(self.covariance, (n, 3, 2, 2)).copy())


@pytest.fixture
def estimator() -> CoarseToFineEstimator:
    return CoarseToFineEstimator(SpotPredictor(), SpotPredictor())


@pytest.fixture
def metadata() -> CheckpointMetadata:
    keypoints = ("base", "middle", "tip")
    return CheckpointMetadata(
        backbone="resnet18",
        keypoints=keypoints,
        definition=AngleDefinition("three-point", keypoints),
        regions=(REGION,),
        reference=(1, 2, 1),
        calibration=Calibration(reference_peak=(0.8, 0.8, 0.8)),
    )


def arms(angles_deg: np.ndarray) -> np.ndarray:
    """Positions (T, 3, 2) px of a fixed base and an arm that turns about it."""
    turn = np.deg2rad(angles_deg)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    base = np.broadcast_to([150.0, 110.0], (len(turn), 2))
    return np.stack([base, base + 50 * along, base + 95 * along], axis=1)


def test_positions_are_mapped_back_to_the_frame(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.linspace(0, 330, 12))
    found = estimator.detect(np.stack([frame_of(xy) for xy in truth]), GEOMETRY)
    np.testing.assert_allclose(found.xy, truth, atol=0.1)


def test_covariances_are_mapped_back_to_the_frame(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    # The tip's crop is turned by 90 degrees here and magnified 1.5 times: its x is the frame's y.
    found = estimator.refine(frame_of(arms(np.array([90.0]))[0])[None], arms(np.array([90.0])), GEOMETRY)
    np.testing.assert_allclose(found.covariance[0, 2], np.diag([1.0, 4.0]) / 1.5**2, atol=0.02)


def test_shift_augmentation_cancels_a_pull_toward_the_crop_centre(metadata: CheckpointMetadata) -> None:
    """A network whose predictions are pulled toward the centre of the crop."""

    class PulledToTheCentre(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            middle = (images.shape[2] - 1) / 2
            return Detections(middle + 0.8 * (found.xy - middle), found.likelihood, found.covariance)

    truth = arms(np.linspace(0, 330, 12))
    frames = np.stack([frame_of(xy) for xy in truth])
    for off_px in (0.0, 1.0, 3.0):
        found = CoarseToFineEstimator(SpotPredictor(), PulledToTheCentre()).refine(
            frames, truth + off_px, GEOMETRY
        )
        # One crop 3 px off would leave 0.2 * 3 px, and a second one around its result 0.2 * 0.6 px.
        np.testing.assert_allclose(found.xy, truth, atol=0.06 + 0.04 * off_px)


def test_single_view_keypoints_are_not_averaged_over_shifted_crops(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    single = CoarseToFineEstimator(SpotPredictor(), SpotPredictor(), single_view=(1,))
    one, other = (own.refine(frames, truth, GEOMETRY) for own in (estimator, single))
    # One of three keypoints needs two crops fewer in each of two frames.
    assert estimator.refiner.shown - single.refiner.shown == 2 * 2
    np.testing.assert_array_equal(one.xy[:, [0, 2]], other.xy[:, [0, 2]])
    np.testing.assert_allclose(other.xy[:, 1], truth[:, 1], atol=0.1)


def test_of_two_distant_predictions_the_likelier_is_taken() -> None:
    one, other = (
        Detections(np.full((1, 2, 2), x), np.array([[0.8, 0.4]]), np.full((1, 2, 2, 2), x))
        for x in (10.0, 13.0)
    )
    both = average_predictions(one, other, 8.0)
    np.testing.assert_array_equal(both.xy, np.full((1, 2, 2), 11.5))
    far = Detections(other.xy + 20.0, np.array([[0.5, 0.6]]), other.covariance)
    both = average_predictions(one, far, 8.0)
    np.testing.assert_array_equal(both.xy[0, :, 0], [10.0, 33.0])
    np.testing.assert_array_equal(both.likelihood, [[0.8, 0.6]])
    np.testing.assert_array_equal(both.covariance[0, :, 0, 0], [10.0, 13.0])


def test_a_video_is_tracked_with_few_searches(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.concatenate([np.linspace(0, 120, 61), np.linspace(118, 0, 59)]))
    tracker = KeypointTracker(estimator, metadata)
    frames = [frame_of(xy) for xy in truth]
    found = np.concatenate([tracker.detect(frames[i : i + 4]).xy for i in range(0, len(frames), 4)])
    np.testing.assert_allclose(found, truth, atol=0.15)
    assert estimator.locator.shown <= 2 + len(frames) / CHECK_EVERY + 2


def test_a_jump_is_found_by_a_new_search(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = np.concatenate([arms(np.linspace(0, 10, 6)), arms(np.linspace(150, 160, 6))])
    found = KeypointTracker(estimator, metadata).detect([frame_of(xy) for xy in truth])
    np.testing.assert_allclose(found.xy, truth, atol=0.15)


def test_a_hidden_keypoint_is_unlikely_and_then_found_again(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.linspace(0, 40, 21))
    frames = [frame_of(xy) for xy in truth]
    for i in range(8, 12):
        frames[i][:] = BACKGROUND
    found = KeypointTracker(estimator, metadata).detect(frames)
    assert (found.likelihood[8:12] < 0.1).all()
    np.testing.assert_allclose(found.xy[12:], truth[12:], atol=0.15)
    assert (found.likelihood[12:] > 0.9).all()


def test_a_keypoint_on_which_both_networks_disagree_is_unlikely(metadata: CheckpointMetadata) -> None:
    class ShiftedPredictor(SpotPredictor):
        shift_px = 0.0

        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            return Detections(found.xy + self.shift_px, found.likelihood, found.covariance)

    truth, refiner = arms(np.array([20.0])), ShiftedPredictor()
    for refiner.shift_px, likely in ((2.0, True), (15.0, False)):
        found = CoarseToFineEstimator(SpotPredictor(), refiner).detect([frame_of(truth[0])], GEOMETRY)
        assert (found.likelihood > 0.5).all() == likely
        assert (found.likelihood == 0).all() != likely


class ConstantRegressor:
    """An end regressor that returns the same step for every crop of the end of keypoints 1 and 2."""

    ends = ((1, 2),)

    def __init__(self, *step: float) -> None:
        self.step = np.array(step)
        self.shown: list[np.ndarray] = []
        self.most = 0

    def __call__(self, images: np.ndarray) -> np.ndarray:
        self.shown += list(images)
        self.most = max(self.most, len(images))
        return np.broadcast_to(self.step, (len(images), 1, 3))


def test_end_regression_moves_an_end_by_the_predicted_step(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    plain = estimator.refine(frames, truth, GEOMETRY)
    crops = estimator.refiner.shown
    regressor = ConstantRegressor(3.0, -6.0, 0.1)
    regressed = CoarseToFineEstimator(SpotPredictor(), SpotPredictor(), end_regressor=regressor)
    found = regressed.refine(frames, truth, GEOMETRY)
    # 3 px along the end and -6 px across it, in crops of 3 px per frame px.
    for i, turn in enumerate(np.deg2rad([20.0, 65.0])):
        along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        half = 22.5 * np.array([np.cos(turn + 0.1), np.sin(turn + 0.1)])
        middle = truth[i, 1:].mean(axis=0) + along - 2 * across
        np.testing.assert_allclose(found.xy[i, 1:], [middle - half, middle + half], atol=0.25)
    # Other keypoints are averaged over shifted crops; an end has one crop and one high-resolution crop.
    np.testing.assert_allclose(found.xy[:, 0], plain.xy[:, 0], atol=1e-9)
    assert crops - regressed.refiner.shown == 2 * 2 * 2
    assert [shown.shape for shown in regressor.shown] == [(3, 128, 128)] * 2
    # The high-resolution crop lies along the end: one spot at its left, the other at its right.
    for shown in regressor.shown:
        spots = SpotPredictor()(shown[None]).xy[0, 1:]
        np.testing.assert_allclose(spots.mean(axis=0), [63.5, 63.5], atol=1.0)
        assert spots[0, 0] < 16
        assert spots[1, 0] > 112
        assert np.ptp(spots[:, 1]) < 0.2


def test_end_crops_are_regressed_in_batches(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.linspace(0, 60, 70))
    frames = [frame_of(xy) for xy in truth]
    regressor = ConstantRegressor(0.0, 0.0, 0.0)
    replace(estimator, end_regressor=regressor).refine(frames, truth, GEOMETRY)
    assert len(regressor.shown) == 70
    assert regressor.most <= 64


def test_an_end_that_turns_about_its_static_point_is_regressed_in_every_frame(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    turn = np.deg2rad(np.arange(24) * 0.45)
    middle = np.broadcast_to([170.0, 110.0], (len(turn), 2))
    truth = np.stack([middle - [50, 0], middle, middle + 45 * np.stack([np.cos(turn), np.sin(turn)], 1)], 1)
    regressed = replace(estimator, end_regressor=ConstantRegressor(0.0, 3.0, 0.0))
    found = KeypointTracker(regressed, metadata).detect([frame_of(xy) for xy in truth])
    across = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    np.testing.assert_allclose(found.xy[:, 1:], truth[:, 1:] + across[:, None], atol=0.25)


@pytest.mark.parametrize("step", [(9.0, 0.0, 0.0), (0.0, 0.0, -0.3), (np.nan, 0.0, 0.0)])
def test_a_step_that_is_too_large_is_ignored(
    step: tuple[float, ...], estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    regressed = CoarseToFineEstimator(
        SpotPredictor(), SpotPredictor(), end_regressor=ConstantRegressor(*step)
    )
    one, other = (own.refine(frames, truth, GEOMETRY) for own in (estimator, regressed))
    np.testing.assert_array_equal(one.xy, other.xy)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_an_end_with_one_missing_point_is_not_regressed(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    near = arms(np.array([20.0]))
    frame = frame_of(near[0])
    near[0, 2] = np.nan
    regressed = CoarseToFineEstimator(
        SpotPredictor(), SpotPredictor(), end_regressor=ConstantRegressor(3.0, 3.0, 0.1)
    )
    one, other = (own.refine([frame], near, GEOMETRY) for own in (estimator, regressed))
    np.testing.assert_array_equal(one.xy, other.xy)


def test_an_implausible_distance_is_unlikely_and_searched(metadata: CheckpointMetadata) -> None:
    """Behind an occluder the tip's crop may show something else, further and further away."""
    truth = arms(np.full(8, 20.0))
    lengths = reference_distances(truth, metadata.reference, np.full(8, REGION.refiner_scale))
    known = replace(metadata, distance_range=tuple(map(tuple, lengths.tolist())))
    frames = [frame_of(xy) for xy in truth]
    for own, stretch, likely in (
        (known, 2.0, False),
        (known, 1.4, False),
        (known, 1.15, True),
        (metadata, 2.0, True),
    ):
        away = truth[0].copy()
        away[2] = truth[0, 1] + stretch * (truth[0, 2] - truth[0, 1])
        frames[3:6] = [frame_of(away)] * 3
        found = KeypointTracker(CoarseToFineEstimator(SpotPredictor(), SpotPredictor()), own).detect(frames)
        assert (found.likelihood[3:6, 2] > 0.5).all() == likely
        assert (found.likelihood[[0, 1, 2, 6, 7]] > 0.9).all()
        if not likely:
            searching = CoarseToFineEstimator(SpotPredictor(), SpotPredictor())
            KeypointTracker(searching, own).detect(frames)
            assert searching.locator.shown >= 4


def test_frames_are_searched_until_both_networks_are_sure(metadata: CheckpointMetadata) -> None:
    """A false tip found during an occlusion is not tracked on."""
    truth = arms(np.full(12, 20.0))
    frames = [frame_of(xy) for xy in truth]

    class UnsureAtFirst(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            if self.shown <= 5:
                found.likelihood[:, 2] = 0.3
            return found

    locator = UnsureAtFirst()
    tracker = KeypointTracker(CoarseToFineEstimator(locator, SpotPredictor()), metadata)
    likelihood = np.concatenate([tracker.detect([frame]).likelihood for frame in frames])
    assert (likelihood[:5, 2] < 0.5).all()
    assert (likelihood[5:] > 0.9).all()
    assert locator.shown == 6


def test_a_false_track_ends_with_the_next_check(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    rest = arms(np.array([20.0]))[0]
    false = rest + np.array([0.0, 90.0])

    class FalseAtFirst(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            if self.shown <= 1:
                # As a locator that takes something else for the arm in the first frame.
                return Detections(
                    np.broadcast_to(false * 0.5 - 0.25, found.xy.shape), found.likelihood, found.covariance
                )
            return found

    class AlwaysConfident(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            lost = found.likelihood < 0.1
            xy = np.where(lost[..., None], 31.5, found.xy)
            return Detections(xy, np.where(lost, 0.5, 0.8), found.covariance)

    tracker = KeypointTracker(CoarseToFineEstimator(FalseAtFirst(), AlwaysConfident()), metadata)
    found = tracker.detect([frame_of(rest)] * (CHECK_EVERY + 10))
    assert np.abs(found.xy[:10] - rest).max() > 50
    np.testing.assert_allclose(found.xy[-5:], np.broadcast_to(rest, (5, 3, 2)), atol=0.15)


def test_keypoints_move_on_during_dropped_frames(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    """Constant-velocity prediction spans the gap, so fewer crops are needed after it."""
    frames = [frame_of(xy) for xy in arms(2.5 * np.arange(13))]
    crops = {}
    for is_told in (True, False):
        tracker = KeypointTracker(estimator, metadata)
        tracker.detect(frames[:6])
        before = estimator.refiner.shown
        if is_told:
            tracker.skip_frames(4)
        found = [tracker.detect([frames[i]]).xy[0] for i in (10, 11, 12)]
        np.testing.assert_allclose(found, arms(2.5 * np.array([10, 11, 12])), atol=0.15)
        crops[is_told] = (estimator.refiner.shown - before) // 3
    assert crops[True] < crops[False]


class WrongTipLocator(SpotPredictor):
    """A locator that puts the tip next to its place in its first images."""

    def __init__(self, images: int) -> None:
        super().__init__()
        self.images = images

    def __call__(self, images: np.ndarray) -> Detections:
        first = self.shown
        found = super().__call__(images)
        for i in range(max(0, min(len(images), self.images - first))):
            found.xy[i, 2] += 30.0
            found.likelihood[i, 2] = 0.3
        return found


def test_the_backward_pass_finds_keypoints_lost_at_first(metadata: CheckpointMetadata) -> None:
    truth = arms(2.0 * np.arange(20))
    frames = [frame_of(xy) for xy in truth]
    found = KeypointTracker(CoarseToFineEstimator(WrongTipLocator(8), SpotPredictor()), metadata).detect(
        frames
    )
    np.testing.assert_allclose(found.xy, truth, atol=0.2)
    assert (found.likelihood > 0.9).all()
    # Frames given one by one, as from a camera, have no later frames.
    live = KeypointTracker(CoarseToFineEstimator(WrongTipLocator(8), SpotPredictor()), metadata)
    first = live.detect(frames[:1])
    assert first.likelihood[0, 2] < 0.5


def test_the_backward_pass_ends_at_an_occlusion(metadata: CheckpointMetadata) -> None:
    """Before an occlusion the tip may have been anywhere."""

    class CentreIfLost(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            lost = found.likelihood < 0.1
            return Detections(np.where(lost[..., None], 31.5, found.xy), found.likelihood, found.covariance)

    truth = arms(2.0 * np.arange(20))
    frames = [frame_of(xy) for xy in truth]
    frames[4][:] = BACKGROUND
    estimator = CoarseToFineEstimator(WrongTipLocator(8), CentreIfLost())
    found = KeypointTracker(estimator, metadata).detect(frames)
    np.testing.assert_allclose(found.xy[5:], truth[5:], atol=0.2)
    assert (found.likelihood[5:] > 0.9).all()
    assert (found.likelihood[:5, 2] < 0.5).all()


def without(estimator: CoarseToFineEstimator, stage: str) -> CoarseToFineEstimator:
    """The same estimator without a stage, with predictors that count from 0."""
    locator, refiner = type(estimator.locator)(), type(estimator.refiner)()
    return replace(estimator, locator=locator, refiner=refiner, stages=StageSettings(**{stage: False}))


def test_stage_whole_frame_search(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.array([0.0]))
    frame = frame_of(truth[0])
    # The tip, at x = 245 px, lies outside.
    geometry = CropGeometry(RegionOfInterest(SIZE_WH, 100, 60, 120, 100, 0.5, 1.5), GEOMETRY.reference)
    off = without(estimator, "whole_frame_search")
    searched, unsearched = (own.propose([frame], geometry) for own in (estimator, off))
    np.testing.assert_allclose(searched.xy, truth, atol=0.5)
    assert searched.likelihood[0, 2] > 0.5
    assert unsearched.likelihood[0, 2] < 0.1
    assert (estimator.locator.shown, off.locator.shown) == (2, 1)


def test_stage_iterative_refinement(estimator: CoarseToFineEstimator) -> None:
    """Of keypoints expected 3 px off, a second crop is cut, or is not."""
    truth = arms(np.array([20.0]))
    off = without(estimator, "iterative_refinement")
    for own in (estimator, off):
        own.refine([frame_of(truth[0])], truth + 3.0, GEOMETRY)
    assert (estimator.refiner.shown, off.refiner.shown) == (3 + 3 + 6, 3 + 6)


def test_stage_shift_augmentation(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.array([20.0]))
    off = without(estimator, "shift_augmentation")
    for own in (estimator, off):
        found = own.refine([frame_of(truth[0])], truth, GEOMETRY)
        np.testing.assert_allclose(found.xy, truth, atol=0.15)
    assert (estimator.refiner.shown, off.refiner.shown) == (3 + 6, 3)


def test_stage_end_regression(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.array([20.0]))
    regressor = ConstantRegressor(0.0, 3.0, 0.0)
    plain = estimator.refine([frame_of(truth[0])], truth, GEOMETRY)
    off = without(replace(estimator, end_regressor=regressor), "end_regression")
    found = off.refine([frame_of(truth[0])], truth, GEOMETRY)
    assert not regressor.shown
    np.testing.assert_array_equal(found.xy, plain.xy)


def test_stage_agreement_check(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.array([20.0]))
    proposed, found = predicted_at(truth), predicted_at(truth + 15.0)
    proposed, found = (replace(one, likelihood=np.full((1, 3), 0.8)) for one in (proposed, found))
    off = without(estimator, "agreement_check")
    checked, unchecked = (own.check_agreement(proposed, found, GEOMETRY) for own in (estimator, off))
    assert (checked.likelihood == 0).all()
    assert (unchecked.likelihood == 0.8).all()


def test_stage_static_patches(estimator: CoarseToFineEstimator, metadata: CheckpointMetadata) -> None:
    """In a static video keypoints are predicted about `REST_PREDICTIONS` times, or in every frame."""
    frames = [frame_of(arms(np.array([20.0]))[0])] * 14
    off = without(estimator, "static_patches")
    for own in (estimator, off):
        KeypointTracker(own, metadata).detect(frames)
    # Each prediction takes one crop and two shifted ones for each of three keypoints.
    assert off.refiner.shown == 9 * len(frames)
    assert estimator.refiner.shown <= 9 * (1 + REST_PREDICTIONS + FRAMES_AHEAD)


def test_stage_backward_pass(metadata: CheckpointMetadata) -> None:
    truth = arms(2.0 * np.arange(12))
    frames = [frame_of(xy) for xy in truth]
    for runs in (True, False):
        estimator = CoarseToFineEstimator(
            WrongTipLocator(4), SpotPredictor(), stages=StageSettings(backward_pass=runs)
        )
        found = KeypointTracker(estimator, metadata).detect(frames)
        assert (found.likelihood[0, 2] > 0.9) == runs
        assert (found.likelihood[-4:] > 0.9).all()


def read_only(found: Detections) -> Detections:
    """The same detections, whose arrays cannot be written into."""
    arrays = [array.copy() for array in (found.xy, found.likelihood, found.covariance)]
    for array in arrays:
        array.setflags(write=False)
    return Detections(*arrays)


class ReadOnlyPredictor(SpotPredictor):
    """Predictions whose arrays cannot be written into."""

    def __call__(self, images: np.ndarray) -> Detections:
        return read_only(super().__call__(images))


@pytest.mark.parametrize("shift_ends", [False, True])
def test_no_stage_writes_into_its_argument(shift_ends: bool, metadata: CheckpointMetadata) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = np.stack([frame_of(xy) for xy in truth])
    geometry = CropGeometry(RegionOfInterest(SIZE_WH, 100, 60, 100, 80, 0.5, 1.5), GEOMETRY.reference)
    estimator = CoarseToFineEstimator(
        ReadOnlyPredictor(),
        ReadOnlyPredictor(),
        end_regressor=ConstantRegressor(0.5, 0.5, 0.01),
        shift_ends=shift_ends,
    )
    expected, wanted = read_only(predicted_at(truth + 3.0)), np.ones((2, 3), bool)
    wanted[0, 0] = False
    for array in (frames, wanted):
        array.setflags(write=False)
    estimate = Estimate(expected, wanted)
    for stage in (estimator.crop_and_predict, estimator.average_shifted, estimator.regress_ends):
        changed = stage(frames, estimate, geometry)
        assert not np.array_equal(changed.found.xy, expected.xy)
        np.testing.assert_array_equal(changed.found.xy[0, 0], expected.xy[0, 0])
    # Where no keypoint is pending nothing is looked at, and the arguments may be returned as they are.
    assert estimator.refine(frames, expected, geometry, np.zeros((2, 3), bool)) is expected
    for given in (expected, expected.xy):
        estimator.refine(frames, given, geometry, wanted)
    proposed = read_only(estimator.propose(frames, geometry))
    found = read_only(estimator.detect(frames, geometry))
    estimator.check_agreement(proposed, found, geometry)
    metadata.calibrated(found, geometry)


def test_the_tracker_writes_into_no_detections_that_it_is_given(metadata: CheckpointMetadata) -> None:
    """Neither in the forward pass nor in the backward pass."""

    class ReadOnlyEstimator(CoarseToFineEstimator):
        def detect(self, frames, geometry):
            return read_only(super().detect(frames, geometry))

        def propose(self, frames, geometry):
            return read_only(super().propose(frames, geometry))

        def refine(self, frames, expected, geometry, wanted=None):
            return read_only(super().refine(frames, expected, geometry, wanted))

    # Motion, then rest, then a jump after which frames are searched again.
    truth = np.concatenate([arms(2.0 * np.arange(12)), arms(np.full(8, 22.0)), arms(np.full(4, 150.0))])
    tracker = KeypointTracker(ReadOnlyEstimator(WrongTipLocator(4), ReadOnlyPredictor()), metadata)
    found = tracker.detect([frame_of(xy) for xy in truth])
    np.testing.assert_allclose(found.xy, truth, atol=0.2)
    assert (found.likelihood > 0.9).all()
