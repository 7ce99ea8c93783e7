"""Labelled frames in memory, resized once to the scales of the locator and of the refiner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..inference.affine import View, resize, resized_view
from ..inference.roi import RegionOfInterest


@dataclass(frozen=True)
class PreparedFrame:
    """A labelled frame at both networks' scales.

    Positions are in px of the frame as it was read; the views map them into the resized images.

    Attributes
    ----------
    coarse : (h, w, 3) uint8 array
        The frame at the locator's scale.
    fine : (h, w, 3) uint8 array
        The frame at the refiner's scale, or unchanged where the refiner magnifies.
    coarse_view, fine_view : View
        From frame px to px of `coarse` and `fine`.
    xy : (K, 2) float array
        Labels, frame px, NaN where not labelled.
    region : RegionOfInterest
        Of frames of this size.
    visible : (K,) bool array
        False where the keypoint is known to be occluded.
    """

    coarse: ImageArray
    fine: ImageArray
    coarse_view: View
    fine_view: View
    xy: FloatArray
    region: RegionOfInterest
    visible: BoolArray


def prepare(
    image: ImageArray, xy: FloatArray, region: RegionOfInterest, visible: BoolArray | None = None
) -> PreparedFrame:
    """Resize a frame once to both scales, so that a training step only cuts and rotates.

    Parameters
    ----------
    image : (H, W, 3) uint8 array
        RGB.
    xy : (K, 2) float array
        Labels, px, NaN where not labelled.
    region : RegionOfInterest
        Of frames of this size.
    visible : (K,) bool array, optional
        As `PreparedFrame.visible`; all True by default.

    Returns
    -------
    PreparedFrame
    """
    coarse, fine = resize(image, region.locator_scale), resize(image, region.fine_scale)
    return PreparedFrame(
        coarse=coarse,
        fine=fine,
        coarse_view=resized_view(region.locator_scale, (0, 0), (coarse.shape[1], coarse.shape[0])),
        fine_view=resized_view(region.fine_scale, (0, 0), (fine.shape[1], fine.shape[0])),
        xy=np.asarray(xy, dtype=np.float64),
        region=region,
        visible=np.ones(len(xy), bool) if visible is None else visible,
    )
