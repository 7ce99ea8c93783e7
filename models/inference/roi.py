"""The region of interest: which part of the frame the networks see, and at which scales.

Camera and clamp do not move, so the labels of a few frames say where the actuator can be in all the others.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...tracker.types import FloatArray
from .affine import PATCH_SIDE, View, resized_view

LOCATOR_SIDE = 160
"""Input px of the region's long side, unless that would make the body shorter than `LOCATOR_BODY`."""

LOCATOR_BODY = 56
"""Least length of the body in input px of the locator: 14 heatmap cells."""

PATCH_BODY_SHARE = 0.25
"""Share of the body's length that a crop shows. A tip must be seen whole, however thick it is: where a crop shows less
of an end cap than its width, a point in the middle of the cap slides along it."""

MAX_MAGNIFICATION = 1.5
"""Crops are enlarged at most so much: a camera's pixels hold nothing finer."""

MIN_DIRECT_SCALE = 0.6
"""Crops are cut straight from a frame down to so many crop px per frame px. A bilinear warp skips few pixels there, and
reducing the frame first takes four times as long."""

MARGIN_SHARE = 0.2
"""Margin around the labels, as a share of their bounding box's long side: labels never show the very extremes."""

MIN_FRAMES = 5
"""Labelled frames of one size that are enough for a region of interest of their own."""


@dataclass(frozen=True)
class RegionOfInterest:
    """A box of the frame, and the scales at which both networks see it.

    Attributes
    ----------
    frame_wh : tuple of int
        Width and height of the frames that it holds for, px.
    left, top, width, height : int
        The box in whole frame px; it may be the whole frame.
    locator_scale : float
        Locator input px per frame px.
    refiner_scale : float
        Crop px per frame px.
    """

    frame_wh: tuple[int, int]
    left: int
    top: int
    width: int
    height: int
    locator_scale: float
    refiner_scale: float

    @property
    def fine_scale(self) -> float:
        """Scale of the image that crops are cut from: 1, or smaller where crops are much smaller than the frame."""
        return 1.0 if self.refiner_scale >= MIN_DIRECT_SCALE else self.refiner_scale

    @property
    def magnification(self) -> float:
        """Crop px per px of the image that crops are cut from, at least `MIN_DIRECT_SCALE`."""
        return self.refiner_scale / self.fine_scale

    def locator_view(self, multiple: int) -> View:
        """The whole region at the locator's scale, its sides rounded up to a multiple of the network's stride."""
        size = tuple(
            max(multiple, math.ceil(round(side * self.locator_scale) / multiple) * multiple)
            for side in (self.width, self.height)
        )
        return resized_view(self.locator_scale, (self.left, self.top), (size[0], size[1]))

    def whole_frame(self) -> RegionOfInterest:
        """The same scales for the whole frame."""
        return RegionOfInterest(self.frame_wh, 0, 0, *self.frame_wh, self.locator_scale, self.refiner_scale)

    def for_frame(self, frame_wh: tuple[int, int]) -> RegionOfInterest:
        """This region for frames of another size: the whole frame, the scales changed by the sizes' ratio."""
        if frame_wh == self.frame_wh:
            return self
        ratio = max(self.frame_wh) / max(frame_wh)
        return RegionOfInterest(
            frame_wh,
            0,
            0,
            *frame_wh,
            min(1.0, self.locator_scale * ratio),
            min(MAX_MAGNIFICATION, self.refiner_scale * ratio),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready, and read back by `from_dict`."""
        return {**asdict(self), "frame_wh": list(self.frame_wh)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> RegionOfInterest:
        """The region that `to_dict` wrote."""
        return cls(**{**values, "frame_wh": (values["frame_wh"][0], values["frame_wh"][1])})


def body_length_px(xy: FloatArray) -> float:
    """Median over frames of the length of the chain through all labelled keypoints, (N, K, 2) -> px."""
    lengths = []
    for points in xy:
        seen = points[~np.isnan(points).any(axis=1)]
        if len(seen) > 1:
            lengths.append(np.linalg.norm(np.diff(seen, axis=0), axis=1).sum())
    return float(np.median(lengths)) if lengths else 0.0


def region_of_interest(
    xy: FloatArray, frame_wh: tuple[int, int], body_px: float | None = None
) -> RegionOfInterest:
    """The region of interest of labelled frames of one size.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Labels, px; NaN where a keypoint is not labelled.
    frame_wh : tuple of int
        Width and height of the frames, px.
    body_px : float, optional
        The body's length, px. Default: `body_length_px` of the labels.
    """
    points = xy.reshape(-1, 2)
    points = points[~np.isnan(points).any(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    body = max(body_length_px(xy) if body_px is None else body_px, 16.0)
    margin = max(MARGIN_SHARE * float((high - low).max()), 0.15 * body, 16.0)
    left, top = (int(v) for v in np.maximum(np.floor(low - margin), 0))
    right, bottom = (int(v) for v in np.minimum(np.ceil(high + margin), np.array(frame_wh)))
    width, height = right - left, bottom - top
    locator_scale = min(1.0, max(LOCATOR_SIDE / max(width, height), LOCATOR_BODY / body))
    refiner_scale = min(MAX_MAGNIFICATION, PATCH_SIDE / (PATCH_BODY_SHARE * body))
    return RegionOfInterest(frame_wh, left, top, width, height, locator_scale, refiner_scale)


def regions_of_interest(xy: FloatArray, sizes_wh: Sequence[tuple[int, int]]) -> tuple[RegionOfInterest, ...]:
    """A region for each frame size among labelled frames, the size with the most frames first.

    A size with fewer than `MIN_FRAMES` labelled frames takes the scales of the best-labelled size and is searched
    whole: a few poses do not say where the actuator can be.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Labels, px; NaN where not labelled.
    sizes_wh : sequence of (int, int)
        Sizes of the N frames, px.
    """
    counts = Counter(sizes_wh)
    regions = {size: region_of_interest(xy[[own == size for own in sizes_wh]], size) for size in counts}
    first = regions[counts.most_common(1)[0][0]]
    if counts[first.frame_wh] < MIN_FRAMES:
        first = first.whole_frame()
    return tuple(
        regions[size] if count >= MIN_FRAMES else first.for_frame(size)
        for size, count in counts.most_common()
    )


def reference_keypoints(xy: FloatArray) -> Sequence[int]:
    """The reference keypoint of each keypoint: the nearest other one, in the median over frames.

    The two give the keypoint's crop a direction. A keypoint that is never labelled together with another is its own
    reference, and its crops are not turned.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Labels, px; NaN where not labelled.
    """
    distance = np.linalg.norm(xy[:, :, None] - xy[:, None], axis=-1)
    k = xy.shape[1]
    middle = np.full((k, k), np.inf)
    for i in range(k):
        for j in range(k):
            both = distance[:, i, j][~np.isnan(distance[:, i, j])]
            if i != j and len(both):
                middle[i, j] = np.median(both)
    return [int(np.argmin(row)) if np.isfinite(row).any() else i for i, row in enumerate(middle)]


def reference_distances(xy: FloatArray, reference: Sequence[int], crop_scale: FloatArray) -> FloatArray:
    """The shortest and the longest labelled distance of each keypoint from its reference keypoint.

    Parameters
    ----------
    xy : ndarray of float, shape (N, K, 2)
        Labels, px; NaN where not labelled.
    reference : sequence of int
        From `reference_keypoints`.
    crop_scale : ndarray of float, shape (N,)
        Crop px per px of each frame.

    Returns
    -------
    ndarray of float, shape (K, 2)
        Crop px; (0, inf) where no frame shows both.
    """
    apart = np.linalg.norm(xy - xy[:, list(reference)], axis=2) * crop_scale[:, None]
    known = np.isfinite(apart)
    shortest = np.where(known, apart, np.inf).min(axis=0)
    longest = np.where(known, apart, -np.inf).max(axis=0)
    # A keypoint that is its own reference is at no distance from it.
    nothing = ~known.any(axis=0) | (longest == 0)
    return np.stack([np.where(nothing, 0.0, shortest), np.where(nothing, np.inf, longest)], axis=1)


def orientations(xy: FloatArray, reference: Sequence[int]) -> FloatArray:
    """The direction that each keypoint's crop is turned by: from the lower-numbered of the pair to the higher.

    Parameters
    ----------
    xy : ndarray of float, shape (..., K, 2)
        Positions, px.
    reference : sequence of int
        From `reference_keypoints`.

    Returns
    -------
    ndarray of float, shape (..., K)
        rad, from x toward y; 0 where one of the pair is NaN.
    """
    own = np.arange(len(reference))
    first, second = np.minimum(own, reference), np.maximum(own, reference)
    step = xy[..., second, :] - xy[..., first, :]
    angle: FloatArray = np.nan_to_num(np.arctan2(step[..., 1], step[..., 0]))
    return angle


def turned(vectors: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Vectors (..., 2) turned by angles (...) in rad, from x toward y."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)
