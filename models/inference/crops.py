"""What networks see of a frame: crops around keypoints, turned upright, and high-resolution crops of ends."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...tracker.types import FloatArray, ImageArray, IntArray
from .affine import PATCH_SIDE, View, centred_view, resize, resized_view
from .roi import RegionOfInterest, orientations, turned

POSE_PX = 4.0
POSE_TURN_DEG = 3.0
"""Units of crop poses: crop px from the frame's corner, and degrees of the crop's turn. Poses at rest are rounded to
whole units, so that a keypoint at rest is compared in one and the same crop."""

END_MAGNIFICATION = 2.0
END_SIDE = round(END_MAGNIFICATION * PATCH_SIDE)
"""The high-resolution crop of an end shows as much of the frame as a keypoint's crop, so many times as large."""

MAX_STEP_PX, MAX_STEP_RAD = 8.0, 0.25
"""Largest correction of an end's pose, in px of its high-resolution crop and rad. An end that would be moved further
does not look like the ends that the regression was fitted on, and keeps the pose that it has."""


@dataclass(frozen=True)
class Crop:
    """A square of a frame as a network sees it.

    Attributes
    ----------
    image : ndarray of uint8, shape (side, side, 3)
        RGB.
    view : View
        From frame px to px of the image.
    """

    image: ImageArray
    view: View


@dataclass(frozen=True)
class CropGeometry:
    """How frames of one size are cropped around their K keypoints.

    Attributes
    ----------
    region : RegionOfInterest
        Where keypoints can be, and both networks' scales.
    reference : tuple of int
        For each keypoint the one that gives its crop a direction (`roi.reference_keypoints`).
    """

    region: RegionOfInterest
    reference: tuple[int, ...]

    @property
    def crop_scale(self) -> float:
        """Crop px per frame px."""
        return self.region.refiner_scale

    @property
    def whole_frame(self) -> CropGeometry:
        """The same scales, for a search in the whole frame."""
        return replace(self, region=self.region.whole_frame())

    def orientations(self, xy: FloatArray) -> FloatArray:
        """Direction in rad that each keypoint's crop is turned by, (..., K), from positions (..., K, 2) px."""
        return orientations(xy, self.reference)

    def reference_distances(self, xy: FloatArray) -> FloatArray:
        """Distance of each keypoint from its reference keypoint, (N, K) crop px, from positions (N, K, 2) px."""
        distance = np.linalg.norm(xy - xy[:, list(self.reference)], axis=2)
        return np.asarray(distance * self.crop_scale)

    def crop_poses(self, xy: FloatArray) -> FloatArray:
        """Where crops are cut for keypoints expected at given positions.

        Parameters
        ----------
        xy : ndarray of float, shape (..., K, 2)
            Expected positions, px of the frame.

        Returns
        -------
        ndarray of float, shape (..., K, 3)
            Centre x, centre y in `POSE_PX`, and turn in `POSE_TURN_DEG`.
        """
        centre = xy * (self.crop_scale / POSE_PX)
        turn = self.orientations(xy) / np.deg2rad(POSE_TURN_DEG)
        return np.concatenate([centre, turn[..., None]], axis=-1)

    def crop(self, frame: ImageArray, pose: FloatArray | IntArray) -> Crop:
        """The refiner's crop of a frame at a pose (3,), PATCH_SIDE px wide."""
        centre = pose[:2] * (POSE_PX / self.crop_scale)
        return _crop(frame, centre, float(pose[2] * np.deg2rad(POSE_TURN_DEG)), self.region, PATCH_SIDE)


def crop_end(frame: ImageArray, end: FloatArray, region: RegionOfInterest) -> Crop:
    """The high-resolution crop of an end: its first point left of the centre, its second right of it.

    Parameters
    ----------
    frame : ndarray of uint8, shape (H, W, 3)
    end : ndarray of float, shape (2, 2)
        Positions of both points, px of the frame.
    region : RegionOfInterest
        Of frames of this size.
    """
    along = end[1] - end[0]
    magnified = replace(region, refiner_scale=END_MAGNIFICATION * region.refiner_scale)
    return _crop(frame, end.mean(axis=0), float(np.arctan2(along[1], along[0])), magnified, END_SIDE)


def move_ends(ends: FloatArray, steps: FloatArray, crop_scale: FloatArray | float) -> FloatArray:
    """Ends moved along, across and about their own direction.

    Parameters
    ----------
    ends : ndarray of float, shape (N, 2, 2)
        Positions of both points, px of the frame.
    steps : ndarray of float, shape (N, 3)
        Along the end and across it in px of its high-resolution crop, and the turn about its centre in rad.
    crop_scale : float or ndarray of float, shape (N,)
        Crop px of the refiner per px of each frame.

    Returns
    -------
    ndarray of float, shape (N, 2, 2)
    """
    centre = ends.mean(axis=1)
    half: FloatArray = (ends[:, 1] - ends[:, 0]) / 2
    scale = END_MAGNIFICATION * np.broadcast_to(crop_scale, len(ends))
    centre = centre + turned(steps[:, :2] / scale[:, None], np.arctan2(half[:, 1], half[:, 0]))
    half = turned(half, steps[:, 2])
    return np.stack([centre - half, centre + half], axis=1)


def _crop(
    frame: ImageArray, centre: FloatArray, turn_rad: float, region: RegionOfInterest, side: int
) -> Crop:
    """A square around a position (2,) px of a frame at the refiner's scale, direction `turn_rad` to the right."""
    size = side, side
    if region.fine_scale == 1.0:
        view = centred_view(centre, size, region.magnification, turn_rad)
        return Crop(view.cut(frame), view)
    source, source_view = _reduced_around(frame, centre, region, side)
    view = centred_view(source_view.to_input(centre), size, region.magnification, turn_rad)
    return Crop(view.cut(source), view.after(source_view))


def _reduced_around(
    frame: ImageArray, centre: FloatArray, region: RegionOfInterest, side: int
) -> tuple[ImageArray, View]:
    """The part of a frame around a square's centre, reduced to the refiner's scale, and its view."""
    scale = region.fine_scale
    h, w = frame.shape[:2]
    # Half of a turned square's diagonal, and a little for the interpolation.
    reach = (side * 0.71 + 2) / scale
    left, top = (int(v) for v in np.clip(centre - reach, 0, (w - 2, h - 2)))
    right, bottom = (int(v) for v in np.clip(centre + reach + 1, (left + 2, top + 2), (w, h)))
    part = resize(frame[top:bottom, left:right], scale)
    return part, resized_view(scale, (left, top), (part.shape[1], part.shape[0]))
