"""Zero-shot localisation with stand-in networks: fixed end, region of interest, inliers, pseudo-labels, corrections."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from bendtrack.models.inference.calibration import Calibration
from bendtrack.models.inference.coarse_to_fine import CoarseToFineEstimator
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.inference.stages import StageSettings
from bendtrack.models.localization.base_anchor import BaseAnchoredEstimator
from bendtrack.models.localization.chain_assembly import assemble_chain
from bendtrack.models.localization.localize import ACROSS_SD_SHARE, find_actuator
from bendtrack.models.localization.probe_frames import PseudoLabels, from_fixed_end
from bendtrack.tracker.angle import AngleDefinition, bending_angle
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.types import Detections

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (640, 480)
METADATA = CheckpointMetadata(
    backbone="resnet18",
    keypoints=KEYPOINTS,
    definition=AngleDefinition("two-vector", KEYPOINTS),
    regions=(RegionOfInterest((256, 256), 0, 0, 256, 256, 0.5, 1.0),),
    reference=(1, 0, 3, 2),
    calibration=Calibration(reference_peak=(0.6,) * 4),
    kind="pretrained",
)


def body(angle_deg: float) -> np.ndarray:
    """Four points (4, 2) px of an arm fixed at (300, 200)."""
    turn = np.radians(angle_deg)
    base = np.array([[300.0, 200.0], [330.0, 200.0]])
    tip = base[1] + 80 * np.array([np.cos(turn / 2), np.sin(turn / 2)])
    return np.stack([*base, tip, tip + 30 * np.array([np.cos(turn), np.sin(turn)])])


class Oracle(CoarseToFineEstimator):
    """Proposes and refines given positions; frames are numbered by their first pixel."""

    def __init__(self, xy: np.ndarray, peak: np.ndarray, noise_px: float = 1.0) -> None:
        super().__init__(self, self)
        object.__setattr__(self, "xy", xy + np.random.default_rng(0).normal(0, noise_px, xy.shape))
        object.__setattr__(self, "peak", peak)

    def candidate_peaks(self, frames, region):
        chosen = [int(frame[0, 0, 0]) for frame in frames]
        return self.xy[chosen].copy()[:, :, None], self.peak[chosen].copy()[:, :, None]

    def refine(self, frames, expected, geometry, wanted=None):
        n, k = expected.shape[:2]
        return Detections(expected.copy(), np.ones((n, k)), np.zeros((n, k, 2, 2)))


def probe_frames(n: int) -> np.ndarray:
    images = np.zeros((n, SIZE_WH[1], SIZE_WH[0], 3), np.uint8)
    images[:, 0, 0, 0] = np.arange(n)
    return images


def arms(sign: float = 1.0) -> np.ndarray:
    return np.stack([body(sign * angle) for angle in np.linspace(0, 120, 30)])


def test_the_static_end_is_the_fixed_end() -> None:
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6)))
    assert actuator.metadata.definition.sign == 1
    np.testing.assert_allclose(actuator.estimator.fixed_xy, (300, 200), atol=3)
    assert actuator.inlier_share == 1.0


@pytest.mark.parametrize("reversed_share", [0.3, 0.7, 1.0])
def test_reversed_chains_do_not_change_the_fixed_end(reversed_share: float) -> None:
    """Neither the fixed end nor later detections depend on which end the network took for the fixed one."""
    truth = arms(-1)
    is_reversed = np.random.default_rng(1).random(30) < reversed_share
    xy = np.where(is_reversed[:, None, None], truth[:, ::-1], truth)
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(xy, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(actuator.estimator.fixed_xy, (300, 200), atol=3)
    found, _ = from_fixed_end(xy, np.ones((30, 4)), actuator.estimator.fixed_xy)
    np.testing.assert_array_equal(found, truth)
    # The sign is positive in the direction in which the actuator bends, whichever that is in the image.
    angle_deg, _, _ = bending_angle(truth, KEYPOINTS, actuator.metadata.definition)
    np.testing.assert_allclose(angle_deg, np.linspace(0, 120, 30), atol=1e-6)


def test_a_candidate_that_fits_the_chain_wins_over_a_higher_peak() -> None:
    truth = arms()

    class Attracted(Oracle):
        """Puts the moving end at the clamp in a third of the frames; its second candidate is right."""

        def candidate_peaks(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            wrong = xy.copy()
            wrong[::3, 2:] = xy[::3, :2]
            return np.concatenate([wrong, xy], axis=2), np.concatenate([peak, 0.5 * peak], axis=2)

    estimator = Attracted(truth, np.full((30, 4), 0.6), noise_px=0.0)
    actuator = find_actuator(probe_frames(30), METADATA, estimator)
    assert actuator.inlier_share == 1.0
    candidates, peak = estimator.candidate_peaks(probe_frames(30), METADATA.regions[0])
    found, _ = assemble_chain(candidates, peak, actuator.estimator.fixed_xy, actuator.estimator.body_px)
    np.testing.assert_array_equal(found, truth)


def test_a_static_actuator_keeps_the_ends_that_the_network_predicts() -> None:
    still = np.repeat(body(40)[None], 30, axis=0)
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(still, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(actuator.estimator.fixed_xy, still[0, 0], atol=3)


def test_the_region_of_interest_holds_every_clearly_seen_pose() -> None:
    xy, peak = arms(), np.full((30, 4), 0.6)
    xy[::3], peak[::3] = 20.0, 0.05  # a hand in the way: wrong positions, low peaks
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(xy, peak))
    region = actuator.metadata.region_for(SIZE_WH)
    points = xy[1::3].reshape(-1, 2)
    corner = region.left, region.top
    assert (points >= corner).all()
    assert (points <= np.add(corner, (region.width, region.height))).all()
    assert region.left > 100
    assert actuator.inlier_share == pytest.approx(2 / 3)


def test_a_distant_false_keypoint_does_not_make_the_body_longer() -> None:
    """Nor do the networks see the actuator at a smaller scale."""
    between = np.array([0.25, 0.5, 0.75])

    class Distracted(Oracle):
        """Takes a tool for the middle of the body, in most of the frames that it sees whole."""

        def candidate_peaks(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            middle = xy[:, 1:2] + between[:, None, None] * (xy[:, 2:3] - xy[:, 1:2])
            xy = np.concatenate([xy[:, :2], middle, xy[:, 2:]], axis=1)
            peak = np.full(xy.shape[:3], peak[0, 0, 0])
            if region.width == SIZE_WH[0]:
                xy[: 3 * len(xy) // 4, 3] = 40.0
            elif 140 * region.locator_scale < 40:
                # At this small scale its predictions are random.
                xy += np.random.default_rng(3).uniform(-200, 200, (len(xy), 1, 1, 2))
            return xy, peak

    keypoints = (*KEYPOINTS[:2], "mid_1", "mid_2", "mid_3", *KEYPOINTS[2:])
    metadata = replace(
        METADATA,
        keypoints=keypoints,
        reference=(1, 0, 3, 2, 3, 6, 5),
        calibration=Calibration(reference_peak=(0.6,) * 7),
    )
    actuator = find_actuator(probe_frames(30), metadata, Distracted(arms(), np.full((30, 4), 0.6)))
    usual = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6)))
    regions = [own.metadata.region_for(SIZE_WH) for own in (actuator, usual)]
    for scale in ("locator_scale", "refiner_scale"):
        one, other = (getattr(region, scale) for region in regions)
        assert one == pytest.approx(other, rel=0.15)


@pytest.mark.parametrize(("sharp_from_px", "scale_share"), [(0, 1.0), (90, 1.5), (1000, 1.0)])
def test_the_larger_locator_input_is_used_where_it_shows_more(sharp_from_px: int, scale_share: float) -> None:
    class ShortSighted(Oracle):
        """Predicts the fixed end next to the clamp in two frames of five, where the body is small."""

        def candidate_peaks(self, frames, region):
            xy, peak = super().candidate_peaks(frames, region)
            if region.width < SIZE_WH[0] and 140 * region.locator_scale < sharp_from_px:
                xy[::5, :2] += 40.0
                xy[1::5, :2] += 40.0
            return xy, peak

    estimator = ShortSighted(arms(), np.full((30, 4), 0.6))
    actuator = find_actuator(probe_frames(30), METADATA, estimator)
    usual = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6)))
    assert actuator.inlier_share == pytest.approx(0.6 if sharp_from_px == 1000 else 1.0)
    scales = [own.metadata.region_for(SIZE_WH).locator_scale for own in (actuator, usual)]
    assert scales[0] / scales[1] == pytest.approx(scale_share, rel=0.05)


def test_no_actuator_in_sight_is_a_video_error() -> None:
    with pytest.raises(VideoError, match=r"expected an actuator in sight, got one in 0 %"):
        find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.1)))


def test_detections_without_a_common_fixed_end_are_a_video_error() -> None:
    anywhere = arms() + np.random.default_rng(2).uniform(-200, 200, (30, 1, 2))
    with pytest.raises(
        VideoError, match=r"expected an actuator that is held at one end, got one there in \d+ %"
    ):
        find_actuator(probe_frames(30), METADATA, Oracle(anywhere, np.full((30, 4), 0.6)))


def test_outlier_probe_frames_do_not_count() -> None:
    xy = arms()
    xy[::5] += 150.0  # high peaks at wrong positions: a shadow taken for the body
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(xy, np.full((30, 4), 0.6)))
    np.testing.assert_allclose(actuator.estimator.fixed_xy, (300, 200), atol=3)
    assert actuator.inlier_share == pytest.approx(0.8)
    region = actuator.metadata.region_for(SIZE_WH)
    assert region.left + region.width < xy[::5, :, 0].max()


def test_moving_ends_that_change_their_length_are_a_video_error() -> None:
    xy = arms()
    xy[:13, 3] = xy[:13, 2] + 2.5 * (xy[:13, 3] - xy[:13, 2])
    with pytest.raises(
        VideoError, match="expected an actuator that keeps its shape, got one that does in 57 %"
    ):
        find_actuator(probe_frames(30), METADATA, Oracle(xy, np.full((30, 4), 0.6)))


def test_a_frame_with_another_shape_gets_likelihood_zero() -> None:
    truth = arms()
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(truth, np.full((30, 4), 0.6)))
    assert actuator.end_px == pytest.approx(30, abs=2)
    other_shapes = truth[[5, 6, 7, 8]].copy()
    other_shapes[1, 3] = other_shapes[1, 2]  # both points of the tip at one position
    other_shapes[2] += 60  # not at the fixed end
    other_shapes[3, 2:] += (
        60 * (truth[8, 3] - truth[8, 0]) / np.linalg.norm(truth[8, 3] - truth[8, 0])
    )  # out of reach
    found = actuator.anchored(Detections(other_shapes, np.full((4, 4), 0.9), np.zeros((4, 4, 2, 2))))
    assert found.likelihood.min(axis=1).tolist() == [0.9, 0.0, 0.0, 0.0]


def test_the_fixed_end_is_its_median_over_probe_frames() -> None:
    truth = arms()
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(truth, np.full((30, 4), 0.6), noise_px=2.0))
    moved = truth[:1] + np.array([0.0, 6.0])
    found = actuator.anchored(Detections(moved, np.full((1, 4), 0.9), np.zeros((1, 4, 2, 2))))
    np.testing.assert_allclose(found.xy[0, :2], truth[0, :2], atol=1.5)
    np.testing.assert_array_equal(found.xy[0, 2:], moved[0, 2:])


def test_disagreement_along_the_body_counts_half() -> None:
    """Between the ends nothing shows where on the midline a keypoint lies; at the ends, and across, something does."""
    estimator = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6))).estimator
    straight, geometry = body(0)[None], METADATA.geometry_for((256, 256))
    along, across = (straight + np.array(step) for step in ((20.0, 0.0), (0.0, 20.0)))
    slid, lifted = (estimator.disagreement(moved, straight, geometry)[0] for moved in (along, across))
    np.testing.assert_allclose(slid, [20, 10, 10, 20])
    np.testing.assert_allclose(lifted, 20)
    np.testing.assert_allclose(CoarseToFineEstimator.disagreement(estimator, along, straight, geometry), 20)


def test_reference_peaks_are_estimated_from_the_video() -> None:
    """They are the inliers' median peaks, but no lower than half of pretraining's."""
    peak = np.full((30, 4), 0.6)

    class Dim(Oracle):
        def refine(self, frames, expected, geometry, wanted=None):
            found = super().refine(frames, expected, geometry, wanted)
            return Detections(found.xy, np.tile([0.9, 0.6, 0.4, 0.1], (len(expected), 1)), found.covariance)

    actuator = find_actuator(probe_frames(30), METADATA, Dim(arms(), peak))
    np.testing.assert_allclose(actuator.metadata.calibration.normalising_peak, [0.6, 0.6, 0.4, 0.3])


def drawn(truth: np.ndarray) -> np.ndarray:
    """Frames in which both ends of chains are bright bars along their two points, numbered as in `probe_frames`."""
    images = probe_frames(len(truth)) + np.uint8(90)
    for image, chain in zip(images, truth, strict=True):
        for one, other in (chain[:2], chain[2:]):
            along = (other - one) / np.linalg.norm(other - one)
            across = 8 * along[::-1] * (-1, 1)
            corners = [one - 6 * along - across, one - 6 * along + across]
            corners += [other + 6 * along + across, other + 6 * along - across]
            cv2.fillPoly(
                image, [np.rint(np.array(corners) * 16).astype(int)], (210, 200, 190), cv2.LINE_AA, 4
            )
    images[:, 0, 0, 0] = np.arange(len(truth))
    return images


def test_the_direction_of_both_ends_is_corrected_from_their_edges() -> None:
    """A network turns the moving end by 3 degrees and the fixed end by -2 in all frames."""
    truth = arms()
    predicted = truth.copy()
    for chain in predicted:
        for end, turn_deg in ((chain[:2], -2.0), (chain[2:], 3.0)):
            turn = np.radians(turn_deg)
            middle = end.mean(axis=0)
            end[:] = middle + (end - middle) @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    actuator = find_actuator(drawn(truth), METADATA, Oracle(predicted, np.full((30, 4), 0.6), noise_px=0.0))
    found = actuator.anchored(Detections(predicted, np.full((30, 4), 0.9), np.zeros((30, 4, 2, 2))))
    for end in (slice(0, 2), slice(2, 4)):
        direction, true = (np.diff(xy[:, end], axis=1)[:, 0] for xy in (found.xy, truth))
        across = true[:, 0] * direction[:, 1] - true[:, 1] * direction[:, 0]
        off_deg = np.degrees(np.arctan2(across, (true * direction).sum(axis=1)))
        assert np.abs(off_deg).max() < 0.7
        np.testing.assert_allclose(found.xy[:, end].mean(axis=1), predicted[:, end].mean(axis=1), atol=1e-6)


def test_stage_edge_orientation() -> None:
    """The ends' direction is not corrected where the stage is off."""
    truth = arms()
    predicted = truth.copy()
    predicted[:, 3] += 2.0
    on = Oracle(predicted, np.full((30, 4), 0.6), noise_px=0.0)
    off = Oracle(predicted, np.full((30, 4), 0.6), noise_px=0.0)
    object.__setattr__(off, "stages", StageSettings(edge_orientation=False))
    corrected, uncorrected = (find_actuator(drawn(truth), METADATA, own) for own in (on, off))
    assert corrected.turn_rad != 0
    assert uncorrected.turn_rad == 0
    np.testing.assert_allclose(uncorrected.fixed.xy[0], truth[0, :2], atol=1e-6)
    assert uncorrected.estimator.stages == off.stages


def test_anchoring_writes_into_no_detections_that_it_is_given() -> None:
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6)))
    arrays = arms(), np.full((30, 4), 0.9), np.zeros((30, 4, 2, 2))
    for array in (*arrays, actuator.fixed.xy, actuator.fixed.likelihood, actuator.fixed.covariance):
        array.setflags(write=False)
    found = actuator.anchored(Detections(*arrays))
    np.testing.assert_array_equal(arrays[0], arms())
    np.testing.assert_array_equal(found.xy[:, :2], np.broadcast_to(actuator.fixed.xy, (30, 2, 2)))


def test_a_network_trained_on_labels_is_not_corrected() -> None:
    """Labels say where ends lie and how they point: neither end regression nor edge orientation runs."""
    trained = replace(METADATA, kind="project")
    truth = arms()
    predicted = truth.copy()
    predicted[:, 3] += 2.0

    def fit_ends(probe_frames, xy, inlier, region):
        raise AssertionError

    actuator = find_actuator(
        drawn(truth), trained, Oracle(predicted, np.full((30, 4), 0.6), noise_px=0.0), fit_ends
    )
    assert actuator.turn_rad == 0
    np.testing.assert_allclose(actuator.fixed.xy[0], truth[0, :2], atol=1e-6)


def test_a_long_middle_step_of_a_short_chain_counts_in_full() -> None:
    """With few keypoints the longest step is the body's middle, not a false keypoint far away."""
    far = arms()
    far[:, 2:] += 1.5 * (far[:, 2:3] - far[:, 1:2])
    actuator = find_actuator(
        probe_frames(30), replace(METADATA, kind="project"), Oracle(far, np.full((30, 4), 0.6))
    )
    assert actuator.inlier_share == 1.0


def test_edge_orientation_starts_from_the_registered_moving_end() -> None:
    truth = arms()

    def fit_ends(probe_frames, xy, inlier, region):
        turn = np.radians(4.0)
        turned = xy.copy()
        middle = xy[:, 2:].mean(axis=1, keepdims=True)
        turned[:, 2:] = middle + (xy[:, 2:] - middle) @ [
            [np.cos(turn), np.sin(turn)],
            [-np.sin(turn), np.cos(turn)],
        ]
        return turned, None

    estimator = Oracle(truth, np.full((30, 4), 0.6), noise_px=0.0)
    assert np.degrees(find_actuator(drawn(truth), METADATA, estimator).turn_rad) == pytest.approx(0, abs=0.4)
    actuator = find_actuator(drawn(truth), METADATA, estimator, fit_ends)
    assert np.degrees(actuator.turn_rad) == pytest.approx(-4, abs=0.8)


def test_fit_ends_gets_the_inliers_and_its_regressor_runs_in_all_frames() -> None:
    """It is called once the ends are found, and corrects the moving end only."""
    truth = arms()
    calls: list[np.ndarray] = []

    class ConstantRegressor:
        """An end regressor that moves the moving end by 4 px of its crop across its direction."""

        ends = ((2, 3),)

        def __call__(self, images):
            return np.tile([0.0, 4.0, 0.0], (len(images), 1, 1))

    def fit_ends(probe_frames, xy, inlier, region):
        calls.append(inlier)
        longer = xy.copy()
        longer[:, 3] += 0.5 * (xy[:, 3] - xy[:, 2])
        return longer, ConstantRegressor()

    xy = truth.copy()
    xy[::6] += 150.0
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(xy, np.full((30, 4), 0.6)), fit_ends)
    assert calls[0].tolist() == [i % 6 != 0 for i in range(30)]
    assert actuator.estimator.end_regressor.ends == ((2, 3),)

    predicted: list[int] = []

    def refiner(images):
        """Predicts every keypoint in the middle of its crop."""
        predicted.append(len(images))
        n, middle = len(images), (images.shape[-1] - 1) / 2
        return Detections(np.full((n, 4, 2), middle), np.full((n, 4), 0.9), np.tile(np.eye(2), (n, 4, 1, 1)))

    geometry, frame = METADATA.geometry_for((256, 256)), np.zeros((1, 480, 640, 3), np.uint8)
    found = replace(actuator.estimator, refiner=refiner).refine(frame, truth[:1], geometry)
    # One crop each; the moving end is regressed from one more.
    assert sum(predicted) == 4
    np.testing.assert_allclose(found.xy[0, :2], truth[0, :2], atol=0.1)
    np.testing.assert_allclose(found.xy[0, 2:], truth[0, 2:] + [0, 2], atol=0.1)


def test_plausible_lengths_of_the_moving_end_are_near_its_median() -> None:
    """A frame in which its two points lie further apart is searched again, or gets likelihood 0."""
    actuator = find_actuator(probe_frames(30), METADATA, Oracle(arms(), np.full((30, 4), 0.6), noise_px=0.0))
    geometry = actuator.metadata.geometry_for(SIZE_WH)
    stretched = body(30)[None].repeat(3, axis=0)
    for chain, length in zip(stretched, (20.0, 50.0, 70.0), strict=True):
        chain[3] = chain[2] + length / 30 * (chain[3] - chain[2])
    assert actuator.metadata.plausible_distances(stretched, geometry).tolist() == [
        [True] * 4,
        [True] * 4,
        [True, True, False, False],
    ]


def unsure_in_every_third() -> tuple[np.ndarray, np.ndarray]:
    """Positions (30, 4, 2) and peaks (30, 4): in every third frame the tip has a low peak at a wrong position."""
    xy, peak = arms(), np.full((30, 4), 0.6)
    xy[::3, 3] -= 150.0
    peak[::3, 2:] = 0.1
    return xy, peak


@pytest.fixture
def localize_with(monkeypatch: pytest.MonkeyPatch):
    """Localises with an oracle whose anchored estimator detects what the oracle does."""

    def localize(oracle: Oracle, fit_network=None, metadata: CheckpointMetadata = METADATA):
        monkeypatch.setattr(BaseAnchoredEstimator, "detect", lambda _, *args: oracle.detect(*args))
        return find_actuator(probe_frames(30), metadata, oracle, fit_network=fit_network)

    return localize


def test_an_unsure_network_is_self_trained_on_its_sure_frames(localize_with) -> None:
    unsure = Oracle(*unsure_in_every_third(), noise_px=0.0)
    calls: list[PseudoLabels] = []

    def fit_network(probe_frames, labels, region):
        calls.append(labels)
        return Oracle(arms(), np.full((30, 4), 0.6), noise_px=0.0)

    assert localize_with(unsure).inlier_share == pytest.approx(2 / 3)
    assert localize_with(unsure, fit_network).inlier_share == 1.0
    (labels,) = calls
    np.testing.assert_array_equal(labels.positive, np.arange(30) % 3 > 0)
    np.testing.assert_array_equal(labels.negative, np.tile(np.arange(30)[:, None] % 3 == 0, 2))
    np.testing.assert_allclose(labels.xy[labels.positive], arms()[labels.positive], atol=1e-6)


def test_too_few_inliers_are_a_video_error_without_self_training(localize_with) -> None:
    """Half of the probe frames show another shape: the others may show something else too."""

    def fit_network(probe_frames, labels, region):
        raise AssertionError

    with pytest.raises(VideoError, match="keeps its shape"):
        localize_with(two_shapes(), fit_network)


def two_shapes() -> Oracle:
    xy = arms()
    xy[::2, 3] += 3 * (xy[::2, 3] - xy[::2, 2])
    return Oracle(xy, np.full((30, 4), 0.6), noise_px=0.0)


@pytest.mark.parametrize("fitted", [None, two_shapes(), Oracle(arms(), np.zeros((30, 4)))])
def test_a_fitted_network_with_fewer_inliers_is_dropped(localize_with, fitted: Oracle | None) -> None:
    unsure = Oracle(*unsure_in_every_third(), noise_px=0.0)
    actuator = localize_with(unsure, lambda *_: fitted)
    assert actuator.inlier_share == pytest.approx(2 / 3)
    assert actuator.estimator.locator is unsure


def test_hidden_keypoints_get_no_pseudo_label_and_leave_the_moving_end_positive(localize_with) -> None:
    calls: list[PseudoLabels] = []

    def fit_network(probe_frames, labels, region):
        calls.append(labels)

    xy, peak = unsure_in_every_third()
    peak[1::3, 0] = 0.2
    localize_with(Oracle(xy, peak, noise_px=0.0), fit_network)
    (labels,) = calls
    assert labels.positive[1::3].all()
    np.testing.assert_array_equal(np.isnan(labels.xy[:, 0, 0]), np.arange(30) % 3 == 1)
    assert not np.isnan(labels.xy[:, 2:]).any()
    assert not labels.negative[1::3].any()


def test_no_self_training_where_all_or_few_frames_are_sure_or_labels_exist(localize_with) -> None:
    def fit_network(probe_frames, labels, region):
        raise AssertionError

    localize_with(Oracle(arms(), np.full((30, 4), 0.6)), fit_network)
    few = np.full((30, 4), 0.6)
    few[:23, 3] = 0.1
    localize_with(Oracle(arms(), few), fit_network)
    localize_with(Oracle(*unsure_in_every_third()), fit_network, replace(METADATA, kind="project"))


def test_a_moving_end_on_which_both_networks_disagree_is_a_negative(localize_with) -> None:
    calls: list[PseudoLabels] = []

    class Disagreeing(Oracle):
        def refine(self, frames, expected, geometry, wanted=None):
            found = super().refine(frames, expected, geometry, wanted)
            off = np.array([int(frame[0, 0, 0]) < 10 for frame in frames]) * 40.0 / geometry.crop_scale
            found.xy[:, 3, 1] += off
            return found

    def fit_network(probe_frames, labels, region):
        calls.append(labels)
        return Oracle(arms(), np.full((30, 4), 0.6))

    localize_with(Disagreeing(arms(), np.full((30, 4), 0.6), noise_px=0.0), fit_network)
    first = np.arange(30) < 10
    np.testing.assert_array_equal(calls[0].positive, ~first)
    np.testing.assert_array_equal(calls[0].negative, np.stack([np.zeros(30, bool), first], axis=1))


def test_end_regression_reduces_the_predicted_sd_across_the_end(localize_with) -> None:
    """Not without an end regressor, and not for a network trained on labels."""
    truth = arms()
    wide = Detections(truth, np.full((30, 4), 0.9), np.tile(4.0 * np.eye(2), (30, 4, 1, 1)))
    oracle = Oracle(truth, np.full((30, 4), 0.6), noise_px=0.0)

    class ZeroRegressor:
        ends = ((2, 3),)

        def __call__(self, images):
            return np.zeros((len(images), 1, 3))

    trained = replace(METADATA, kind="project")
    for metadata, regressor, share in (
        (METADATA, ZeroRegressor(), ACROSS_SD_SHARE),
        (METADATA, None, 1),
        (trained, ZeroRegressor(), 1),
    ):
        actuator = find_actuator(
            drawn(truth), metadata, oracle, lambda _, xy, *args, regressor=regressor: (xy, regressor)
        )
        found = actuator.anchored(wide)
        along = np.diff(found.xy[:, 2:], axis=1)[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = along[:, ::-1] * (-1, 1)
        for direction, variance in ((along, 4.0), (across, 4.0 * share**2)):
            for k in (2, 3):
                own = np.einsum("ni,nij,nj->n", direction, found.covariance[:, k], direction)
                np.testing.assert_allclose(own, variance, rtol=1e-6)


def yielding_arms(yield_deg: float) -> np.ndarray:
    """Arms (30, 4, 2) px whose clamp gives way as they bend, about a point 20 px behind the fixed end."""
    pivot, turn = np.array([280.0, 200.0]), np.radians(np.linspace(0, yield_deg, 30))
    rotation = np.stack([np.cos(turn), np.sin(turn), -np.sin(turn), np.cos(turn)], axis=1).reshape(-1, 2, 2)
    return pivot + (arms() - pivot) @ rotation


def measured_angles(truth: np.ndarray, stages: StageSettings, noise_px: float = 0.1) -> np.ndarray:
    """Angles (30,) degrees that an estimator with a little noise gives in a film of arms."""
    estimator = Oracle(truth, np.full((30, 4), 0.6), noise_px=noise_px)
    object.__setattr__(estimator, "stages", stages)
    actuator = find_actuator(drawn(truth), METADATA, estimator)
    found = Detections(estimator.xy, np.full((30, 4), 0.9), np.tile(0.1 * np.eye(2), (30, 4, 1, 1)))
    angle_deg, _, _ = bending_angle(actuator.anchored(found).xy, KEYPOINTS, actuator.metadata.definition)
    return np.asarray(angle_deg)


@pytest.mark.parametrize("yield_deg", [8.0, -8.0])
def test_stage_base_measurement(yield_deg: float) -> None:
    """A base that yields by 8 degrees is measured within 1.5 degrees in every frame; held, 3.5 are missing."""
    truth = yielding_arms(yield_deg)
    expected = np.linspace(0, 120, 30)
    measured, held = (
        np.abs(measured_angles(truth, StageSettings(base_measurement=runs)) - expected)
        for runs in (True, False)
    )
    assert measured.max() < 1.5
    assert np.sqrt(np.mean(measured**2)) < 0.7
    assert held.max() > 3.5


def test_a_held_base_is_measured_the_same_with_and_without_base_measurement() -> None:
    for noise_px in (0.0, 1.0):
        with_stage, without = (
            measured_angles(arms(), StageSettings(base_measurement=runs), noise_px) for runs in (True, False)
        )
        np.testing.assert_array_equal(with_stage, without)


def test_a_measured_base_keeps_its_own_likelihood_and_covariance() -> None:
    """A frame in which a hand hides the base says so; a held base would not."""
    truth = yielding_arms(8.0)
    actuator = find_actuator(drawn(truth), METADATA, Oracle(truth, np.full((30, 4), 0.6), noise_px=0.1))
    assert actuator.base is not None
    likelihood = np.full((30, 4), 0.9)
    likelihood[4, :2] = 0.1
    covariance = np.tile(np.eye(2), (30, 4, 1, 1)) * np.arange(1, 31)[:, None, None, None]
    found = actuator.anchored(Detections(truth, likelihood, covariance))
    np.testing.assert_array_equal(found.likelihood, likelihood)
    np.testing.assert_allclose(found.covariance, covariance)


def test_a_regressor_of_the_fixed_end_is_asked_for_where_it_yields_only() -> None:
    asked: list[dict[str, bool]] = []

    class Regressor:
        ends = ((0, 1), (2, 3))

        def __call__(self, images):
            return np.zeros((len(images), 2, 3))

    def fit_ends(probe_frames, xy, inlier, region, **moves):
        asked.append(moves)
        return xy, Regressor()

    for truth in (yielding_arms(8.0), arms()):
        oracle = Oracle(truth, np.full((30, 4), 0.6), noise_px=0.1)
        actuator = find_actuator(drawn(truth), METADATA, oracle, fit_ends)
        assert actuator.across_sd_share == ACROSS_SD_SHARE
        assert (actuator.base is None) == (len(asked) == 2)
        if actuator.base is not None:
            assert actuator.base.across_sd_share == ACROSS_SD_SHARE
    assert asked == [{"base_moves": True}, {}]


def test_pseudo_labels_of_a_base_that_yields_are_where_it_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Self-training on a base at its median would teach the network to hold it."""
    given: list[PseudoLabels] = []

    def fit_network(probe_frames, labels, region):
        given.append(labels)

    for truth in (yielding_arms(8.0), arms()):
        peak = np.full((30, 4), 0.6)
        peak[::4, 2:] = 0.3
        oracle = Oracle(truth, peak, noise_px=0.1)
        monkeypatch.setattr(BaseAnchoredEstimator, "detect", lambda _, *args, own=oracle: own.detect(*args))
        find_actuator(drawn(truth), METADATA, oracle, None, fit_network)
    turns_deg = [np.degrees(np.arctan2(*(labels.xy[:, 1] - labels.xy[:, 0]).T[::-1])) for labels in given]
    assert np.nanmax(turns_deg[0]) - np.nanmin(turns_deg[0]) > 7
    assert np.nanmax(turns_deg[1]) - np.nanmin(turns_deg[1]) < 0.01
