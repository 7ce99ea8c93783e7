"""Labelled frames in memory, resized once to the two scales at which the networks look."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..inference.affine import View, resize, resized_view
from ..inference.roi import RegionOfInterest


@dataclass(frozen=True)
class PreparedFrame:
    """A labelled frame at the two scales. Positions stay in frame px; the views carry them over.

    Attributes
    ----------
    coarse : the frame at the locator's scale
    fine : the frame at the refiner's scale, or as it is where the refiner magnifies
    coarse_view, fine_view : from frame px to px of those
    xy : (K, 2) frame px, NaN where not labelled
    region : the working region of frames of this size
    in_sight : (K,) bool, False where the keypoint is known to lie behind something
    """

    coarse: ImageArray
    fine: ImageArray
    coarse_view: View
    fine_view: View
    xy: FloatArray
    region: RegionOfInterest
    in_sight: BoolArray


def prepare(
    image: ImageArray, xy: FloatArray, region: RegionOfInterest, in_sight: BoolArray | None = None
) -> PreparedFrame:
    """Resize a frame once to both scales, so that a training step only cuts and turns.

    in_sight : as `PreparedFrame`'s; None where nobody says that something lies in the way
    """
    coarse, fine = resize(image, region.locator_scale), resize(image, region.fine_scale)
    return PreparedFrame(
        coarse=coarse,
        fine=fine,
        coarse_view=resized_view(region.locator_scale, (0, 0), (coarse.shape[1], coarse.shape[0])),
        fine_view=resized_view(region.fine_scale, (0, 0), (fine.shape[1], fine.shape[0])),
        xy=np.asarray(xy, dtype=np.float64),
        region=region,
        in_sight=np.ones(len(xy), bool) if in_sight is None else in_sight,
    )
