"""The coarse-to-fine estimator with predictors whose output is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from spots import (
    GEOMETRY,
    SIZE_WH,
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
    predicted_at,
)
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.metadata import CheckpointMetadata
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.tracker.types import Detections


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
    # Other keypoints stay; an end has one crop and one high-resolution crop.
    np.testing.assert_allclose(found.xy[:, 0], plain.xy[:, 0], atol=1e-9)
    assert regressed.refiner.shown == crops
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
    assert (estimator.refiner.shown, off.refiner.shown) == (3 + 3, 3)


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


def test_no_stage_writes_into_its_argument(metadata: CheckpointMetadata) -> None:
    truth = arms(np.array([20.0, 65.0]))
    frames = np.stack([frame_of(xy) for xy in truth])
    geometry = CropGeometry(RegionOfInterest(SIZE_WH, 100, 60, 100, 80, 0.5, 1.5), GEOMETRY.reference)
    estimator = CoarseToFineEstimator(
        ReadOnlyPredictor(),
        ReadOnlyPredictor(),
        end_regressor=ConstantRegressor(0.5, 0.5, 0.01),
    )
    expected, wanted = read_only(predicted_at(truth + 3.0)), np.ones((2, 3), bool)
    wanted[0, 0] = False
    for array in (frames, wanted):
        array.setflags(write=False)
    for stage in (estimator.crop_and_predict, estimator.regress_ends):
        changed = stage(frames, expected, geometry, wanted)
        assert not np.array_equal(changed.xy, expected.xy)
        np.testing.assert_array_equal(changed.xy[0, 0], expected.xy[0, 0])
    # Where no keypoint is wanted nothing is looked at, and the arguments may be returned as they are.
    assert estimator.refine(frames, expected, geometry, np.zeros((2, 3), bool)) is expected
    for given in (expected, expected.xy):
        estimator.refine(frames, given, geometry, wanted)
    proposed = read_only(estimator.propose(frames, geometry))
    found = read_only(estimator.detect(frames, geometry))
    estimator.check_agreement(proposed, found, geometry)
    metadata.calibrated(found, geometry)
