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
"""Shift of an edge that focus, compression and what is left of a shake make, px of the small frames. Together with the
next two: what moves by less than 0.75 px does not count, what moves by more than 1.5 px does."""

CERTAIN, POSSIBLE = 6.0, 3.0
"""Differences in units of what noise makes: from the first on motion is certain, up to the second there is none."""

RECURRING = 0.1
"""Share of the probe frames in which a place must differ to count as one where something moves all the time: a hand
that comes in once is in fewer."""

LEAST_AREA = 5e-4
"""Share of the picture that must move recurringly; where less does, the actuator rests and nothing is said."""

NEAR_PX = 3
"""A keypoint this near to what moves belongs to it, px of the small frames: ends lie on the body's outline."""

MIN_SHAKE_PX, MAX_SHAKE_PX = 0.4, 12.0
"""Range of shifts of a whole frame against the others that are taken out, px of the small frames."""

STEADIER, STRONG_EDGES = 0.8, 0.95
"""A shift is taken out where the median difference at edges above this quantile falls to less than this share."""

EDGE_PX, STRONGEST_EDGE = 1.0, 20.0
"""Smoothing before edges are compared, px, and the strength above which all count alike, grey levels per px."""


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
    shake_px : ndarray of float, shape (N, 2)
        Shift of each whole frame that was taken out, px of the small frames.
    """

    moving: FloatArray
    recurring: FloatArray
    scale: float
    shake_px: FloatArray

    @property
    def is_known(self) -> bool:
        """Whether enough moves to say what the actuator is."""
        return bool((self.recurring > 0.5).mean() >= LEAST_AREA)

    def at(self, xy: FloatArray) -> FloatArray:
        """Evidence in [0, 1] that places (N, ..., 2) px of each frame belong to what moves, shape (N, ...).

        A body at rest where it rests most of the time does not differ from the background, but it does whenever it is
        away: such places count by `recurring`.
        """
        h, w = self.recurring.shape
        shake = self.shake_px.reshape(-1, *[1] * (xy.ndim - 2), 2)
        place = np.nan_to_num((xy + 0.5) * self.scale - 0.5 - shake)
        column = np.clip(np.rint(place[..., 0]).astype(int), 0, w - 1)
        row = np.clip(np.rint(place[..., 1]).astype(int), 0, h - 1)
        frame = np.arange(len(xy)).reshape(-1, *[1] * (xy.ndim - 2))
        return np.maximum(self.moving[frame, row, column], self.recurring[row, column]).astype(float)


def motion_evidence(probe_frames: Frames) -> MotionEvidence:
    """Find what moves in frames spread over a video.

    The background is the temporal median. A window differs where no factor of light makes the background's window into
    the frame's; so shadows, a drift of the exposure and a lamp that is switched on do not count. A shake of the whole
    picture is taken out first.

    Parameters
    ----------
    probe_frames : sequence of ndarray of uint8, shape (H, W, 3)
        RGB, all of one size.
    """
    h, w = probe_frames[0].shape[:2]
    scale = min(1.0, SIDE_PX / max(h, w))
    size = (max(1, round(w * scale)), max(1, round(h * scale)))
    small = np.stack([cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in probe_frames])
    images, shake_px = _without_shake(small.astype(np.float32))
    background = np.median(images, axis=0).astype(np.float32)
    slope = np.sqrt(cv2.GaussianBlur(_slope(background) ** 2, (0, 0), WINDOW_PX))
    near = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * NEAR_PX + 1,) * 2)
    moving = np.stack([cv2.dilate(_difference(image, background, slope), near) for image in images])
    # The k-th largest of N.
    k = max(2, round(RECURRING * len(images)))
    recurring = (
        np.partition(moving, len(images) - k, axis=0)[len(images) - k] if k <= len(images) else 0 * slope
    )
    return MotionEvidence(moving, recurring, scale, shake_px)


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


def _without_shake(images: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Images (N, h, w, 3) shifted onto each other where the whole picture shakes, and how it does, (N, 2) px."""
    shift = np.zeros((len(images), 2))
    shifted = images
    # The median of a film that shakes is blurred: its least unusual frame is the first reference.
    edges = np.stack([_edges(image) for image in images])
    reference = edges[int(np.abs(edges - np.median(edges, axis=0)).sum(axis=(1, 2)).argmin())]
    for _ in range(2):
        shift = np.stack([_shake_px(image, reference) for image in images])
        if not shift.any():
            return images, shift
        shifted = np.stack([_moved(image, -own) for image, own in zip(images, shift, strict=True)])
        reference = _edges(np.median(shifted, axis=0).astype(np.float32))
    return shifted, shift


def _shake_px(image: FloatArray, reference: FloatArray) -> FloatArray:
    """Shift (2,) px of a whole image (h, w, 3) against a reference's edges (h, w); zero where it does not shake."""
    h, w = reference.shape
    # OpenCV multiplies by the window in place where the size needs no padding.
    window = cv2.createHanningWindow((w, h), cv2.CV_32F)
    found, _ = cv2.phaseCorrelate(reference.copy(), _edges(image), window)
    if not MIN_SHAKE_PX < float(np.hypot(*found)) <= MAX_SHAKE_PX:
        return np.zeros(2)
    # A body that moves is not a shake: what lies about must fit, that is, most of the picture.
    before = _edge_difference(image, reference)
    after = _edge_difference(_moved(image, -np.array(found)), reference)
    return np.array(found) if after < STEADIER * before else np.zeros(2)


def _moved(image: FloatArray, shift: FloatArray) -> FloatArray:
    """An image moved by a shift (2,) px, its border repeated."""
    matrix = np.column_stack([np.eye(2), shift])
    return cv2.warpAffine(image, matrix, image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)


def _edge_difference(image: FloatArray, reference: FloatArray) -> float:
    """Median difference of an image's edges from others, where there are some."""
    edges = _edges(image)
    strong = reference >= np.quantile(reference, STRONG_EDGES)
    return float(np.median(np.abs(edges - reference)[strong]))


def _edges(image: FloatArray) -> FloatArray:
    """Where edges are, whatever the level of the light: the gradient's magnitude up to a limit.

    Smooth enough that noise counts for little, which a shift by part of a px would smooth away.
    """
    return np.minimum(_slope(cv2.GaussianBlur(image, (0, 0), EDGE_PX)), STRONGEST_EDGE)
