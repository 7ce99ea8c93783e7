"""The coarse-to-fine estimator: a locator proposes where keypoints are, a refiner sees a crop around each.

The stages, in order: propose, crop and predict (iterative refinement), regress ends, check that both networks agree.
Each takes detections and returns new ones. What follows for whole videos is in `tracking.py`, calibration in
`metadata.py`. Networks are plain functions of images here (`Predictor`, `EndRegressor`), so that torch
and compiled engines share every line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray, Frames, ImageArray, IntArray
from .affine import View, resize, stacked
from .crops import MAX_STEP_PX, MAX_STEP_RAD, CropGeometry, crop_end, move_ends
from .roi import RegionOfInterest
from .stages import ALL_STAGES, StageSettings

LOCATOR_MULTIPLE = 32
"""Sides of the locator's input are multiples of this: its four stages halve them five times."""

LOST_LIKELIHOOD = 0.15
"""A keypoint whose peak in the region of interest is lower is searched in the whole frame: a bend beyond the labelled
ones may carry the tip out of the region. Peaks of visible keypoints are 0.4 to 0.9."""

RECENTRE_CROP_PX = 3.0
MAX_ITERATIONS = 2
"""A keypoint found further from its crop's centre, in crop px, is cropped again, up to so many times in all."""

LOST_CROP_PX = 16.0
"""Where locator and refiner put a keypoint further apart than this, in crop px, it is not the learnt keypoint."""

MAX_INPUT_PX = 1 << 20
"""Input px per call of a network: the maps of its first layer take 64 bytes for each, so memory stays flat."""


class Predictor(Protocol):
    """A network as a function of images."""

    def __call__(self, images: ImageArray) -> Detections:
        """Predict every keypoint in images (N, 3, H, W) uint8 RGB; positions and covariances in px of the images."""


class EndRegressor(Protocol):
    """Estimates the pose of ends from high-resolution crops."""

    @property
    def ends(self) -> tuple[tuple[int, int], ...]:
        """The two keypoints of each of E ends."""

    def __call__(self, images: ImageArray) -> FloatArray:
        """Corrections (N, E, 3) for `crops.move_ends` from images (N, 3, END_SIDE, END_SIDE) uint8 RGB."""


@dataclass(frozen=True)
class CoarseToFineEstimator:
    """Locator and refiner together.

    Attributes
    ----------
    locator : Predictor
        Sees the region of interest at low resolution.
    refiner : Predictor
        Sees one crop per keypoint; crop i is asked for its own keypoint only.
    candidates : int
        Candidate peaks (top-M) that the locator returns for each keypoint, the likeliest first.
    end_regressor : EndRegressor or None
        Corrects the pose of moving ends; None where there is none.
    stages : StageSettings
        Which stages run.
    """

    locator: Predictor
    refiner: Predictor
    candidates: int = 1
    end_regressor: EndRegressor | None = None
    stages: StageSettings = ALL_STAGES

    def detect(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """Find the keypoints in frames of one size, each frame by itself.

        Parameters
        ----------
        frames : sequence of ndarray of uint8, shape (H, W, 3)
            RGB.
        geometry : CropGeometry
            For frames of this size (`CheckpointMetadata.geometry_for`).

        Returns
        -------
        Detections
            (N, K), not calibrated.
        """
        proposed = self.propose(frames, geometry)
        found = self.refine(frames, proposed.xy, geometry)
        return self.check_agreement(proposed, found, geometry)

    def propose(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """Stage 1: rough positions from the region of interest, or from the whole frame where that shows nothing.

        Returns
        -------
        Detections
            (N, K), with covariances of zero: the locator's are not used.
        """
        found = self._propose(frames, geometry)
        everywhere = geometry.whole_frame
        if not self.stages.whole_frame_search or geometry == everywhere:
            return found
        lost: BoolArray = found.likelihood < LOST_LIKELIHOOD
        xy, likelihood = found.xy.copy(), found.likelihood.copy()
        for i in np.flatnonzero(lost.any(axis=1)).tolist():
            elsewhere = self._propose(frames[i : i + 1], everywhere)
            better = (elsewhere.likelihood[0] > likelihood[i]) & lost[i]
            xy[i, better] = elsewhere.xy[0, better]
            likelihood[i, better] = elsewhere.likelihood[0, better]
        return replace(found, xy=xy, likelihood=likelihood)

    def candidate_peaks(self, frames: Frames, region: RegionOfInterest) -> tuple[FloatArray, FloatArray]:
        """Top-M candidate positions (N, K, M, 2) px of each keypoint in a region, and their peaks (N, K, M)."""
        view = region.locator_view(LOCATOR_MULTIPLE)
        predicted = _predict(self.locator, [_region_image(frame, region, view) for frame in frames])
        shape = (len(frames), -1, self.candidates)
        return view.to_source(predicted.xy).reshape(*shape, 2), predicted.likelihood.reshape(shape)

    def _propose(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """The likeliest candidate of each keypoint in the region of interest."""
        xy, likelihood = self.candidate_peaks(frames, geometry.region)
        return replace(predicted_at(xy[:, :, 0]), likelihood=likelihood[:, :, 0].copy())

    def refine(
        self,
        frames: Frames,
        expected: FloatArray | Detections,
        geometry: CropGeometry,
        wanted: BoolArray | None = None,
    ) -> Detections:
        """Stages 2 and 3: crop around the expected positions and predict, regress ends.

        Parameters
        ----------
        frames : sequence of ndarray of uint8, shape (H, W, 3)
        expected : ndarray of float, shape (N, K, 2), or Detections
            Where keypoints are expected, px; what is NaN stays NaN.
        geometry : CropGeometry
            For frames of this size.
        wanted : ndarray of bool, shape (N, K), optional
            Keypoints to look at; the others stay as they are. By default all that are expected somewhere.

        Returns
        -------
        Detections
            (N, K), not calibrated.
        """
        found = expected if isinstance(expected, Detections) else predicted_at(expected)
        if wanted is None:
            wanted = np.logical_not(np.isnan(found.xy).any(axis=2))
        if not wanted.any():
            return found
        found = self.crop_and_predict(frames, found, geometry, wanted)
        return self.regress_ends(frames, found, geometry, wanted)

    def crop_and_predict(
        self, frames: Frames, found: Detections, geometry: CropGeometry, wanted: BoolArray
    ) -> Detections:
        """Stage 2: predict each keypoint in a crop around it, and once more where it lay far from the centre."""
        rows, keypoints = np.nonzero(wanted)
        for _ in range(MAX_ITERATIONS if self.stages.iterative_refinement else 1):
            expected = found.xy[rows, keypoints]
            predicted = self._predict_crops(frames, found, rows, keypoints, geometry)
            found = _with_keypoints(found, rows, keypoints, predicted)
            off_px = np.linalg.norm(predicted.xy[:, 0] - expected, axis=1)
            far = off_px * geometry.crop_scale > RECENTRE_CROP_PX
            rows, keypoints = rows[far], keypoints[far]
            if not len(rows):
                break
        return found

    def regress_ends(
        self, frames: Frames, found: Detections, geometry: CropGeometry, wanted: BoolArray
    ) -> Detections:
        """Stage 3: correct the pose of moving ends by regression on a high-resolution crop.

        Supervised descent (Xiong & De la Torre 2013) with one step; the regression is fitted in
        `denoising/end_regression.py`. Ends are corrected where both their points are wanted.
        """
        if self.end_regressor is None or not self.stages.end_regression:
            return found
        xy = found.xy.copy()
        for number, end in enumerate(self.end_regressor.ends):
            rows = np.flatnonzero(wanted[:, end].all(axis=1))
            if not len(rows):
                continue
            ends = xy[rows[:, None], end]
            crops = [
                crop_end(frames[i], own, geometry.region).image
                for i, own in zip(rows.tolist(), ends, strict=True)
            ]
            steps = np.concatenate([self.end_regressor(part)[:, number] for part in _in_parts(crops)])
            near = (np.linalg.norm(steps[:, :2], axis=1) <= MAX_STEP_PX) & (
                np.abs(steps[:, 2]) <= MAX_STEP_RAD
            )
            xy[rows[near, None], end] = move_ends(ends[near], steps[near], geometry.crop_scale)
        return replace(found, xy=xy)

    def check_agreement(self, proposed: Detections, found: Detections, geometry: CropGeometry) -> Detections:
        """Stage 4: a keypoint must be seen by both networks, and in one place.

        A locator may guess through a hand; a crop may show something else that looks alike.
        """
        likelihood = np.minimum(proposed.likelihood, found.likelihood)
        if self.stages.agreement_check:
            near = self.disagreement(proposed.xy, found.xy, geometry) <= LOST_CROP_PX
            likelihood = np.where(near, likelihood, 0.0)
        return replace(found, likelihood=likelihood)

    def disagreement(self, proposed: FloatArray, refined: FloatArray, geometry: CropGeometry) -> FloatArray:
        """Distance (..., K) in crop px between both networks' positions (..., K, 2) px of the same keypoints."""
        distance: FloatArray = np.linalg.norm(refined - proposed, axis=-1) * geometry.crop_scale
        return distance

    def _predict_crops(
        self,
        frames: Frames,
        found: Detections,
        rows: IntArray,
        keypoints: IntArray,
        geometry: CropGeometry,
    ) -> Detections:
        """Predictions (M, 1), px of the frames, of M keypoints in crops around where they are."""
        poses = geometry.crop_poses(found.xy)[rows, keypoints]
        crops = [geometry.crop(frames[i], pose) for i, pose in zip(rows, poses, strict=True)]
        predicted = _predict(self.refiner, [crop.image for crop in crops])
        own = np.arange(len(crops))
        matrices = np.stack([crop.view.matrix for crop in crops])
        inverse = np.linalg.inv(matrices[:, :, :2])
        xy = np.einsum("nij,nj->ni", inverse, predicted.xy[own, keypoints] - matrices[:, :, 2])
        covariance = inverse @ predicted.covariance[own, keypoints] @ inverse.transpose(0, 2, 1)
        return Detections(xy[:, None], predicted.likelihood[own, keypoints, None], covariance[:, None])


def predicted_at(xy: FloatArray) -> Detections:
    """Positions (N, K, 2) px where keypoints are expected, with likelihoods and covariances of zero."""
    n, k = xy.shape[:2]
    return Detections(xy.copy(), np.zeros((n, k)), np.zeros((n, k, 2, 2)))


def concatenated(parts: Sequence[Detections]) -> Detections:
    """Detections of several batches as one."""
    return Detections(
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.likelihood for part in parts]),
        np.concatenate([part.covariance for part in parts]),
    )


def _with_keypoints(
    found: Detections, rows: IntArray, keypoints: IntArray, predicted: Detections
) -> Detections:
    """Detections (N, K) in which M keypoints are replaced by predictions (M, 1)."""
    xy, likelihood, covariance = found.xy.copy(), found.likelihood.copy(), found.covariance.copy()
    xy[rows, keypoints], likelihood[rows, keypoints] = predicted.xy[:, 0], predicted.likelihood[:, 0]
    covariance[rows, keypoints] = predicted.covariance[:, 0]
    return Detections(xy, likelihood, covariance)


def _predict(predictor: Predictor, images: Sequence[ImageArray]) -> Detections:
    """Predictions in images (H, W, 3) of one size."""
    parts = [predictor(part) for part in _in_parts(images)]
    return parts[0] if len(parts) == 1 else concatenated(parts)


def _in_parts(images: Sequence[ImageArray]) -> Iterator[ImageArray]:
    """Images (H, W, 3) of one size in the networks' order (N, 3, H, W), at most `MAX_INPUT_PX` at a time."""
    at_once = max(1, MAX_INPUT_PX // (images[0].shape[0] * images[0].shape[1]))
    for start in range(0, len(images), at_once):
        yield stacked(images[start : start + at_once])


def _region_image(frame: ImageArray, region: RegionOfInterest, view: View) -> ImageArray:
    """The frame through the region's view; reduced by areas, since a bilinear warp would skip pixels."""
    w, h = view.size_wh
    # So many px of the frame fill the input; the frame's border is repeated where they reach beyond it.
    right = min(frame.shape[1], region.left + int(np.ceil(w / region.locator_scale)) + 2)
    bottom = min(frame.shape[0], region.top + int(np.ceil(h / region.locator_scale)) + 2)
    small = resize(frame[region.top : bottom, region.left : right], region.locator_scale)[:h, :w]
    missing_h, missing_w = h - small.shape[0], w - small.shape[1]
    return np.pad(small, ((0, missing_h), (0, missing_w), (0, 0)), mode="edge")
