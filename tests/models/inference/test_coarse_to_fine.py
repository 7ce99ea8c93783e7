"""Finder and Follower with networks whose answer is known: where they look, what they believe, when they search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.coarse_to_fine import CoarseToFineEstimator, average_predictions
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest, reference_distances
from bendtrack.models.inference.tracking import CHECK_EVERY, KeypointTracker
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


class FindsSpots:
    """A reader that gives the centre of gravity of each colour, and counts the images it was shown."""

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
    return CoarseToFineEstimator(FindsSpots(), FindsSpots())


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
    """Positions (T, 3, 2) of a base that rests and an arm that turns about it."""
    turn = np.deg2rad(angles_deg)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    base = np.broadcast_to([150.0, 110.0], (len(turn), 2))
    return np.stack([base, base + 50 * along, base + 95 * along], axis=1)


def test_positions_come_back_through_every_view(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.linspace(0, 330, 12))
    found = estimator.detect(np.stack([frame_of(xy) for xy in truth]), GEOMETRY)
    np.testing.assert_allclose(found.xy, truth, atol=0.1)


def test_covariances_turn_and_shrink_with_the_patch(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    # The tip's patch is turned by 90 degrees here and magnified 1.5 times: its x is the frame's y.
    found = estimator.refine(frame_of(arms(np.array([90.0]))[0])[None], arms(np.array([90.0])), GEOMETRY)
    np.testing.assert_allclose(found.covariance[0, 2], np.diag([1.0, 4.0]) / 1.5**2, atol=0.02)


def test_what_a_patch_adds_by_where_it_is_cut_cancels(metadata: CheckpointMetadata) -> None:
    """A network that draws what it finds toward the middle of its patch, and now and then sees another thing."""

    class DrawnToTheMiddle(FindsSpots):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            middle = (images.shape[2] - 1) / 2
            return Detections(middle + 0.8 * (found.xy - middle), found.likelihood, found.covariance)

    truth = arms(np.linspace(0, 330, 12))
    frames = np.stack([frame_of(xy) for xy in truth])
    for off_px in (0.0, 1.0, 3.0):
        found = CoarseToFineEstimator(FindsSpots(), DrawnToTheMiddle()).refine(
            frames, truth + off_px, GEOMETRY
        )
        # Once it was looked for from 3 px away, 0.2 * 3 px would be left, and from what was found then 0.2 * 0.6.
        np.testing.assert_allclose(found.xy, truth, atol=0.06 + 0.04 * off_px)


def test_what_is_not_measured_by_is_looked_at_once(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    quick = CoarseToFineEstimator(FindsSpots(), FindsSpots(), single_view=(1,))
    one, other = (own.refine(frames, truth, GEOMETRY) for own in (estimator, quick))
    # Of three keypoints in two frames one is seen in two patches less.
    assert estimator.refiner.shown - quick.refiner.shown == 2 * 2
    np.testing.assert_array_equal(one.xy[:, [0, 2]], other.xy[:, [0, 2]])
    np.testing.assert_allclose(other.xy[:, 1], truth[:, 1], atol=0.1)


def test_of_two_readings_far_apart_the_likelier_counts() -> None:
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


def test_a_video_is_followed_and_seldom_searched(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.concatenate([np.linspace(0, 120, 61), np.linspace(118, 0, 59)]))
    tracker = KeypointTracker(estimator, metadata)
    frames = [frame_of(xy) for xy in truth]
    found = np.concatenate([tracker.detect(frames[i : i + 4]).xy for i in range(0, len(frames), 4)])
    np.testing.assert_allclose(found, truth, atol=0.15)
    assert estimator.locator.shown <= 2 + len(frames) / CHECK_EVERY + 2


def test_a_jump_is_found_by_searching_again(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = np.concatenate([arms(np.linspace(0, 10, 6)), arms(np.linspace(150, 160, 6))])
    found = KeypointTracker(estimator, metadata).detect([frame_of(xy) for xy in truth])
    np.testing.assert_allclose(found.xy, truth, atol=0.15)


def test_what_is_hidden_is_unlikely_and_found_again(
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


def test_what_the_two_networks_put_far_apart_is_unlikely(metadata: CheckpointMetadata) -> None:
    class SeesItBeside(FindsSpots):
        beside_px = 0.0

        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            return Detections(found.xy + self.beside_px, found.likelihood, found.covariance)

    truth, refine = arms(np.array([20.0])), SeesItBeside()
    for refine.beside_px, likely in ((2.0, True), (15.0, False)):
        found = CoarseToFineEstimator(FindsSpots(), refine).detect([frame_of(truth[0])], GEOMETRY)
        assert (found.likelihood > 0.5).all() == likely
        assert (found.likelihood == 0).all() != likely


class TellsTheSame:
    """An aligner that wants the second and the third keypoint moved by the same step wherever it sees them."""

    ends = ((1, 2),)

    def __init__(self, *step: float) -> None:
        self.step = np.array(step)
        self.shown: list[np.ndarray] = []
        self.most = 0

    def __call__(self, images: np.ndarray) -> np.ndarray:
        self.shown += list(images)
        self.most = max(self.most, len(images))
        return np.broadcast_to(self.step, (len(images), 1, 3))


def test_an_end_is_put_where_it_is_told_to_lie(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    plain = estimator.refine(frames, truth, GEOMETRY)
    looks = estimator.refiner.shown
    align = TellsTheSame(3.0, -6.0, 0.1)
    told = CoarseToFineEstimator(FindsSpots(), FindsSpots(), end_regressor=align)
    found = told.refine(frames, truth, GEOMETRY)
    # Three px along the end and six back across it, of images of three px for one of the frame.
    for i, turn in enumerate(np.deg2rad([20.0, 65.0])):
        along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
        half = 22.5 * np.array([np.cos(turn + 0.1), np.sin(turn + 0.1)])
        middle = truth[i, 1:].mean(axis=0) + along - 2 * across
        np.testing.assert_allclose(found.xy[i, 1:], [middle - half, middle + half], atol=0.25)
    # What is no end is seen from two sides as ever; an end once, and once closer.
    np.testing.assert_allclose(found.xy[:, 0], plain.xy[:, 0], atol=1e-9)
    assert looks - told.refiner.shown == 2 * 2 * 2
    assert [shown.shape for shown in align.shown] == [(3, 128, 128)] * 2
    # The closer picture lies along the end: of its two spots, green and blue, one is at its left and one at its right.
    for shown in align.shown:
        spots = FindsSpots()(shown[None]).xy[0, 1:]
        np.testing.assert_allclose(spots.mean(axis=0), [63.5, 63.5], atol=1.0)
        assert spots[0, 0] < 16
        assert spots[1, 0] > 112
        assert np.ptp(spots[:, 1]) < 0.2


def test_many_ends_are_seen_closer_a_few_at_a_time(estimator: CoarseToFineEstimator) -> None:
    truth = arms(np.linspace(0, 60, 70))
    frames = [frame_of(xy) for xy in truth]
    align = TellsTheSame(0.0, 0.0, 0.0)
    replace(estimator, end_regressor=align).refine(frames, truth, GEOMETRY)
    assert len(align.shown) == 70
    assert align.most <= 64


def test_an_end_that_turns_about_one_of_its_points_is_seen_closer_all_the_time(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    turn = np.deg2rad(np.arange(24) * 0.45)
    middle = np.broadcast_to([170.0, 110.0], (len(turn), 2))
    truth = np.stack([middle - [50, 0], middle, middle + 45 * np.stack([np.cos(turn), np.sin(turn)], 1)], 1)
    told = replace(estimator, end_regressor=TellsTheSame(0.0, 3.0, 0.0))
    found = KeypointTracker(told, metadata).detect([frame_of(xy) for xy in truth])
    across = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    np.testing.assert_allclose(found.xy[:, 1:], truth[:, 1:] + across[:, None], atol=0.25)


@pytest.mark.parametrize("step", [(9.0, 0.0, 0.0), (0.0, 0.0, -0.3), (np.nan, 0.0, 0.0)])
def test_an_end_that_is_told_to_lie_far_off_is_seen_from_two_sides(
    step: tuple[float, ...], estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = [frame_of(xy) for xy in truth]
    told = CoarseToFineEstimator(FindsSpots(), FindsSpots(), end_regressor=TellsTheSame(*step))
    one, other = (own.refine(frames, truth, GEOMETRY) for own in (estimator, told))
    np.testing.assert_array_equal(one.xy, other.xy)
    np.testing.assert_array_equal(one.covariance, other.covariance)


def test_an_end_of_which_one_point_is_looked_for_is_not_aligned(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    near = arms(np.array([20.0]))
    frame = frame_of(near[0])
    near[0, 2] = np.nan
    told = CoarseToFineEstimator(FindsSpots(), FindsSpots(), end_regressor=TellsTheSame(3.0, 3.0, 0.1))
    one, other = (own.refine([frame], near, GEOMETRY) for own in (estimator, told))
    np.testing.assert_array_equal(one.xy, other.xy)


def test_an_end_that_stretches_is_not_believed_and_searched(metadata: CheckpointMetadata) -> None:
    """Behind something the tip's patch takes what it sees for the tip, further and further away."""
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
        found = KeypointTracker(CoarseToFineEstimator(FindsSpots(), FindsSpots()), own).detect(frames)
        assert (found.likelihood[3:6, 2] > 0.5).all() == likely
        assert (found.likelihood[[0, 1, 2, 6, 7]] > 0.9).all()
        if not likely:
            searching = CoarseToFineEstimator(FindsSpots(), FindsSpots())
            KeypointTracker(searching, own).detect(frames)
            assert searching.locator.shown >= 4


def test_a_frame_is_searched_until_both_networks_are_sure(metadata: CheckpointMetadata) -> None:
    """Where the tip comes out from behind something, what was taken for it meanwhile is not followed."""
    truth = arms(np.full(12, 20.0))
    frames = [frame_of(xy) for xy in truth]

    class UnsureAtFirst(FindsSpots):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            if self.shown <= 5:
                found.likelihood[:, 2] = 0.3
            return found

    locate = UnsureAtFirst()
    tracker = KeypointTracker(CoarseToFineEstimator(locate, FindsSpots()), metadata)
    likelihood = np.concatenate([tracker.detect([frame]).likelihood for frame in frames])
    assert (likelihood[:5, 2] < 0.5).all()
    assert (likelihood[5:] > 0.9).all()
    assert locate.shown == 6


def test_a_false_track_ends_with_the_next_search(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    rest = arms(np.array([20.0]))[0]
    false = rest + np.array([0.0, 90.0])

    class FindsFirstTheFalse(FindsSpots):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            if self.shown <= 1:
                # As a locator that is taken in by something else in the first frame.
                return Detections(
                    np.broadcast_to(false * 0.5 - 0.25, found.xy.shape), found.likelihood, found.covariance
                )
            return found

    class BelievesAnything(FindsSpots):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            lost = found.likelihood < 0.1
            xy = np.where(lost[..., None], 31.5, found.xy)
            return Detections(xy, np.where(lost, 0.5, 0.8), found.covariance)

    tracker = KeypointTracker(CoarseToFineEstimator(FindsFirstTheFalse(), BelievesAnything()), metadata)
    found = tracker.detect([frame_of(rest)] * (CHECK_EVERY + 10))
    assert np.abs(found.xy[:10] - rest).max() > 50
    np.testing.assert_allclose(found.xy[-5:], np.broadcast_to(rest, (5, 3, 2)), atol=0.15)


def test_frames_that_are_passed_over_are_reckoned_with(
    estimator: CoarseToFineEstimator, metadata: CheckpointMetadata
) -> None:
    """Keypoints go on in their own pace meanwhile, so one look is enough where they must be by now."""
    frames = [frame_of(xy) for xy in arms(2.5 * np.arange(13))]
    looks = {}
    for told in (True, False):
        tracker = KeypointTracker(estimator, metadata)
        tracker.detect(frames[:6])
        before = estimator.refiner.shown
        if told:
            tracker.pass_over(4)
        found = [tracker.detect([frames[i]]).xy[0] for i in (10, 11, 12)]
        np.testing.assert_allclose(found, arms(2.5 * np.array([10, 11, 12])), atol=0.15)
        looks[told] = (estimator.refiner.shown - before) // 3
    assert looks[True] < looks[False]


class LocatesNoTip(FindsSpots):
    """A locator that is taken in by something beside the tip in its first images."""

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


def test_what_was_lost_at_first_is_found_from_the_frames_after_it(metadata: CheckpointMetadata) -> None:
    truth = arms(2.0 * np.arange(20))
    frames = [frame_of(xy) for xy in truth]
    found = KeypointTracker(CoarseToFineEstimator(LocatesNoTip(8), FindsSpots()), metadata).detect(frames)
    np.testing.assert_allclose(found.xy, truth, atol=0.2)
    assert (found.likelihood > 0.9).all()
    # One by one, as they come from a camera, there is nothing after them.
    live = KeypointTracker(CoarseToFineEstimator(LocatesNoTip(8), FindsSpots()), metadata)
    first = live.detect(frames[:1])
    assert first.likelihood[0, 2] < 0.5


def test_looking_back_ends_where_nothing_is_seen(metadata: CheckpointMetadata) -> None:
    """Behind a board the tip may have been anywhere, and before it somewhere else."""

    class StaysInTheMiddle(FindsSpots):
        def __call__(self, images: np.ndarray) -> Detections:
            found = super().__call__(images)
            lost = found.likelihood < 0.1
            return Detections(np.where(lost[..., None], 31.5, found.xy), found.likelihood, found.covariance)

    truth = arms(2.0 * np.arange(20))
    frames = [frame_of(xy) for xy in truth]
    frames[4][:] = BACKGROUND
    estimator = CoarseToFineEstimator(LocatesNoTip(8), StaysInTheMiddle())
    found = KeypointTracker(estimator, metadata).detect(frames)
    np.testing.assert_allclose(found.xy[5:], truth[5:], atol=0.2)
    assert (found.likelihood[5:] > 0.9).all()
    assert (found.likelihood[:5, 2] < 0.5).all()
