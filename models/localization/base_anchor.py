"""Finding an actuator in the frames of a video of which it is known where it is held and how long it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...tracker.types import FloatArray, Frames
from ..inference.calibration import Calibration
from ..inference.coarse_to_fine import CoarseToFineEstimator
from ..inference.roi import RegionOfInterest, orientations, turned
from .chain_assembly import assemble_chain

SLIDE_WEIGHT = 0.5
"""What a distance along the body counts, between its ends, where locator and refiner say where a keypoint is."""


@dataclass(frozen=True, kw_only=True)
class BaseAnchoredEstimator(CoarseToFineEstimator):
    """A finder that knows where the actuator is held and how long it is: of the places offered it takes those that fit.

    Attributes
    ----------
    fixed_xy : (2,) px, where the fixed end is
    body_px : the body's length
    calibration : this video's, which says what a peak is worth
    """

    fixed_xy: FloatArray
    body_px: float
    calibration: Calibration
    thorough: bool = True

    def _located(self, frames: Frames, region: RegionOfInterest) -> tuple[FloatArray, FloatArray]:
        xy, peak = self.offered(frames, region)
        likelihood = self.calibration.likelihood(peak)
        xy, likelihood = assemble_chain(xy, likelihood, self.fixed_xy, self.body_px)
        return xy, likelihood * self.calibration.usual

    def apart(
        self, located: FloatArray, found: FloatArray, region: RegionOfInterest, reference: Sequence[int]
    ) -> FloatArray:
        """As `CoarseToFineEstimator.apart`; between the chain's ends a distance along it counts for less.

        Nothing shows where on a smooth body a point of the midline lies, nor where a straight end begins to bend.
        """
        step = turned(found - located, -orientations(found, reference))
        step[..., 1:-1, 0] *= SLIDE_WEIGHT
        return super().apart(np.zeros_like(step), step, region, reference)
