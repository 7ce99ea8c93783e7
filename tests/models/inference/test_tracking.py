"""Keypoint tracking through a video with predictors whose output is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spots import (
    BACKGROUND,
    REGION,
    ConstantRegressor,
    ReadOnlyPredictor,
    SpotPredictor,
    arms,
    frame_of,
    read_only,
    without,
)

from bendtrack.models.inference.coarse_to_fine import (
    CoarseToFineEstimator,
)
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import reference_distances
from bendtrack.models.inference.stages import StageSettings
from bendtrack.models.inference.tracking import CHECK_EVERY, FRAMES_AHEAD, REST_PREDICTIONS, KeypointTracker
from bendtrack.tracker.types import Detections


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


def test_stage_static_patches(estimator: CoarseToFineEstimator, metadata: CheckpointMetadata) -> None:
    """In a static video keypoints are predicted about `REST_PREDICTIONS` times, or in every frame."""
    frames = [frame_of(arms(np.array([20.0]))[0])] * 14
    off = without(estimator, "static_patches")
    for own in (estimator, off):
        KeypointTracker(own, metadata).detect(frames)
    # Each prediction takes one crop for each of three keypoints.
    assert off.refiner.shown == 3 * len(frames)
    assert estimator.refiner.shown <= 3 * (1 + REST_PREDICTIONS + FRAMES_AHEAD)


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


class SeesALookAlike(SpotPredictor):
    """A refiner that is sure of a place 20 px away where its keypoint is near the edge of the crop."""

    def __call__(self, images: np.ndarray) -> Detections:
        found = super().__call__(images)
        middle = (images.shape[2] - 1) / 2
        edge = np.linalg.norm(found.xy - middle, axis=2) > 12
        aside = middle + np.array([0.0, 20.0])
        return replace(
            found,
            xy=np.where(edge[..., None], aside, found.xy),
            likelihood=np.where(edge, 0.6, found.likelihood),
        )


@pytest.mark.parametrize("step_deg", [14.0, 25.0, 40.0, 70.0])
def test_a_keypoint_that_moved_unexpectedly_is_searched(
    step_deg: float, metadata: CheckpointMetadata
) -> None:
    """Dropped frames and fast motion: the crop at the expected place shows something that looks alike."""
    turn = np.concatenate([np.arange(5) * 1.0, 4.0 + step_deg * np.array([1, 2, 3, 2, 1, 0, 1])])
    truth = arms(turn)
    estimator = CoarseToFineEstimator(SpotPredictor(), SeesALookAlike())
    found = KeypointTracker(estimator, metadata).detect([frame_of(xy) for xy in truth])
    np.testing.assert_allclose(found.xy, truth, atol=0.2)
    assert (found.likelihood > 0.9).all()


def test_a_keypoint_found_far_from_where_it_was_expected_is_not_sure_without_the_locator(
    metadata: CheckpointMetadata,
) -> None:
    """Where the locator sees nothing at all, what the crop shows far from the expected place is not believed."""

    class SeesNothingLater(SpotPredictor):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            return replace(found, likelihood=found.likelihood * (self.shown <= 1))

    truth = arms(np.array([0.0, 1.0, 2.0, 3.0, 40.0]))
    estimator = CoarseToFineEstimator(SeesNothingLater(), SeesALookAlike())
    found = KeypointTracker(estimator, metadata).detect([frame_of(xy) for xy in truth])
    assert (found.likelihood[:4] > 0.9).all()
    assert (found.likelihood[4, 2] < 0.5).all()
