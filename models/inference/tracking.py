"""Keypoint tracking through the frames of one video: the past only says where crops are cut.

Constant-velocity prediction places the crops of the next frames, so the locator is rarely needed. What is found is what
the crops show, as in single frames. Where a crop does not show its keypoint, or shows it far from where it was
expected, the frame is searched as if it were the first, until both networks are sure again. Every `CHECK_EVERY` frames
the locator checks whether it sees the keypoints elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray, Frames, IntArray
from .coarse_to_fine import LOST_CROP_PX, CoarseToFineEstimator, concatenated, predicted_at
from .crops import CropGeometry
from .metadata import CheckpointMetadata
from .static_patch import StaticPatchTest

FRAMES_AHEAD = 2
"""Frames that are looked at together, at positions predicted from those before them."""

SURE_SHARE = 0.5
"""A peak lower than this share of the reference peak is not accepted without a search."""

SURPRISE_CROP_PX = 8.0
"""A keypoint found further from where it was expected, in crop px, moved in a way that tracking did not foresee, or is
something else that looks alike: the frame is searched. In an unbroken video nine of ten frames are within 2 px."""

CHECK_EVERY = 16
"""Frames after which the locator is asked whatever the crops show: a false track ends within half a second."""

REST_CROP_PX = 0.5
"""A keypoint that moved by less from one frame to the next, in crop px, may be at rest."""

REST_PREDICTIONS = 4
"""Predictions of a keypoint at rest that are averaged; after them it is not predicted again."""

SAME_POSE = 0.75
"""Largest difference, in units of crop poses, between a keypoint at rest and the pose it is compared at."""

Calibrate = Callable[[Detections, CropGeometry], Detections]


@dataclass(frozen=True)
class _AtRest:
    """A keypoint at rest: the crop that it is compared with, and the mean of what was predicted there so far."""

    pose: IntArray
    patch: StaticPatchTest
    predictions: int = 0
    xy: FloatArray = field(default_factory=lambda: np.zeros(2))
    likelihood: float = 0.0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))

    def including(self, xy: FloatArray, likelihood: float, covariance: FloatArray) -> _AtRest:
        """The same with one more prediction in the mean."""
        n = self.predictions + 1
        return replace(
            self,
            predictions=n,
            xy=self.xy + (xy - self.xy) / n,
            likelihood=self.likelihood + (likelihood - self.likelihood) / n,
            covariance=self.covariance + (covariance - self.covariance) / n,
        )


class KeypointTracker:
    """Finds the keypoints in the frames of one video, given in order.

    Parameters
    ----------
    estimator : CoarseToFineEstimator
        Finds keypoints in single frames.
    metadata : CheckpointMetadata
        Of its networks.
    calibrate : callable, optional
        From detections and the crop geometry to calibrated detections. Default: `metadata.calibrated`.
    """

    def __init__(
        self,
        estimator: CoarseToFineEstimator,
        metadata: CheckpointMetadata,
        calibrate: Calibrate | None = None,
    ) -> None:
        self._estimator = estimator
        self._metadata = metadata
        self._calibrate = calibrate or metadata.calibrated
        self._sure_peak = SURE_SHARE * metadata.calibration.normalising_peak
        self._last: FloatArray | None = None
        self._velocity = np.zeros((len(metadata.keypoints), 2))
        self._until_check = 0
        self._is_sure = False
        self._dropped_frames = 0
        self._at_rest: list[_AtRest | None] = [None] * len(metadata.keypoints)

    def skip_frames(self, frames: int) -> None:
        """Say that the next so many frames of the video are dropped: keypoints move on during them."""
        self._dropped_frames += frames

    def detect(self, frames: Frames) -> Detections:
        """Find the keypoints in the video's next frames.

        Parameters
        ----------
        frames : sequence of ndarray of uint8, shape (H, W, 3)
            RGB, all of one size.

        Returns
        -------
        Detections
            (N, K), calibrated.
        """
        h, w = frames[0].shape[:2]
        geometry = self._metadata.geometry_for((w, h))
        # The first frame says where to look in the others.
        begin = 1 if self._last is None else 0
        parts = [self._next(frames[:begin], geometry)] if begin else []
        parts += [
            self._next(frames[i : i + FRAMES_AHEAD], geometry)
            for i in range(begin, len(frames), FRAMES_AHEAD)
        ]
        found = self._backward_pass(frames, concatenated(parts), geometry)
        return self._calibrate(found, geometry)

    def _next(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """Track or search the next one or two frames, and update position and velocity."""
        if self._last is None or not self._is_sure:
            found = self._search(frames, geometry)
        else:
            ahead = self._dropped_frames + np.arange(1, len(frames) + 1)[:, None, None]
            found = self._track(frames, self._last + ahead * self._velocity, geometry)
            self._until_check -= len(frames)
            if self._until_check <= 0:
                found = self._check(frames, found, geometry)
        before, apart = (self._last, 1 + self._dropped_frames) if len(frames) == 1 else (found.xy[-2], 1)
        self._velocity = np.zeros_like(found.xy[-1]) if before is None else (found.xy[-1] - before) / apart
        self._last, self._dropped_frames = found.xy[-1], 0
        return found

    def _track(self, frames: Frames, expected: FloatArray, geometry: CropGeometry) -> Detections:
        """Find keypoints near expected positions (N, K, 2) px; frames in which that fails are searched."""
        found, wanted, new = self._reuse_static(frames, predicted_at(expected), geometry)
        # If one point of an end moves both are looked for: the end is regressed only as a whole.
        regressor = self._estimator.end_regressor
        for first, second in regressor.ends if regressor else ():
            wanted[:, first] = wanted[:, second] = wanted[:, first] | wanted[:, second]
        found = self._estimator.refine(frames, found, geometry, wanted)
        updated: dict[int, _AtRest] = {}
        for i, k, rest in new:
            # Two frames may add to one mean, the second to what the first made of it.
            mean = updated.get(id(rest), rest)
            mean = mean.including(found.xy[i, k], found.likelihood[i, k], found.covariance[i, k])
            updated[id(rest)] = self._at_rest[k] = mean
        lost = np.flatnonzero(~self._seen_near(expected, found, geometry).all(axis=1)).tolist()
        if not lost:
            return found
        return _with_frames(found, lost, self._search([frames[i] for i in lost], geometry))

    def _reuse_static(
        self, frames: Frames, expected: Detections, geometry: CropGeometry
    ) -> tuple[Detections, BoolArray, list[tuple[int, int, _AtRest]]]:
        """Take keypoints at rest from before, where their crops have not changed.

        Returns
        -------
        found : Detections
            (N, K): of keypoints at rest their mean so far, of the others where they are expected.
        wanted : ndarray of bool, shape (N, K)
            Keypoints that still have to be predicted.
        new : list of (frame, keypoint, _AtRest)
            Those that may be at rest and whose mean the next prediction belongs to.
        """
        xy, likelihood, covariance = (
            expected.xy.copy(),
            expected.likelihood.copy(),
            expected.covariance.copy(),
        )
        poses = geometry.crop_poses(expected.xy)
        wanted = np.ones(poses.shape[:2], bool)
        new: list[tuple[int, int, _AtRest]] = []
        moved_px = np.linalg.norm(self._velocity, axis=1) * geometry.crop_scale
        resting = np.flatnonzero(moved_px < REST_CROP_PX).tolist()
        if not self._estimator.stages.static_patches:
            resting = []
        for i, frame in enumerate(frames):
            for k in resting:
                rest = self._at_rest[k]
                # A keypoint at rest between two poses is compared at the one where it was seen first.
                here = rest is not None and np.abs(rest.pose - poses[i, k]).max() < SAME_POSE
                pose = rest.pose if rest and here else np.rint(poses[i, k]).astype(int)
                image = geometry.crop(frame, pose).image
                if not (rest and here and rest.patch.is_static(image)):
                    rest = _AtRest(pose, StaticPatchTest(image))
                if rest.predictions < REST_PREDICTIONS:
                    new.append((i, k, rest))
                else:
                    xy[i, k], likelihood[i, k], covariance[i, k] = rest.xy, rest.likelihood, rest.covariance
                    wanted[i, k] = False
        return Detections(xy, likelihood, covariance), wanted, new

    def _check(self, frames: Frames, found: Detections, geometry: CropGeometry) -> Detections:
        """What was found, unless both networks are sure of another place in the last frame."""
        self._until_check = CHECK_EVERY
        proposed = self._estimator.propose(frames[-1:], geometry)
        if not self._elsewhere(proposed.xy[0], found, geometry).any():
            return found
        searched = self._search(frames, geometry)
        if (self._elsewhere(searched.xy[-1], found, geometry) & self._seen(searched, geometry)[-1]).any():
            return searched
        self._is_sure = True
        return found

    def _elsewhere(self, xy: FloatArray, found: Detections, geometry: CropGeometry) -> BoolArray:
        """Which keypoints (K,) at positions (K, 2) px lie elsewhere than in the last frame of what was found."""
        return np.asarray(self._estimator.disagreement(xy, found.xy[-1], geometry) > LOST_CROP_PX)

    def _search(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """Find keypoints in frames as if they were the first ones."""
        self._until_check = CHECK_EVERY
        found = self._estimator.detect(frames, geometry)
        self._is_sure = bool(self._seen(found, geometry)[-1].all())
        return found

    def _backward_pass(self, frames: Frames, found: Detections, geometry: CropGeometry) -> Detections:
        """Search lost keypoints again from the frames after them.

        A tip that comes out from behind something is often found before the next one is; where it was a moment earlier
        is then known. As in the forward pass crops must show each keypoint; the locator, which was not sure in these
        frames, is not asked again.
        """
        if not self._estimator.stages.backward_pass:
            return found
        seen: BoolArray = np.asarray(self._seen(found, geometry).all(axis=1))
        for i in range(len(frames) - 2, -1, -1):
            if seen[i] or not seen[i + 1]:
                continue
            after = found.xy[i + 1]
            step = after - found.xy[i + 2] if i + 2 < len(frames) and seen[i + 2] else np.zeros_like(after)
            expected = (after + step)[None]
            again = self._estimator.refine(frames[i : i + 1], expected, geometry)
            if self._seen_near(expected, again, geometry).all():
                found, seen[i] = _with_frames(found, [i], again), True
        return found

    def _seen_near(self, expected: FloatArray, found: Detections, geometry: CropGeometry) -> BoolArray:
        """Which keypoints (N, K) are seen, and near where they were expected (N, K, 2) px."""
        off_px = np.linalg.norm(found.xy - expected, axis=2) * geometry.crop_scale
        return np.asarray(self._seen(found, geometry) & (off_px <= SURPRISE_CROP_PX))

    def _seen(self, found: Detections, geometry: CropGeometry) -> BoolArray:
        """Which keypoints (N, K) have a high enough peak and a plausible distance from their reference keypoints."""
        plausible = self._metadata.plausible_distances(found.xy, geometry)
        return np.asarray((found.likelihood >= self._sure_peak) & plausible)


def _with_frames(found: Detections, rows: Sequence[int], others: Detections) -> Detections:
    """Detections (N, K) in which some frames are replaced by others."""
    xy, likelihood, covariance = found.xy.copy(), found.likelihood.copy(), found.covariance.copy()
    xy[rows], likelihood[rows], covariance[rows] = others.xy, others.likelihood, others.covariance
    return Detections(xy, likelihood, covariance)
