"""How two trained networks find keypoints in frames: locate them in the working region, then look closely at each, and
at moving ends more closely still.

Knows networks only as functions of pictures (`Predictor`, `EndRegressor`), so torch and compiled engines share every line
of it. The networks themselves are in `cascade.py`, compiled ones in `compiled.py`, videos in `following.py`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray, Frames, ImageArray, IntArray
from .affine import View, resize, stacked
from .crops import FAR_PX, FAR_RAD, POSE_PX, Crop, crop_end, crop_patch, move_ends, places
from .roi import RegionOfInterest

LOCATOR_MULTIPLE = 32
"""The locator's input sides are multiples of this: its four stages halve them five times."""

COLLAPSE_LIKELIHOOD = 0.15
"""A keypoint whose peak in the working region is under this is sought in the whole frame: a bend beyond the labelled
ones may carry the tip out of the region. (Peaks of what is there are 0.4 to 0.9.)"""

ASIDE_PATCH_PX = 2.0
"""How far to the right of a keypoint and below it one of its two last patches is cut, and to the left and above the
other: less than patches are shifted in training."""

FAR_PATCH_PX = 3.0
MOST_SIGHTINGS = 2
"""Where a keypoint is found further than this from where it was thought to be, it is sought from there once more."""

AGREED_PATCH_PX = 8.0
"""Positions further apart are not of the same thing: the likelier is taken."""

LOST_PATCH_PX = 16.0
"""A keypoint that locator and refiner put further apart than this is not the one that was learnt."""

MAX_INPUT_PX = 1 << 20
"""Input px that go through a network at once: its first layer's maps take 64 bytes for each."""


class Predictor(Protocol):
    """A network as a function."""

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8 RGB, positions and covariances in their own px."""


class EndRegressor(Protocol):
    """What tells how ends lie in closer pictures of them.

    Attributes
    ----------
    ends : the two keypoints of each of E ends
    """

    ends: tuple[tuple[int, int], ...]

    def __call__(self, pictures: ImageArray) -> FloatArray:
        """Steps (N, E, 3), as `move_ends` takes them, that put each end right in pictures (N, 3, END_SIDE, END_SIDE)
        uint8 RGB."""


@dataclass(frozen=True)
class CoarseToFineEstimator:
    """Locator and refiner at work.

    Attributes
    ----------
    locate : reads the working region
    refine : reads patches; patch i of a frame is asked for keypoint i only
    peaks : places that `locate` offers for each keypoint, next to each other, the likeliest first
    align : tells how ends lie that look alike wherever they turn; None where there are none
    thorough : whether those ends are seen from two sides too, before that: where nobody has labelled anything, whether
        an end is seen at all is the question
    once : keypoints that are looked at from one side only, for nothing that is measured hangs on them
    """

    locate: Predictor
    refine: Predictor
    peaks: int = 1
    align: EndRegressor | None = None
    thorough: bool = False
    once: tuple[int, ...] = ()

    def detect(self, frames: Frames, region: RegionOfInterest, reference: Sequence[int]) -> Detections:
        """Find the keypoints in frames of one size, each by itself.

        Parameters
        ----------
        region : where to look, made for frames of this size (`CheckpointMetadata.region_for`)
        partner : from `regions.partners`
        """
        xy, likelihood = self.located(frames, region)
        found = self.refined(frames, xy, region, reference)
        # Both must have seen it, and in one place: a locator may guess through a hand, a patch show something else.
        together = self.apart(xy, found.xy, region, reference) <= LOST_PATCH_PX
        both = np.where(together, np.minimum(likelihood, found.likelihood), 0.0)
        return Detections(found.xy, both, found.covariance)

    def located(self, frames: Frames, region: RegionOfInterest) -> tuple[FloatArray, FloatArray]:
        """Rough positions (N, K, 2) px and likelihoods (N, K), from the working region or else the whole frame."""
        xy, likelihood = self._located(frames, region)
        everything = region.whole_frame()
        lost = np.flatnonzero(likelihood.min(axis=1) < COLLAPSE_LIKELIHOOD).tolist()
        for i in lost if region != everything else []:
            elsewhere, score = self._located(frames[i : i + 1], everything)
            better = (score[0] > likelihood[i]) & (likelihood[i] < COLLAPSE_LIKELIHOOD)
            xy[i, better], likelihood[i, better] = elsewhere[0, better], score[0, better]
        return xy, likelihood

    def apart(
        self, located: FloatArray, found: FloatArray, region: RegionOfInterest, reference: Sequence[int]
    ) -> FloatArray:
        """How far (..., K) patch px the two networks' positions (..., K, 2) px are from saying the same."""
        distance: FloatArray = np.linalg.norm(found - located, axis=-1) * region.refiner_scale
        return distance

    def refined(
        self, frames: Frames, xy: FloatArray, region: RegionOfInterest, reference: Sequence[int]
    ) -> Detections:
        """Look closely at each keypoint, near where it is thought to be, xy (N, K, 2) px; what is NaN stays NaN."""
        found = predicted_at(xy)
        self.settle(found, np.logical_not(np.isnan(xy).any(axis=2)), frames, region, reference)
        return found

    def settle(
        self,
        found: Detections,
        wanted: BoolArray,
        frames: Frames,
        region: RegionOfInterest,
        reference: Sequence[int],
    ) -> None:
        """Look where keypoints may be, then once more at what was found there.

        Ends are seen closer, and put where they look as in the labelled frames (`_aligned`). All others are seen from
        two sides, and the mean counts: where a keypoint lies in its patch shifts what is found there, partly the same
        way and partly by chance. So the one cancels and the other is halved; and who begins a little off ends at the
        same position.

        Parameters
        ----------
        found : where they may be, (N, K); what is found is written into it
        wanted : (N, K) bool, which are to be looked for
        """
        rows, keypoints = np.nonzero(wanted)
        if not len(rows):
            return
        for _ in range(MOST_SIGHTINGS):
            thought = found.xy[rows, keypoints]
            seen = self._look(found, rows, keypoints, 0.0, frames, region, reference)
            _put(found, rows, keypoints, seen)
            off_px = np.linalg.norm(seen.xy[:, 0] - thought, axis=1)
            far = off_px * region.refiner_scale > FAR_PATCH_PX
            rows, keypoints = rows[far], keypoints[far]
            if not len(rows):
                break
        left = wanted if self.thorough else wanted & ~self._aligned(found, wanted, frames, region)
        rows, keypoints = np.nonzero(left & ~np.isin(np.arange(left.shape[1]), self.once))
        if len(rows):
            aside = np.repeat([ASIDE_PATCH_PX, -ASIDE_PATCH_PX], len(rows))[:, None]
            both = self._look(
                found, np.tile(rows, 2), np.tile(keypoints, 2), aside, frames, region, reference
            )
            _put(found, rows, keypoints, agreed(*halves(both), AGREED_PATCH_PX / region.refiner_scale))
        if self.thorough:
            self._aligned(found, wanted, frames, region)

    def _aligned(
        self, found: Detections, wanted: BoolArray, frames: Frames, region: RegionOfInterest
    ) -> BoolArray:
        """Put ends where they look as in the labelled frames. Which keypoints (N, K) that went well for."""
        well = np.zeros_like(wanted)
        if self.align is None:
            return well
        for number, end in enumerate(self.align.ends):
            rows = np.flatnonzero(wanted[:, end].all(axis=1))
            if not len(rows):
                continue
            ends = found.xy[rows[:, None], end]
            closer = [
                crop_end(frames[i], own, region).picture for i, own in zip(rows.tolist(), ends, strict=True)
            ]
            steps = np.concatenate([self.align(part)[:, number] for part in _in_parts(closer)])
            near = (np.linalg.norm(steps[:, :2], axis=1) <= FAR_PX) & (np.abs(steps[:, 2]) <= FAR_RAD)
            moved = move_ends(ends[near], steps[near], region.refiner_scale)
            found.xy[rows[near, None], end] = moved
            well[rows[near, None], end] = True
        return well

    def _look(
        self,
        found: Detections,
        rows: IntArray,
        keypoints: IntArray,
        aside: FloatArray | float,
        frames: Frames,
        region: RegionOfInterest,
        reference: Sequence[int],
    ) -> Detections:
        """What is seen of M keypoints, in patches cut `aside` (M, 1) px of theirs off where they may be, (M, 1)."""
        at = places(found.xy, region, reference)[rows, keypoints]
        at[:, :2] += aside / POSE_PX
        patches = [crop_patch(frames[i], own, region) for i, own in zip(rows, at, strict=True)]
        return self.read(patches, keypoints)

    def read(self, patches: Sequence[Crop], keypoint: IntArray) -> Detections:
        """What the refiner finds in M patches, each asked for one keypoint: detections (M, 1), in frame px."""
        read = _read(self.refine, [patch.picture for patch in patches])
        own = np.arange(len(patches))
        matrices = np.stack([patch.view.matrix for patch in patches])
        inverse = np.linalg.inv(matrices[:, :, :2])
        xy = np.einsum("nij,nj->ni", inverse, read.xy[own, keypoint] - matrices[:, :, 2])
        covariance = inverse @ read.covariance[own, keypoint] @ inverse.transpose(0, 2, 1)
        return Detections(xy[:, None], read.likelihood[own, keypoint, None], covariance[:, None])

    def offered(self, frames: Frames, region: RegionOfInterest) -> tuple[FloatArray, FloatArray]:
        """Places (N, K, M, 2) px in the working region that may be each keypoint's, and likelihoods (N, K, M)."""
        view = region.locator_view(LOCATOR_MULTIPLE)
        read = _read(self.locate, [_region_picture(frame, region, view) for frame in frames])
        shape = (len(frames), -1, self.peaks)
        return view.to_source(read.xy).reshape(*shape, 2), read.likelihood.reshape(shape)

    def _located(self, frames: Frames, region: RegionOfInterest) -> tuple[FloatArray, FloatArray]:
        """The likeliest place of each keypoint in the working region, as `located`."""
        xy, likelihood = self.offered(frames, region)
        return xy[:, :, 0].copy(), likelihood[:, :, 0].copy()


def predicted_at(xy: FloatArray) -> Detections:
    """Positions (N, K, 2) px where keypoints may be, that nobody has seen there yet."""
    n, k = xy.shape[:2]
    return Detections(xy.copy(), np.zeros((n, k)), np.zeros((n, k, 2, 2)))


def halves(both: Detections) -> tuple[Detections, Detections]:
    """The first and the second half of detections (2 N, K)."""
    n = len(both.xy) // 2
    one, other = (
        Detections(both.xy[side], both.likelihood[side], both.covariance[side])
        for side in (slice(n), slice(n, None))
    )
    return one, other


def agreed(one: Detections, other: Detections, within_px: float) -> Detections:
    """Two readings (N, K) of the same: their mean where they are within a distance, else the likelier."""
    near = np.linalg.norm(other.xy - one.xy, axis=2) <= within_px
    share = np.where(near, 0.5, one.likelihood >= other.likelihood)
    return Detections(
        share[..., None] * one.xy + (1 - share[..., None]) * other.xy,
        share * one.likelihood + (1 - share) * other.likelihood,
        share[..., None, None] * one.covariance + (1 - share[..., None, None]) * other.covariance,
    )


def concatenated(parts: Sequence[Detections]) -> Detections:
    """Detections of several batches as one."""
    return Detections(
        np.concatenate([part.xy for part in parts]),
        np.concatenate([part.likelihood for part in parts]),
        np.concatenate([part.covariance for part in parts]),
    )


def _put(found: Detections, rows: IntArray, keypoints: IntArray, seen: Detections) -> None:
    """Write what was seen of M keypoints, (M, 1), to what was found, (N, K)."""
    found.xy[rows, keypoints], found.likelihood[rows, keypoints] = seen.xy[:, 0], seen.likelihood[:, 0]
    found.covariance[rows, keypoints] = seen.covariance[:, 0]


def _read(reader: Predictor, pictures: Sequence[ImageArray]) -> Detections:
    """What a reader finds in pictures (H, W, 3) of one size."""
    parts = [reader(part) for part in _in_parts(pictures)]
    return parts[0] if len(parts) == 1 else concatenated(parts)


def _in_parts(pictures: Sequence[ImageArray]) -> Iterator[ImageArray]:
    """Pictures (H, W, 3) of one size as networks take them, (N, 3, H, W), a few at a time: memory stays flat."""
    at_once = max(1, MAX_INPUT_PX // (pictures[0].shape[0] * pictures[0].shape[1]))
    for start in range(0, len(pictures), at_once):
        yield stacked(pictures[start : start + at_once])


def _region_picture(frame: ImageArray, region: RegionOfInterest, view: View) -> ImageArray:
    """The frame through the region's view; shrunk by areas, since a bilinear cut would skip pixels."""
    w, h = view.size_wh
    # So many px of the frame fill the input; the frame's border is repeated where they reach beyond it.
    right = min(frame.shape[1], region.left + int(np.ceil(w / region.locator_scale)) + 2)
    bottom = min(frame.shape[0], region.top + int(np.ceil(h / region.locator_scale)) + 2)
    small = resize(frame[region.top : bottom, region.left : right], region.locator_scale)[:h, :w]
    missing_h, missing_w = h - small.shape[0], w - small.shape[1]
    return np.pad(small, ((0, missing_h), (0, missing_w), (0, 0)), mode="edge")
