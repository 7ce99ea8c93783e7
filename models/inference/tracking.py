"""Following keypoints through a video: where they were tells where to look next, so the locator mostly rests.

What is found is what is seen close by, as in single frames; the past only says where patches are cut, and what a patch
shows that shows the same as before. Wherever a patch does not show what it should, the frame is searched as if
it were the first, and so are those after it until both networks are sure again; and every so often the locator says
whether it would look elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...tracker.types import BoolArray, Detections, FloatArray, Frames, IntArray
from .coarse_to_fine import LOST_PATCH_PX, CoarseToFineEstimator, concatenated, predicted_at
from .crops import crop_patch, places
from .metadata import CheckpointMetadata
from .roi import RegionOfInterest
from .static_patch import StaticPatchTest

AHEAD = 2
"""Frames that are looked at together, at positions foretold from those before them."""

SURE_SHARE = 0.5
"""A peak lower than this share of the usual one is not believed without a search."""

CHECK_EVERY = 16
"""Frames after which the locator is asked whatever the patches say: a false track ends within half a second."""

RESTING_PATCH_PX = 0.5
"""A keypoint that moved by less from one frame to the next may be at rest."""

ENOUGH = 4
"""Times that a keypoint at rest is read; afterwards it is taken to be at the mean."""

SAME_PLACE = 0.75
"""Places' own units that a keypoint at rest may lie from where it is compared."""

Believed = Callable[[Detections, RegionOfInterest], Detections]


@dataclass
class _Known:
    """What was found, on average, of a keypoint at rest, each time beginning with the same sight at a place."""

    place: IntArray
    find_actuator: StaticPatchTest
    times: int = 0
    xy: FloatArray = field(default_factory=lambda: np.zeros(2))
    likelihood: float = 0.0
    covariance: FloatArray = field(default_factory=lambda: np.zeros((2, 2)))

    def add(self, xy: FloatArray, likelihood: float, covariance: FloatArray) -> None:
        """Take in what was found once more."""
        self.times += 1
        self.xy = self.xy + (xy - self.xy) / self.times
        self.likelihood += (likelihood - self.likelihood) / self.times
        self.covariance = self.covariance + (covariance - self.covariance) / self.times


class KeypointTracker:
    """Finds the keypoints in the frames of one video, given in order.

    Parameters
    ----------
    believed : what is made of what was found in a region; None calibrates it
    """

    def __init__(
        self, finder: CoarseToFineEstimator, header: CheckpointMetadata, believed: Believed | None = None
    ) -> None:
        self._finder = finder
        self._header = header
        self._believed = believed or header.calibrated
        self._sure = SURE_SHARE * header.calibration.usual
        self._last: FloatArray | None = None
        self._step = np.zeros((len(header.keypoints), 2))
        self._until_check = 0
        self._is_sure = False
        self._passed_over = 0
        self._known: list[_Known | None] = [None] * len(header.keypoints)

    def pass_over(self, frames: int) -> None:
        """Say that so many frames, the next ones of the video, will not be given: keypoints move on meanwhile."""
        self._passed_over += frames

    def detect(self, frames: Frames) -> Detections:
        """Keypoints of the video's next frames, (N, H, W, 3) uint8 RGB, calibrated."""
        h, w = frames[0].shape[:2]
        self._region = self._header.region_for((w, h))
        # The first frame tells where to look in the others.
        begin = 1 if self._last is None else 0
        parts = [self._next(frames[:begin])] if begin else []
        parts += [self._next(frames[i : i + AHEAD]) for i in range(begin, len(frames), AHEAD)]
        return self._believed(self._followed_back(frames, concatenated(parts)), self._region)

    def _followed_back(self, frames: Frames, found: Detections) -> Detections:
        """What was found, with frames in which something was lost looked at once more from those after them.

        A tip that comes out from behind something is often found again before the next one is; where it was a moment
        earlier is then known. As when following forward, patches must show each keypoint; the locator, which was not
        sure in these frames, is not asked again.
        """
        seen: BoolArray = np.asarray(self._seen(found).all(axis=1))
        for i in range(len(frames) - 2, -1, -1):
            if seen[i] or not seen[i + 1]:
                continue
            after = found.xy[i + 1]
            step = after - found.xy[i + 2] if i + 2 < len(frames) and seen[i + 2] else np.zeros_like(after)
            again = self._finder.refined(
                frames[i : i + 1], (after + step)[None], self._region, self._header.reference
            )
            if self._seen(again).all():
                found, seen[i] = _with(found, [i], again), True
        return found

    def _next(self, frames: Frames) -> Detections:
        if self._last is None or not self._is_sure:
            found = self._search(frames)
        else:
            ahead = self._passed_over + np.arange(1, len(frames) + 1)[:, None, None]
            found = self._look(frames, predicted_at(self._last + ahead * self._step))
            self._until_check -= len(frames)
            if self._until_check <= 0:
                found = self._checked(frames, found)
        before, apart = (self._last, 1 + self._passed_over) if len(frames) == 1 else (found.xy[-2], 1)
        self._step = np.zeros_like(found.xy[-1]) if before is None else (found.xy[-1] - before) / apart
        self._last, self._passed_over = found.xy[-1], 0
        return found

    def _look(self, frames: Frames, found: Detections) -> Detections:
        """Find keypoints near where they are foretold; frames in which that fails are searched."""
        region, reference = self._region, self._header.reference
        moved_px = np.linalg.norm(self._step, axis=1) * region.refiner_scale
        resting = np.flatnonzero(moved_px < RESTING_PATCH_PX).tolist()
        expected = places(found.xy, region, reference)
        wanted = np.ones(expected.shape[:2], bool)
        anew: list[tuple[int, int, _Known]] = []
        for i, frame in enumerate(frames):
            for k in resting:
                known, anywhere = self._known[k], expected[i, k]
                # What rests between two places is compared at the one where it was seen first.
                here = known is not None and np.abs(known.place - anywhere).max() < SAME_PLACE
                place = known.place if known and here else np.rint(anywhere).astype(int)
                picture = crop_patch(frame, place, region).picture
                if not (known and here and known.find_actuator.is_still(picture)):
                    known = _Known(place, StaticPatchTest(picture))
                if known.times < ENOUGH:
                    anew.append((i, k, known))
                else:
                    found.xy[i, k], found.likelihood[i, k] = known.xy, known.likelihood
                    found.covariance[i, k] = known.covariance
                    wanted[i, k] = False
        # Of an end of which one point moves both are looked for: it is seen closer only as a whole.
        for first, second in self._finder.align.ends if self._finder.align else ():
            wanted[:, first] = wanted[:, second] = wanted[:, first] | wanted[:, second]
        self._finder.settle(found, wanted, frames, region, reference)
        for i, k, known in anew:
            known.add(found.xy[i, k], found.likelihood[i, k], found.covariance[i, k])
            self._known[k] = known
        lost = np.flatnonzero(~self._seen(found).all(axis=1)).tolist()
        return _with(found, lost, self._search([frames[i] for i in lost])) if lost else found

    def _checked(self, frames: Frames, found: Detections) -> Detections:
        """What was found, unless the locator would look elsewhere in the last frame, and both are sure of it there."""
        self._until_check = CHECK_EVERY
        located, _ = self._finder.located(frames[-1:], self._region)
        if not self._elsewhere(located[0], found).any():
            return found
        searched = self._search(frames)
        if (self._elsewhere(searched.xy[-1], found) & self._seen(searched)[-1]).any():
            return searched
        self._is_sure = True
        return found

    def _elsewhere(self, xy: FloatArray, found: Detections) -> np.ndarray:
        apart = self._finder.apart(xy, found.xy[-1], self._region, self._header.reference)
        return np.asarray(apart > LOST_PATCH_PX)

    def _search(self, frames: Frames) -> Detections:
        self._until_check = CHECK_EVERY
        found = self._finder.detect(frames, self._region, self._header.reference)
        self._is_sure = bool(self._seen(found)[-1].all())
        return found

    def _seen(self, found: Detections) -> BoolArray:
        """Which keypoints (N, K) are seen well enough, and not far from where their partners say."""
        return np.asarray((found.likelihood >= self._sure) & self._header.fits(found.xy, self._region))


def _with(found: Detections, rows: Sequence[int], others: Detections) -> Detections:
    """Detections with some rows replaced."""
    parts = [
        (found.xy, others.xy),
        (found.likelihood, others.likelihood),
        (found.covariance, others.covariance),
    ]
    replaced = []
    for own, other in parts:
        replaced.append(own.copy())
        replaced[-1][rows] = other
    return Detections(*replaced)
