"""Motion evidence: where in the probe frames something moves that no change of light explains.

The camera stands still, and what moves is the actuator. Only images are compared here; what a chain of keypoints makes
of the evidence is in `probe_frames.py`. Imports no torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ...tracker.types import FloatArray, Frames

SIDE_PX = 320
"""Long side of the frames that are compared, px: bodies are still ten or more px wide."""

WINDOW_PX = 4.0
"""Standard deviation of the window in which a frame and the background are compared, px of the small frames."""

DARKEST, BRIGHTEST = 0.4, 2.0
"""Range of the factor by which light may have changed. Beyond it something else is seen."""

NOISE_LEVELS = 2.0
"""Least difference in grey levels that noise and compression make."""

BLUR_PX = 0.25
"""Shift of an edge that focus, compression and what is left of a shake make, px of the small frames."""

CERTAIN, POSSIBLE = 6.0, 3.0
"""Differences in units of what noise makes: from the first on motion is certain, up to the second there is none."""

RECURRING = 0.1
"""Share of the probe frames in which a place must differ to count as one where something moves all the time: a hand
that comes in once is in fewer."""

LEAST_AREA = 5e-4
"""Share of the picture that must move recurringly; where less does, the actuator rests and nothing is said."""

NEAR_PX = 3
"""A keypoint this near to what moves belongs to it, px of the small frames: ends lie on the body's outline."""

MAX_SHAKE_PX = 12.0
"""Largest shift of a whole frame against the others that is taken out, px of the small frames."""


@dataclass(frozen=True)
class MotionEvidence:
    """How certainly something moves at each place of each probe frame.

    Attributes
    ----------
    moving : ndarray of float32, shape (N, h, w)
        In [0, 1]: the place differs from the background in this frame.
    recurring : ndarray of float32, shape (h, w)
        In [0, 1]: the place differs in a tenth of the frames at least, though perhaps not in this one.
    scale : float
        Small frames' px per px of the video.
    """

    moving: FloatArray
    recurring: FloatArray
    scale: float

    @property
    def is_known(self) -> bool:
        """Whether enough moves to say what the actuator is."""
        return bool((self.recurring > 0.5).mean() >= LEAST_AREA)

    def at(self, xy: FloatArray) -> FloatArray:
        """Evidence in [0, 1] that places (N, ..., 2) px of each frame belong to what moves, shape (N, ...).

        A body at rest where it rests most of the time does not differ from the background, but it does whenever it is
        away: such places count by `recurring`.
        """
        if not self.is_known:
            return np.ones(xy.shape[:-1])
        h, w = self.recurring.shape
        place = np.nan_to_num((xy + 0.5) * self.scale - 0.5)
        column = np.clip(np.rint(place[..., 0]).astype(int), 0, w - 1)
        row = np.clip(np.rint(place[..., 1]).astype(int), 0, h - 1)
        frame = np.arange(len(xy)).reshape(-1, *[1] * (xy.ndim - 2))
        return np.maximum(self.moving[frame, row, column], self.recurring[row, column]).astype(float)


def motion_evidence(probe_frames: Frames) -> MotionEvidence:
    """Find what moves in frames spread over a video.

    The background is the temporal median. A window differs where no factor of light makes the background's window into
    the frame's; so shadows, a drift of the exposure and a lamp that is switched on do not count, nor does a shake of the
    whole picture, which is taken out first.

    Parameters
    ----------
    probe_frames : sequence of ndarray of uint8, shape (H, W, 3)
        RGB, all of one size.
    """
    h, w = probe_frames[0].shape[:2]
    scale = min(1.0, SIDE_PX / max(h, w))
    size = (max(1, round(w * scale)), max(1, round(h * scale)))
    small = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in probe_frames])
    images = _without_shake(small.astype(np.float32))
    background = np.median(images, axis=0).astype(np.float32)
    slope = cv2.GaussianBlur(_slope(background), (0, 0), WINDOW_PX)
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * NEAR_PX + 1,) * 2)
    moving = np.stack([cv2.dilate(_difference(image, background, slope), near) for image in images])
    # The k-th largest of N.
    k = max(2, round(RECURRING * len(images)))
    recurring = (
        np.partition(moving, len(images) - k, axis=0)[len(images) - k] if k <= len(images) else 0 * slope
    )
    return MotionEvidence(moving, recurring, scale)


def _difference(image: FloatArray, background: FloatArray, slope: FloatArray) -> FloatArray:
    """How certainly windows of an image (h, w, 3) differ from the background's but for a factor of light, (h, w)."""

    def window(values: FloatArray) -> FloatArray:
        return cv2.GaussianBlur(values.mean(axis=2), (0, 0), WINDOW_PX)

    both, own = window(image * background), window(background * background)
    factor = np.clip(both / np.maximum(own, 1.0), DARKEST, BRIGHTEST)
    residual = window(image * image) - 2 * factor * both + factor**2 * own
    levels = np.sqrt(np.maximum(residual, 0.0))
    # Light and noise make this much; half of all windows show nothing else.
    noise = np.hypot(np.maximum(NOISE_LEVELS, float(np.median(levels))), BLUR_PX * slope)
    return np.clip((levels / noise - POSSIBLE) / (CERTAIN - POSSIBLE), 0.0, 1.0).astype(np.float32)


def _slope(image: FloatArray) -> FloatArray:
    """Magnitude of the gradient of an image (h, w, 3), mean over its channels."""
    rows, columns = np.gradient(image, axis=(0, 1))
    return np.sqrt(rows**2 + columns**2).mean(axis=2).astype(np.float32)


def _without_shake(images: FloatArray) -> FloatArray:
    """Images (N, h, w, 3) shifted onto their median: what is left of a shake is below half a px."""
    h, w = images.shape[1:3]
    window = cv2.createHanningWindow((w, h), cv2.CV_32F)
    reference = _edges(np.median(images, axis=0))
    shifted = images.copy()
    for i, image in enumerate(images):
        (dx, dy), response = cv2.phaseCorrelate(reference, _edges(image), window)
        if response > 0.1 and 0.25 < float(np.hypot(dx, dy)) <= MAX_SHAKE_PX:
            matrix = np.array([[1.0, 0.0, -dx], [0.0, 1.0, -dy]])
            shifted[i] = cv2.warpAffine(image, matrix, (w, h), borderMode=cv2.BORDER_REPLICATE)
    return shifted


def _edges(image: FloatArray) -> FloatArray:
    """Gradient magnitude: places do not depend on the level of the light."""
    return np.minimum(_slope(image), 20.0)
