"""Predictors whose output is known: each keypoint is a coloured spot, found by its centre of gravity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bendtrack.models.inference.coarse_to_fine import CoarseToFineEstimator
from bendtrack.models.inference.crops import CropGeometry
from bendtrack.models.inference.roi import RegionOfInterest
from bendtrack.models.inference.stages import StageSettings
from bendtrack.tracker.types import Detections

SIZE_WH = (320, 240)
REGION = RegionOfInterest(SIZE_WH, 0, 0, *SIZE_WH, 0.5, 1.5)
GEOMETRY = CropGeometry(REGION, (1, 2, 1))
COLOURS = np.array([[250, 0, 0], [0, 250, 0], [0, 0, 250]])
BACKGROUND = 60


def frame_of(xy: np.ndarray) -> np.ndarray:
    """A frame with a soft coloured spot at each of three points (3, 2)."""
    x, y = np.meshgrid(np.arange(SIZE_WH[0]), np.arange(SIZE_WH[1]))
    image = np.full((SIZE_WH[1], SIZE_WH[0], 3), BACKGROUND, float)
    for (px, py), colour in zip(xy, COLOURS, strict=True):
        spot = np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 4.0**2))
        image += spot[..., None] * (colour - BACKGROUND)
    return np.clip(image.round(), 0, 255).astype(np.uint8)


class SpotPredictor:
    """Predicts the centre of gravity of each colour, and counts the images that it was given."""

    covariance = np.diag([4.0, 1.0])

    def __init__(self) -> None:
        self.shown = 0

    def __call__(self, images: np.ndarray) -> Detections:
        self.shown += len(images)
        n, _, h, w = images.shape
        x, y = np.meshgrid(np.arange(w), np.arange(h))
        values = images.astype(float)
        xy, likelihood = np.zeros((n, 3, 2)), np.zeros((n, 3))
        for k in range(3):
            others = [c for c in range(3) if c != k]
            weight = np.clip(values[:, k] - values[:, others].max(axis=1) - 30, 0, None)
            total = weight.sum(axis=(1, 2)) + 1e-9
            xy[:, k] = np.stack([(weight * x).sum((1, 2)), (weight * y).sum((1, 2))], axis=1) / total[:, None]
            likelihood[:, k] = np.where(weight.max(axis=(1, 2)) > 40, 0.8, 0.01)
        return Detections(xy, likelihood, np.broadcast_to(self.covariance, (n, 3, 2, 2)).copy())


def arms(angles_deg: np.ndarray) -> np.ndarray:
    """Positions (T, 3, 2) px of a fixed base and an arm that turns about it."""
    turn = np.deg2rad(angles_deg)
    along = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    base = np.broadcast_to([150.0, 110.0], (len(turn), 2))
    return np.stack([base, base + 50 * along, base + 95 * along], axis=1)


class ConstantRegressor:
    """An end regressor that returns the same step for every crop of the end of keypoints 1 and 2."""

    ends = ((1, 2),)

    def __init__(self, *step: float) -> None:
        self.step = np.array(step)
        self.shown: list[np.ndarray] = []
        self.most = 0

    def __call__(self, images: np.ndarray) -> np.ndarray:
        self.shown += list(images)
        self.most = max(self.most, len(images))
        return np.broadcast_to(self.step, (len(images), 1, 3))


def without(estimator: CoarseToFineEstimator, stage: str) -> CoarseToFineEstimator:
    """The same estimator without a stage, with predictors that count from 0."""
    locator, refiner = type(estimator.locator)(), type(estimator.refiner)()
    return replace(estimator, locator=locator, refiner=refiner, stages=StageSettings(**{stage: False}))


def read_only(found: Detections) -> Detections:
    """The same detections, whose arrays cannot be written into."""
    arrays = [array.copy() for array in (found.xy, found.likelihood, found.covariance)]
    for array in arrays:
        array.setflags(write=False)
    return Detections(*arrays)


class ReadOnlyPredictor(SpotPredictor):
    """Predictions whose arrays cannot be written into."""

    def __call__(self, images: np.ndarray) -> Detections:
        return read_only(super().__call__(images))
