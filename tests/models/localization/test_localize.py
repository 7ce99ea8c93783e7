"""Which end is fixed and where to look, from what a network finds in single frames, wrong ends included."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.coarse_to_fine import CoarseToFineEstimator
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.localization.base_anchor import BaseAnchoredEstimator
from bendtrack.models.localization.chain_assembly import assemble_chain
from bendtrack.models.localization.localize import ACROSS_SHARE, find_actuator
from bendtrack.models.localization.probe_frames import PseudoLabels, oriented
from bendtrack.tracker.angle import AngleDefinition, bending_angle
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.types import Detections

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (640, 480)
HEADER = CheckpointMetadata(
    backbone="resnet18",
    keypoints=KEYPOINTS,
    definition=AngleDefinition("two-vector", KEYPOINTS),
    regions=(RegionOfInterest((256, 256), 0, 0, 256, 256, 0.5, 1.0),),
    reference=(1, 0, 3, 2),
    calibration=Calibration(reference_peak=(0.6,) * 4),
    training={"pictures": 1},
)


def body(angle_deg: float) -> np.ndarray:
    """Four points (4, 2) px of an arm held at (300, 200)."""
    turn = np.radians(angle_deg)
    base = np.array([[300.0, 200.0], [330.0, 200.0]])
    tip = base[1] + 80 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    return np.stack([*base, tip, tip + 30 * np.array([np.cos(turn), np.sin(turn)])])


class Oracle(CoarseToFineEstimator):
    """Finds what it was told; pictures are numbered by their first pixel."""

    def __init__(self, xy: np.ndarray, peak: np.ndarray, noise_px: float = 1.0) -> None:
        super().__init__(self, self)
        object.__setattr__(self, "xy", xy + np.random.default_rng(0).normal(0, noise_px, xy.shape))
        object.__setattr__(self, "peak", peak)

    def offered(self, frames, region):
        chosen = [int(frame[0, 0, 0]) for frame in frames]
        return self.xy[chosen].copy()[:, :, None], self.peak[chosen].copy()[:, :, None]

    def refined(self, frames, xy, region, reference):
        n, k = xy.shape[:2]
        return Detections(xy.copy(), np.ones((n, k)), np.zeros((n, k, 2, 2)))


def probe_frames(n: int) -> np.ndarray:
    pictures = np.zeros((n, SIZE_WH[1], SIZE_WH[0], 3), np.uint8)
    pictures[:, 0, 0, 0] = np.arange(n)
    return pictures


def arms(sign: float = 1.0) -> np.ndarray:
    return np.stack([body(sign * angle) for angle in np.linspace(0, 120, 30)])


def test_the_end_that_rests_is_the_fixed_one() -> None:
    seen = find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.6)))
    assert seen.metadata.definition.sign == 1
    np.testing.assert_allclose(seen.estimator.fixed_xy, (300, 200), atol=3)
    assert seen.seen == 1.0


@pytest.mark.parametrize("turned", [0.3, 0.7, 1.0])
def test_frames_found_the_wrong_way_round_do_not_matter(turned: float) -> None:
    """Neither for where the fixed end is, nor for what is found later."""
    truth = arms(-1)
    wrong = np.random.default_rng(1).random(30) < turned
    xy = np.where(wrong[:, None, None], truth[:, ::-1], truth)
    seen = find_actuator(probe_frames(30), HEADER, Oracle(xy, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(seen.estimator.fixed_xy, (300, 200), atol=3)
    found, _ = oriented(xy, np.ones((30, 4)), seen.estimator.fixed_xy)
    np.testing.assert_array_equal(found, truth)
    # Positive is the way it bends, whichever that is on the screen.
    angle_deg, _, _ = bending_angle(truth, KEYPOINTS, seen.metadata.definition)
    np.testing.assert_allclose(angle_deg, np.linspace(0, 120, 30), atol=1e-6)


def test_a_place_that_fits_the_others_is_taken_before_a_higher_peak() -> None:
    truth = arms()

    class Attracted(Oracle):
        """Takes the clamp for the moving end in most frames, and offers what is right second."""

        def offered(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            wrong = xy.copy()
            wrong[::3, 2:] = xy[::3, :2]
            return np.concatenate([wrong, xy], axis=2), np.concatenate([peak, 0.5 * peak], axis=2)

    finder = Attracted(truth, np.full((30, 4), 0.6), noise_px=0.0)
    seen = find_actuator(probe_frames(30), HEADER, finder)
    assert seen.seen == 1.0
    places, peak = finder.candidate_peaks(probe_frames(30), HEADER.regions[0])
    found, _ = assemble_chain(places, peak, seen.estimator.fixed_xy, seen.estimator.body_px)
    np.testing.assert_array_equal(found, truth)


def test_what_does_not_move_is_taken_as_the_network_says() -> None:
    still = np.repeat(body(40)[None], 30, axis=0)
    seen = find_actuator(probe_frames(30), HEADER, Oracle(still, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(seen.estimator.fixed_xy, still[0, 0], atol=3)


def test_the_region_holds_every_pose_that_was_clearly_seen() -> None:
    xy, peak = arms(), np.full((30, 4), 0.6)
    xy[::3], peak[::3] = 20.0, 0.05  # a hand in the way: somewhere else, and hardly seen
    seen = find_actuator(probe_frames(30), HEADER, Oracle(xy, peak))
    region = seen.metadata.region_for(SIZE_WH)
    points = xy[1::3].reshape(-1, 2)
    corner = region.left, region.top
    assert (points >= corner).all()
    assert (points <= np.add(corner, (region.width, region.height))).all()
    assert region.left > 100
    assert seen.seen == pytest.approx(2 / 3)


def test_a_keypoint_taken_for_something_far_away_does_not_make_the_body_longer() -> None:
    """Nor the scale at which it is looked at smaller."""

    between = np.array([0.25, 0.5, 0.75])

    class Distracted(Oracle):
        """Takes a tool on the bench for the middle of the body, in most frames, when it looks at all of them."""

        def offered(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            middle = xy[:, 1:2] + between[:, None, None] * (xy[:, 2:3] - xy[:, 1:2])
            xy = np.concatenate([xy[:, :2], middle, xy[:, 2:]], axis=1)
            peak = np.full(xy.shape[:3], peak[0, 0, 0])
            if region.width == SIZE_WH[0]:
                xy[: 3 * len(xy) // 4, 3] = 40.0
            elif 140 * region.locator_scale < 40:
                # So small it sees nothing.
                xy += np.random.default_rng(3).uniform(-200, 200, (len(xy), 1, 1, 2))
            return xy, peak

    keypoints = (*KEYPOINTS[:2], "mid_1", "mid_2", "mid_3", *KEYPOINTS[2:])
    header = replace(
        HEADER,
        keypoints=keypoints,
        reference=(1, 0, 3, 2, 3, 6, 5),
        calibration=Calibration(reference_peak=(0.6,) * 7),
    )
    seen = find_actuator(probe_frames(30), header, Distracted(arms(), np.full((30, 4), 0.6)))
    usual = find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.6)))
    regions = [s.metadata.region_for(SIZE_WH) for s in (seen, usual)]
    for scale in ("locator_scale", "refiner_scale"):
        one, other = (getattr(region, scale) for region in regions)
        assert one == pytest.approx(other, rel=0.15)


@pytest.mark.parametrize(("sees_all_from", "scale_share"), [(0, 1.0), (90, 1.5), (1000, 1.0)])
def test_a_body_is_looked_at_larger_where_more_is_seen_then(sees_all_from: int, scale_share: float) -> None:
    class ShortSighted(Oracle):
        """Takes something beside the clamp for it in two frames of five, where the body is small."""

        def offered(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            if region.width < SIZE_WH[0] and 140 * region.locator_scale < sees_all_from:
                xy[::5, :2] += 40.0
                xy[1::5, :2] += 40.0
            return xy, peak

    finder = ShortSighted(arms(), np.full((30, 4), 0.6))
    seen = find_actuator(probe_frames(30), HEADER, finder)
    usual = find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.6)))
    assert seen.seen == pytest.approx(0.6 if sees_all_from == 1000 else 1.0)
    scales = [s.metadata.region_for(SIZE_WH).locator_scale for s in (seen, usual)]
    assert scales[0] / scales[1] == pytest.approx(scale_share, rel=0.05)


def test_where_nothing_is_seen_it_is_said() -> None:
    with pytest.raises(VideoError, match=r"expected an actuator in sight, got one in 0 %"):
        find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.1)))


def test_what_is_seen_somewhere_else_each_time_is_no_actuator() -> None:
    anywhere = arms() + np.random.default_rng(2).uniform(-200, 200, (30, 1, 2))
    with pytest.raises(
        VideoError, match=r"expected an actuator that is held at one end, got one there in \d+ %"
    ):
        find_actuator(probe_frames(30), HEADER, Oracle(anywhere, np.full((30, 4), 0.6)))


def test_glimpses_that_disagree_with_the_others_do_not_count() -> None:
    xy = arms()
    xy[::5] += 150.0  # clearly seen, and elsewhere: a shadow taken for the body
    seen = find_actuator(probe_frames(30), HEADER, Oracle(xy, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(seen.estimator.fixed_xy, (300, 200), atol=3)
    assert seen.seen == pytest.approx(0.8)
    region = seen.metadata.region_for(SIZE_WH)
    assert region.left + region.width < xy[::5, :, 0].max()


def test_ends_that_change_their_length_are_not_those_of_one_actuator() -> None:
    xy = arms()
    xy[:13, 3] = xy[:13, 2] + 2.5 * (xy[:13, 3] - xy[:13, 2])
    with pytest.raises(
        VideoError, match="expected an actuator that keeps its shape, got one that does in 57 %"
    ):
        find_actuator(probe_frames(30), HEADER, Oracle(xy, np.full((30, 4), 0.6)))


def test_nothing_is_believed_of_a_frame_with_another_shape() -> None:
    truth = arms()
    seen = find_actuator(probe_frames(30), HEADER, Oracle(truth, np.full((30, 4), 0.6)))
    assert seen.end_px == pytest.approx(30, abs=2)
    strange = truth[[5, 6, 7, 8]].copy()
    strange[1, 3] = strange[1, 2]  # both points of the tip at one place
    strange[2] += 60  # not where it is held
    strange[3, 2:] += (
        60 * (truth[8, 3] - truth[8, 0]) / np.linalg.norm(truth[8, 3] - truth[8, 0])
    )  # out of reach
    found = seen.believed(Detections(strange, np.full((4, 4), 0.9), np.zeros((4, 4, 2, 2))))
    assert found.likelihood.min(axis=1).tolist() == [0.9, 0.0, 0.0, 0.0]


def test_the_fixed_end_is_where_it_rests_whatever_one_frame_says() -> None:
    truth = arms()
    seen = find_actuator(probe_frames(30), HEADER, Oracle(truth, np.full((30, 4), 0.6), noise_px=2.0))
    once = truth[:1] + np.array([0.0, 6.0])
    found = seen.believed(Detections(once, np.full((1, 4), 0.9), np.zeros((1, 4, 2, 2))))
    np.testing.assert_allclose(found.xy[0, :2], truth[0, :2], atol=1.5)
    np.testing.assert_array_equal(found.xy[0, 2:], once[0, 2:])


def test_along_the_body_two_networks_may_say_different_places() -> None:
    """Between its ends nothing shows where on the midline a keypoint lies; at the ends, and across, it does."""
    finder = find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.6))).finder
    straight, region = body(0)[None], HEADER.regions[0]
    along, across = (straight + np.array(step) for step in ((20.0, 0.0), (0.0, 20.0)))
    one, other = (finder.apart(moved, straight, region, HEADER.reference)[0] for moved in (along, across))
    np.testing.assert_allclose(one, [20, 10, 10, 20])
    np.testing.assert_allclose(other, 20)
    np.testing.assert_allclose(
        CoarseToFineEstimator.apart(finder, along, straight, region, HEADER.reference), 20
    )


def test_a_video_has_usual_peaks_of_its_own() -> None:
    """What its glimpses agree about is there, however dimly this body shows it; but not as dimly as one likes."""
    peak = np.full((30, 4), 0.6)

    class Dim(Oracle):
        def refined(self, frames, xy, region, reference):
            found = super().refine(frames, xy, region, reference)
            return Detections(found.xy, np.tile([0.9, 0.6, 0.4, 0.1], (len(xy), 1)), found.covariance)

    seen = find_actuator(probe_frames(30), HEADER, Dim(arms(), peak))
    np.testing.assert_allclose(seen.metadata.calibration.normalising_peak, [0.6, 0.6, 0.4, 0.3])


def drawn(truth: np.ndarray) -> np.ndarray:
    """Glimpses in which both ends of chains are bright bars along their two points, numbered as `glimpses` are."""
    pictures = probe_frames(len(truth)) + np.uint8(90)
    for picture, chain in zip(pictures, truth, strict=True):
        for one, other in (chain[:2], chain[2:]):
            along = (other - one) / np.linalg.norm(other - one)
            across = 8 * along[::-1] * (-1, 1)
            corners = [one - 6 * along - across, one - 6 * along + across]
            corners += [other + 6 * along + across, other + 6 * along - across]
            cv2.fillPoly(
                picture, [np.rint(np.array(corners) * 16).astype(int)], (210, 200, 190), cv2.LINE_AA, 4
            )
    pictures[:, 0, 0, 0] = np.arange(len(truth))
    return pictures


def test_ends_are_turned_as_their_sides_say() -> None:
    """A network that turns the moving end by 3 degrees and the fixed one by 2, in all frames, is put right."""
    truth = arms()
    told = truth.copy()
    for chain in told:
        for end, turn_deg in ((chain[:2], -2.0), (chain[2:], 3.0)):
            turn = np.radians(turn_deg)
            middle = end.mean(axis=0)
            end[:] = middle + (end - middle) @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    seen = find_actuator(drawn(truth), HEADER, Oracle(told, np.full((30, 4), 0.6), noise_px=0.0))
    found = seen.believed(Detections(told, np.full((30, 4), 0.9), np.zeros((30, 4, 2, 2))))
    for end in (slice(0, 2), slice(2, 4)):
        direction, true = (np.diff(xy[:, end], axis=1)[:, 0] for xy in (found.xy, truth))
        across = true[:, 0] * direction[:, 1] - true[:, 1] * direction[:, 0]
        off_deg = np.degrees(np.arctan2(across, (true * direction).sum(axis=1)))
        assert np.abs(off_deg).max() < 0.7
        np.testing.assert_allclose(found.xy[:, end].mean(axis=1), told[:, end].mean(axis=1), atol=1e-6)


def test_a_network_that_learnt_from_labels_is_left_to_them() -> None:
    """They may point another way than the sides; and an end seen closer was learnt from them too."""
    learnt = replace(HEADER, training={})
    truth = arms()
    told = truth.copy()
    told[:, 3] += 2.0

    def closer(probe_frames, xy, same, region):
        raise AssertionError

    seen = find_actuator(drawn(truth), learnt, Oracle(told, np.full((30, 4), 0.6), noise_px=0.0), closer)
    assert seen.turn_rad == 0
    np.testing.assert_allclose(seen.fixed.xy[0], truth[0, :2], atol=1e-6)


def test_a_body_of_four_points_is_as_long_as_it_is() -> None:
    """Its long middle is no keypoint taken for something far away."""
    far = arms()
    far[:, 2:] += 1.5 * (far[:, 2:3] - far[:, 1:2])
    seen = find_actuator(probe_frames(30), replace(HEADER, training={}), Oracle(far, np.full((30, 4), 0.6)))
    assert seen.seen == 1.0


def test_sides_are_told_from_where_a_closer_look_finds_the_moving_end() -> None:
    truth = arms()

    def closer(probe_frames, xy, same, region):
        turn = np.radians(4.0)
        turned = xy.copy()
        middle = xy[:, 2:].mean(axis=1, keepdims=True)
        turned[:, 2:] = middle + (xy[:, 2:] - middle) @ [
            [np.cos(turn), np.sin(turn)],
            [-np.sin(turn), np.cos(turn)],
        ]
        return turned, None

    finder = Oracle(truth, np.full((30, 4), 0.6), noise_px=0.0)
    assert np.degrees(find_actuator(drawn(truth), HEADER, finder).turn_rad) == pytest.approx(0, abs=0.4)
    seen = find_actuator(drawn(truth), HEADER, finder, closer)
    assert np.degrees(seen.turn_rad) == pytest.approx(-4, abs=0.8)


def test_what_looks_closer_says_where_the_moving_end_is_and_looks_on() -> None:
    """In the glimpses that count; it is asked after the ends were found, and put to work in all frames."""
    truth = arms()
    asked: list[np.ndarray] = []

    class Raising:
        """An aligner by which the second end lies 4 px of its picture lower than it is found."""

        ends = ((2, 3),)

        def __call__(self, pictures):
            return np.tile([0.0, 4.0, 0.0], (len(pictures), 1, 1))

    def closer(probe_frames, xy, same, region):
        asked.append(same)
        longer = xy.copy()
        longer[:, 3] += 0.5 * (xy[:, 3] - xy[:, 2])
        return longer, Raising()

    xy = truth.copy()
    xy[::6] += 150.0
    seen = find_actuator(probe_frames(30), HEADER, Oracle(xy, np.full((30, 4), 0.6)), closer)
    assert asked[0].tolist() == [i % 6 != 0 for i in range(30)]
    assert seen.estimator.align.ends == ((2, 3),)

    reads: list[int] = []

    def refine(pictures):
        """Finds every keypoint in the middle of its patch, the less likely the more pictures were read before."""
        reads.append(len(pictures))
        n, middle = len(pictures), (pictures.shape[-1] - 1) / 2
        return Detections(np.full((n, 4, 2), middle), np.full((n, 4), 0.9), np.tile(np.eye(2), (n, 4, 1, 1)))

    region, frame = HEADER.regions[0], np.zeros((1, 480, 640, 3), np.uint8)
    found = replace(seen.estimator, refine=refine).refine(frame, truth[:1], region, HEADER.reference)
    # Once, and from two sides: both ends, though the moving one is seen closer too.
    assert sum(reads) == 4 + 8
    np.testing.assert_allclose(found.xy[0, :2], truth[0, :2], atol=0.1)
    np.testing.assert_allclose(found.xy[0, 2:], truth[0, 2:] + [0, 2], atol=0.1)


def test_the_moving_end_keeps_about_its_length() -> None:
    """A frame in which its two points lie further apart is searched again, and not believed."""
    seen = find_actuator(probe_frames(30), HEADER, Oracle(arms(), np.full((30, 4), 0.6), noise_px=0.0))
    region = seen.metadata.region_for(SIZE_WH)
    stretched = body(30)[None].repeat(3, axis=0)
    for chain, length in zip(stretched, (20.0, 50.0, 70.0), strict=True):
        chain[3] = chain[2] + length / 30 * (chain[3] - chain[2])
    assert seen.metadata.fits(stretched, region).tolist() == [
        [True] * 4,
        [True] * 4,
        [True, True, False, False],
    ]


def lost_in_every_third() -> tuple[np.ndarray, np.ndarray]:
    """Positions (30, 4, 2) and peaks (30, 4): in every third frame the tip is hardly seen, and somewhere else."""
    xy, peak = arms(), np.full((30, 4), 0.6)
    xy[::3, 3] -= 150.0
    peak[::3, 2:] = 0.1
    return xy, peak


@pytest.fixture
def in_frames(monkeypatch: pytest.MonkeyPatch):
    """Sights with an oracle that finds the same in frames once it is known where the actuator is held."""

    def sighted(oracle: Oracle, taught=None, header: CheckpointMetadata = HEADER):
        monkeypatch.setattr(BaseAnchoredEstimator, "detect", lambda _, *asked: oracle.detect(*asked))
        return find_actuator(probe_frames(30), header, oracle, taught=taught)

    return sighted


def test_a_network_that_is_not_sure_everywhere_learns_from_where_it_is_and_looks_again(in_frames) -> None:
    unsure = Oracle(*lost_in_every_third(), noise_px=0.0)
    asked: list[PseudoLabels] = []

    def taught(probe_frames, examples, region):
        asked.append(examples)
        return Oracle(arms(), np.full((30, 4), 0.6), noise_px=0.0)

    assert in_frames(unsure).seen == pytest.approx(2 / 3)
    assert in_frames(unsure, taught).seen == 1.0
    (examples,) = asked
    np.testing.assert_array_equal(examples.right, np.arange(30) % 3 > 0)
    np.testing.assert_array_equal(examples.wrong, np.tile(np.arange(30)[:, None] % 3 == 0, 2))
    np.testing.assert_allclose(examples.xy[examples.right], arms()[examples.right], atol=1e-6)


def test_too_few_of_one_shape_are_refused_and_not_learnt(in_frames) -> None:
    """Half of the glimpses show another shape: what the others show may be something else too."""

    def taught(probe_frames, examples, region):
        raise AssertionError

    with pytest.raises(VideoError, match="keeps its shape"):
        in_frames(half_of_another_shape(), taught)


def half_of_another_shape() -> Oracle:
    xy = arms()
    xy[::2, 3] += 3 * (xy[::2, 3] - xy[::2, 2])
    return Oracle(xy, np.full((30, 4), 0.6), noise_px=0.0)


@pytest.mark.parametrize("worse", [None, half_of_another_shape(), Oracle(arms(), np.zeros((30, 4)))])
def test_what_was_learnt_and_shows_less_than_before_is_forgotten(in_frames, worse: Oracle | None) -> None:
    unsure = Oracle(*lost_in_every_third(), noise_px=0.0)
    seen = in_frames(unsure, lambda *_: worse)
    assert seen.seen == pytest.approx(2 / 3)
    assert seen.estimator.locate is unsure


def test_of_what_is_hidden_nothing_is_learnt_and_a_tip_is_no_worse_for_a_hidden_base(in_frames) -> None:
    asked: list[PseudoLabels] = []

    def taught(probe_frames, examples, region):
        asked.append(examples)

    xy, peak = lost_in_every_third()
    peak[1::3, 0] = 0.2
    in_frames(Oracle(xy, peak, noise_px=0.0), taught)
    (examples,) = asked
    assert examples.right[1::3].all()
    np.testing.assert_array_equal(np.isnan(examples.xy[:, 0, 0]), np.arange(30) % 3 == 1)
    assert not np.isnan(examples.xy[:, 2:]).any()
    assert not examples.wrong[1::3].any()


def test_what_is_sure_everywhere_or_hardly_anywhere_or_learnt_from_labels_is_not_taught(in_frames) -> None:
    def taught(probe_frames, examples, region):
        raise AssertionError

    in_frames(Oracle(arms(), np.full((30, 4), 0.6)), taught)
    few = np.full((30, 4), 0.6)
    few[:23, 3] = 0.1
    in_frames(Oracle(arms(), few), taught)
    in_frames(Oracle(*lost_in_every_third()), taught, replace(HEADER, training={}))


def test_a_moving_end_that_both_networks_see_in_other_places_is_taken_for_something_else(in_frames) -> None:
    asked: list[PseudoLabels] = []

    class Torn(Oracle):
        def refined(self, frames, xy, region, reference):
            found = super().refine(frames, xy, region, reference)
            off = np.array([int(frame[0, 0, 0]) < 10 for frame in frames]) * 40.0 / region.refiner_scale
            found.xy[:, 3, 1] += off
            return found

    def taught(probe_frames, examples, region):
        asked.append(examples)
        return Oracle(arms(), np.full((30, 4), 0.6))

    in_frames(Torn(arms(), np.full((30, 4), 0.6), noise_px=0.0), taught)
    first = np.arange(30) < 10
    np.testing.assert_array_equal(asked[0].right, ~first)
    np.testing.assert_array_equal(asked[0].wrong, np.stack([np.zeros(30, bool), first], axis=1))


def test_ends_seen_closer_are_surer_across_than_the_network_says(in_frames) -> None:
    """It knows neither a closer look nor sides; where there is none, or labels taught it, what it says is left."""
    truth = arms()
    wide = Detections(truth, np.full((30, 4), 0.9), np.tile(4.0 * np.eye(2), (30, 4, 1, 1)))
    oracle = Oracle(truth, np.full((30, 4), 0.6), noise_px=0.0)

    class Aligned:
        ends = ((2, 3),)

        def __call__(self, pictures):
            return np.zeros((len(pictures), 1, 3))

    learnt = replace(HEADER, training={})
    for header, align, share in (
        (HEADER, Aligned(), ACROSS_SHARE),
        (HEADER, None, 1),
        (learnt, Aligned(), 1),
    ):
        seen = find_actuator(
            drawn(truth), header, oracle, lambda g, xy, s, r, end_regressor=align: (xy, align)
        )
        found = seen.believed(wide)
        along = np.diff(found.xy[:, 2:], axis=1)[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = along[:, ::-1] * (-1, 1)
        for direction, variance in ((along, 4.0), (across, 4.0 * share**2)):
            for k in (2, 3):
                own = np.einsum("ni,nij,nj->n", direction, found.covariance[:, k], direction)
                np.testing.assert_allclose(own, variance, rtol=1e-6)
