"""How two trained networks find keypoints in frames: locate them in the working region, then look closely at each.

Knows networks only as functions from pictures to positions (`Reader`), so torch and compiled engines share every line
of it. The networks themselves are in `cascade.py`, compiled ones in `compiled.py`, videos in `following.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray, Frames, ImageArray, IntArray
from .regions import WorkingRegion, patch_directions
from .views import PATCH_SIDE, View, patch_view, resize, resized_view

LOCATOR_MULTIPLE = 32
"""The locator's input sides are multiples of this: its four stages halve them five times."""

COLLAPSE_LIKELIHOOD = 0.15
"""A keypoint whose peak in the working region is under this is sought in the whole frame: a bend beyond the labelled
ones may carry the tip out of the region. (Peaks of what is there are 0.4 to 0.9.)"""

PLACE_PX = 4.0
PLACE_TURN_DEG = 3.0
"""What places (`places`) are counted in: patch px from the frame's corner, and degrees of the patch's turn."""

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


class Reader(Protocol):
    """A network as a function."""

    def __call__(self, pictures: ImageArray) -> Detections:
        """Every keypoint in pictures (N, 3, H, W) uint8 RGB, positions and covariances in their own px."""


@dataclass(frozen=True)
class Patch:
    """What the refiner is shown of a frame for one keypoint.

    Attributes
    ----------
    picture : (PATCH_SIDE, PATCH_SIDE, 3) uint8
    view : from frame px to patch px
    """

    picture: ImageArray
    view: View


@dataclass(frozen=True)
class Finder:
    """Locator and refiner at work.

    Attributes
    ----------
    locate : reads the working region
    refine : reads patches; patch i of a frame is asked for keypoint i only
    peaks : places that `locate` offers for each keypoint, next to each other, the likeliest first
    """

    locate: Reader
    refine: Reader
    peaks: int = 1

    def detect(self, frames: Frames, region: WorkingRegion, partner: Sequence[int]) -> Detections:
        """Find the keypoints in frames of one size, each by itself.

        Parameters
        ----------
        region : where to look, made for frames of this size (`Header.region_for`)
        partner : from `regions.partners`
        """
        xy, likelihood = self.located(frames, region)
        found = self.refined(frames, xy, region, partner)
        # Both must have seen it, and in one place: a locator may guess through a hand, a patch show something else.
        together = self.apart(xy, found.xy, region, partner) <= LOST_PATCH_PX
        both = np.where(together, np.minimum(likelihood, found.likelihood), 0.0)
        return Detections(found.xy, both, found.covariance)

    def located(self, frames: Frames, region: WorkingRegion) -> tuple[FloatArray, FloatArray]:
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
        self, located: FloatArray, found: FloatArray, region: WorkingRegion, partner: Sequence[int]
    ) -> FloatArray:
        """How far (..., K) patch px the two networks' positions (..., K, 2) px are from saying the same."""
        distance: FloatArray = np.linalg.norm(found - located, axis=-1) * region.refiner_scale
        return distance

    def refined(
        self, frames: Frames, xy: FloatArray, region: WorkingRegion, partner: Sequence[int]
    ) -> Detections:
        """Look closely at each keypoint, near where it is thought to be, xy (N, K, 2) px; what is NaN stays NaN."""
        found = foretold(xy)
        self.settle(found, np.logical_not(np.isnan(xy).any(axis=2)), frames, region, partner)
        return found

    def settle(
        self,
        found: Detections,
        wanted: BoolArray,
        frames: Frames,
        region: WorkingRegion,
        partner: Sequence[int],
    ) -> None:
        """Look where keypoints may be, then from two sides at what was found there: the mean of those two counts.

        Where a keypoint lies in its patch shifts what is found there, partly the same way and partly by chance. Seen
        from two sides the one cancels and the other is halved; and who begins a little off ends at the same position.

        Parameters
        ----------
        found : where they may be, (N, K); what is found is written into it
        wanted : (N, K) bool, which are to be looked for
        """
        every = rows, keypoints = np.asarray(np.nonzero(wanted))
        if not len(rows):
            return
        for _ in range(MOST_SIGHTINGS):
            thought = found.xy[rows, keypoints]
            seen = self._look(found, rows, keypoints, 0.0, frames, region, partner)
            _put(found, rows, keypoints, seen)
            off_px = np.linalg.norm(seen.xy[:, 0] - thought, axis=1)
            far = off_px * region.refiner_scale > FAR_PATCH_PX
            rows, keypoints = rows[far], keypoints[far]
            if not len(rows):
                break
        rows, keypoints = every
        aside = np.repeat([ASIDE_PATCH_PX, -ASIDE_PATCH_PX], len(rows))[:, None]
        both = self._look(found, np.tile(rows, 2), np.tile(keypoints, 2), aside, frames, region, partner)
        _put(found, rows, keypoints, agreed(*halves(both), AGREED_PATCH_PX / region.refiner_scale))

    def _look(
        self,
        found: Detections,
        rows: IntArray,
        keypoints: IntArray,
        aside: FloatArray | float,
        frames: Frames,
        region: WorkingRegion,
        partner: Sequence[int],
    ) -> Detections:
        """What is seen of M keypoints, in patches cut `aside` (M, 1) px of theirs off where they may be, (M, 1)."""
        at = places(found.xy, region, partner)[rows, keypoints]
        at[:, :2] += aside / PLACE_PX
        patches = [cut_patch(frames[i], own, region) for i, own in zip(rows, at, strict=True)]
        return self.read(patches, keypoints)

    def read(self, patches: Sequence[Patch], keypoint: IntArray) -> Detections:
        """What the refiner finds in M patches, each asked for one keypoint: detections (M, 1), in frame px."""
        read = _read(self.refine, [patch.picture for patch in patches])
        own = np.arange(len(patches))
        matrices = np.stack([patch.view.matrix for patch in patches])
        inverse = np.linalg.inv(matrices[:, :, :2])
        xy = np.einsum("nij,nj->ni", inverse, read.xy[own, keypoint] - matrices[:, :, 2])
        covariance = inverse @ read.covariance[own, keypoint] @ inverse.transpose(0, 2, 1)
        return Detections(xy[:, None], read.likelihood[own, keypoint, None], covariance[:, None])

    def offered(self, frames: Frames, region: WorkingRegion) -> tuple[FloatArray, FloatArray]:
        """Places (N, K, M, 2) px in the working region that may be each keypoint's, and likelihoods (N, K, M)."""
        view = region.locator_view(LOCATOR_MULTIPLE)
        read = _read(self.locate, [_region_picture(frame, region, view) for frame in frames])
        shape = (len(frames), -1, self.peaks)
        return view.to_source(read.xy).reshape(*shape, 2), read.likelihood.reshape(shape)

    def _located(self, frames: Frames, region: WorkingRegion) -> tuple[FloatArray, FloatArray]:
        """The likeliest place of each keypoint in the working region, as `located`."""
        xy, likelihood = self.offered(frames, region)
        return xy[:, :, 0].copy(), likelihood[:, :, 0].copy()


def foretold(xy: FloatArray) -> Detections:
    """Positions (N, K, 2) px where keypoints may be, that nobody has seen there yet."""
    n, k = xy.shape[:2]
    return Detections(xy.copy(), np.zeros((n, k)), np.zeros((n, k, 2, 2)))


def places(near: FloatArray, region: WorkingRegion, partner: Sequence[int]) -> FloatArray:
    """Where patches are cut for keypoints thought to be at `near` (..., K, 2) px: middle x, middle y and turn.

    (..., K, 3), counted in `PLACE_PX` and `PLACE_TURN_DEG`; upright by each keypoint's partner
    """
    middle = near * (region.refiner_scale / PLACE_PX)
    turn = patch_directions(near, partner) / np.deg2rad(PLACE_TURN_DEG)
    return np.concatenate([middle, turn[..., None]], axis=-1)


def cut_patch(frame: ImageArray, place: FloatArray | IntArray, region: WorkingRegion) -> Patch:
    """The patch of a frame at a place (3,)."""
    middle = place[:2] * (PLACE_PX / region.refiner_scale)
    turn = float(place[2] * np.deg2rad(PLACE_TURN_DEG))
    if region.fine_scale == 1.0:
        view = patch_view(middle, region.magnification, turn)
        return Patch(view.cut(frame), view)
    source, source_view = _around(frame, middle, region)
    view = patch_view(source_view.to_input(middle), region.magnification, turn)
    return Patch(view.cut(source), view.after(source_view))


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


def joined(parts: Sequence[Detections]) -> Detections:
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


def _read(reader: Reader, pictures: Sequence[ImageArray]) -> Detections:
    """Pictures (H, W, 3) of one size, a few at a time so that memory stays flat whatever their size."""
    at_once = max(1, MAX_INPUT_PX // (pictures[0].shape[0] * pictures[0].shape[1]))
    parts = []
    for start in range(0, len(pictures), at_once):
        stacked = np.stack(pictures[start : start + at_once])
        parts.append(reader(np.ascontiguousarray(stacked.transpose(0, 3, 1, 2))))
    return parts[0] if len(parts) == 1 else joined(parts)


def _region_picture(frame: ImageArray, region: WorkingRegion, view: View) -> ImageArray:
    """The frame through the region's view; shrunk by areas, since a bilinear cut would skip pixels."""
    w, h = view.size_wh
    # So many px of the frame fill the input; the frame's border is repeated where they reach beyond it.
    right = min(frame.shape[1], region.left + int(np.ceil(w / region.locator_scale)) + 2)
    bottom = min(frame.shape[0], region.top + int(np.ceil(h / region.locator_scale)) + 2)
    small = resize(frame[region.top : bottom, region.left : right], region.locator_scale)[:h, :w]
    missing_h, missing_w = h - small.shape[0], w - small.shape[1]
    return np.pad(small, ((0, missing_h), (0, missing_w), (0, 0)), mode="edge")


def _around(frame: ImageArray, middle: FloatArray, region: WorkingRegion) -> tuple[ImageArray, View]:
    """A part of a frame around a patch's middle, made as small as the refiner looks at it, and how."""
    scale = region.fine_scale
    h, w = frame.shape[:2]
    # Half of a turned patch's diagonal, and a little for the interpolation.
    reach = (PATCH_SIDE * 0.71 + 2) / scale
    left, top = (int(v) for v in np.clip(middle - reach, 0, (w - 2, h - 2)))
    right, bottom = (int(v) for v in np.clip(middle + reach + 1, (left + 2, top + 2), (w, h)))
    part = resize(frame[top:bottom, left:right], scale)
    return part, resized_view(scale, (left, top), (part.shape[1], part.shape[0]))
