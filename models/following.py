"""Following keypoints through a video: where they were tells where to look next, so the locator mostly rests.

What is found is the refiner's word alone, as in single frames; the past only says where its patches are cut. Wherever
a patch does not show what it should, and every so often in any case, the frame is searched as if it were the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..tracker.types import Detections, FloatArray, ImageArray
from .calibration import LEAST_PEAK
from .finder import Finder, joined
from .header import Header

AHEAD = 2
"""Frames that are looked at together, at positions foretold from those before them."""

REACH_PATCH_PX = 8.0
"""A keypoint found further than this from where it was foretold is looked at again, in a patch around it: training
puts keypoints about so far from a patch's middle, and rarely further."""

SURE_SHARE = 0.5
"""A peak lower than this share of the usual one is not believed without a search."""

SEARCH_EVERY = 30
"""Frames after which one is searched whatever the patches say: a false track ends within a second."""

LOST_PATCH_PX = 16.0
"""A search that finds a keypoint further off than this, and sees it better, is believed."""


class Follower:
    """Finds the keypoints in the frames of one video, given in order."""

    def __init__(self, finder: Finder, header: Header) -> None:
        self._finder = finder
        self._header = header
        usual = np.array(header.calibration.usual_peak or [1.0] * len(header.keypoints))
        self._sure = SURE_SHARE * np.maximum(usual, LEAST_PEAK)
        self._last: FloatArray | None = None
        self._step = np.zeros((len(header.keypoints), 2))
        self._until_search = 0
        self._passed_over = 0

    def pass_over(self, frames: int) -> None:
        """Say that so many frames, the next ones of the video, will not be given: keypoints move on meanwhile."""
        self._passed_over += frames

    def detect(self, frames: ImageArray | Sequence[ImageArray]) -> Detections:
        """Keypoints of the video's next frames, (N, H, W, 3) uint8 RGB, calibrated."""
        h, w = frames[0].shape[:2]
        self._region = self._header.region_for((w, h))
        parts = [self._next(frames[start : start + AHEAD]) for start in range(0, len(frames), AHEAD)]
        return self._header.calibrated(joined(parts), self._region)

    def _next(self, frames: ImageArray | Sequence[ImageArray]) -> Detections:
        if self._last is None:
            found = self._search(frames)
        else:
            ahead = self._passed_over + np.arange(1, len(frames) + 1)[:, None, None]
            found = self._look(frames, self._last + ahead * self._step)
            self._until_search -= len(frames)
            if self._until_search <= 0:
                found = self._checked(frames, found)
        before, apart = (self._last, 1 + self._passed_over) if len(frames) == 1 else (found.xy[-2], 1)
        self._step = np.zeros_like(found.xy[-1]) if before is None else (found.xy[-1] - before) / apart
        self._last, self._passed_over = found.xy[-1], 0
        return found

    def _look(self, frames: ImageArray | Sequence[ImageArray], foretold: FloatArray) -> Detections:
        """Find keypoints near foretold positions (N, K, 2); frames in which that fails are searched."""
        found = self._refined(frames, foretold)
        far = self._distance(found.xy, foretold) > REACH_PATCH_PX
        again = np.flatnonzero(far.any(axis=1) & self._seen(found).all(axis=1)).tolist()
        if again:
            found = _with(found, again, self._refined([frames[i] for i in again], found.xy[again]))
        lost = np.flatnonzero(~self._seen(found).all(axis=1)).tolist()
        if lost:
            found = _with(found, lost, self._search([frames[i] for i in lost]))
        return found

    def _checked(self, frames: ImageArray | Sequence[ImageArray], found: Detections) -> Detections:
        """What was found, unless a search of the last frame finds better elsewhere: then all are searched."""
        searched = self._search(frames[-1:])
        elsewhere = self._distance(searched.xy[0], found.xy[-1]) > LOST_PATCH_PX
        better = searched.likelihood[0] > found.likelihood[-1]
        return self._search(frames) if (elsewhere & better).any() else found

    def _search(self, frames: ImageArray | Sequence[ImageArray]) -> Detections:
        self._until_search = SEARCH_EVERY
        return self._finder.detect(frames, self._region, self._header.partner)

    def _refined(self, frames: ImageArray | Sequence[ImageArray], xy: FloatArray) -> Detections:
        return self._finder.refined(frames, xy, self._region, self._header.partner)

    def _seen(self, found: Detections) -> np.ndarray:
        return found.likelihood >= self._sure

    def _distance(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Distances (..., K) in px of the refiner's patches."""
        distance: FloatArray = np.linalg.norm(one - other, axis=-1) * self._region.refiner_scale
        return distance


def _with(found: Detections, rows: Sequence[int], others: Detections) -> Detections:
    """Detections with some rows replaced."""
    replaced = {}
    for name in ("xy", "likelihood", "covariance"):
        values = getattr(found, name).copy()
        values[rows] = getattr(others, name)
        replaced[name] = values
    return replace(found, **replaced)
