"""The base-anchored estimator: it knows where an actuator's fixed end is, and how long its body is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...tracker.types import Detections, FloatArray, Frames
from ..inference.calibration import Calibration
from ..inference.coarse_to_fine import CoarseToFineEstimator, predicted_at
from ..inference.crops import CropGeometry
from ..inference.roi import turned
from .chain_assembly import assemble_chain

SLIDE_WEIGHT = 0.5
"""Weight of a distance along the body, between its ends, where locator and refiner are compared."""


@dataclass(frozen=True, kw_only=True)
class BaseAnchoredEstimator(CoarseToFineEstimator):
    """A coarse-to-fine estimator that assembles the locator's candidate peaks to a chain from the fixed end.

    Attributes
    ----------
    fixed_xy : ndarray of float, shape (2,)
        Position of the fixed end, px; of one that yields its median.
    body_px : float
        Length of the body, px.
    calibration : Calibration
        This video's, which turns peaks into likelihoods.
    """

    fixed_xy: FloatArray
    body_px: float
    calibration: Calibration

    def _propose(self, frames: Frames, geometry: CropGeometry) -> Detections:
        """The best chain through the candidates in the region of interest."""
        xy, peak = self.candidate_peaks(frames, geometry.region)
        likelihood = self.calibration.likelihood(peak)
        xy, likelihood = assemble_chain(xy, likelihood, self.fixed_xy, self.body_px)
        return replace(predicted_at(xy), likelihood=likelihood * self.calibration.normalising_peak)

    def disagreement(self, proposed: FloatArray, refined: FloatArray, geometry: CropGeometry) -> FloatArray:
        """As `CoarseToFineEstimator.disagreement`; between the chain's ends a distance along it has less weight.

        Nothing shows where on a smooth body a point of the midline lies, nor where a straight end begins to bend.
        """
        step = turned(refined - proposed, -geometry.orientations(refined))
        step[..., 1:-1, 0] *= SLIDE_WEIGHT
        return super().disagreement(np.zeros_like(step), step, geometry)
