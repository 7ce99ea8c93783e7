"""Fitting the end-pose regressor: ridge regression from first-stage features of an end's crop to its pose error.

The refiner finds an end anywhere and in any state; a crop at twice its scale, cut where it was found, shows twice the
detail of the little that is left to estimate. As in supervised descent (Xiong & De la Torre 2013) crops are cut at
randomly perturbed poses in all labelled frames, half of them under changed light, and the perturbation is regressed on
their features. The ridge penalty is chosen by cross-validation over frames.

How the fitted regressor is applied is in `networks.end_regressor`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..data.augmentation import change_image
from ..inference.affine import stacked
from ..inference.crops import crop_end, move_ends
from ..inference.roi import RegionOfInterest
from ..networks.end_regressor import EndRegressionNetwork
from ..networks.heatmap_network import FirstStage
from .geometry import FrameGeometry
from .registration import appearance, moving_ends

PERTURBATION_SD_PX, PERTURBATION_SD_RAD = 1.0, 0.02
"""Standard deviations of the pose perturbations, px of the end's crop along each axis and rad: about the refiner's own
errors."""

MAX_CROPS = 480
"""Crops an end is fitted on; the normal equations are of this size."""

MIN_CROPS_PER_FRAME, MAX_CROPS_PER_FRAME = 4, 16
"""Crops of each frame: as many as `MAX_CROPS` allows, within these bounds."""

FOLDS = 5
"""Folds of the cross-validation; all crops of a frame are in one of them."""

RIDGE_GRID = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Ridge penalties that are tried, as shares of the crops' mean squared feature norm."""

MAX_UNEXPLAINED = 0.5
"""Largest share of the rotations' variance that may stay unexplained on held-out frames; beyond it the end is left to
the refiner."""


def fit_end_regression(
    images: Sequence[ImageArray],
    regions: Sequence[RegionOfInterest],
    xy: FloatArray,
    known: BoolArray,
    reference: Sequence[int],
    videos: Sequence[str],
    features: FirstStage,
    seed: int,
) -> EndRegressionNetwork | None:
    """Fit the end-pose regressor of the moving ends.

    Parameters
    ----------
    images : sequence of N (H, W, 3) uint8 arrays
        RGB.
    regions : sequence of N RegionOfInterest
    xy : (N, K, 2) float array
        Positions of the keypoints, px.
    known : (N, K) bool array
        Which of them are trusted.
    reference : sequence of K int
        From `roi.reference_keypoints`.
    videos : sequence of N str
        The video that each frame is from.
    features : FirstStage
        In evaluation mode; the regressor takes a copy of its weights.
    seed : int
        Of the perturbations and the changes of light.

    Returns
    -------
    EndRegressionNetwork or None
        On the device of `features`; None where no moving end's pose can be regressed from its crops.
    """
    geometry = FrameGeometry.of(regions, reference, videos)
    rng = np.random.default_rng([seed, 3])
    fitted: list[tuple[list[int], Tensor, Tensor, float]] = []
    for end, rows in moving_ends(xy, known, geometry):
        every = -(-len(rows) * MIN_CROPS_PER_FRAME // MAX_CROPS)
        used = rows[::every]
        crops = _EndCrops(
            [images[i] for i in used],
            [regions[i] for i in used],
            xy[np.ix_(used, end)],
            geometry.patch_scale[used],
            features,
        )
        solution = _ridge_regression(crops, rng)
        if solution is not None:
            fitted.append((end, *solution))
    if not fitted:
        return None
    regressor = EndRegressionNetwork(len(fitted))
    regressor.first.load_state_dict(features.state_dict())
    for number, (end, slope, rest, turn_sd_rad) in enumerate(fitted):
        regressor.ends[number] = torch.tensor(end)
        regressor.slope[number], regressor.rest[number] = slope, rest
        regressor.turn_sd_rad.append(turn_sd_rad)
    return regressor.to(features.mean.device).eval()


@dataclass(frozen=True)
class _EndCrops:
    """One end in N frames, and the crops of it.

    Attributes
    ----------
    images : sequence of N (H, W, 3) uint8 arrays
    regions : sequence of N RegionOfInterest
    ends : (N, 2, 2) float array
        The end's two keypoints, px.
    patch_scale : (N,) float array
        Patch px per frame px.
    features : FirstStage
    """

    images: Sequence[ImageArray]
    regions: Sequence[RegionOfInterest]
    ends: FloatArray
    patch_scale: FloatArray
    features: FirstStage

    def features_at(
        self, perturbation: FloatArray | None = None, light: np.random.Generator | None = None
    ) -> Tensor:
        """Features (N, C, h, w) of crops at the end's poses.

        Parameters
        ----------
        perturbation : (N, 3) float array, optional
            Moves the poses, as `crops.move_ends` takes it.
        light : numpy Generator, optional
            Changes each crop's light, blur and noise at random.
        """
        ends = self.ends if perturbation is None else move_ends(self.ends, perturbation, self.patch_scale)
        crops = [
            crop_end(image, end, region).image
            for image, end, region in zip(self.images, ends, self.regions, strict=True)
        ]
        if light is not None:
            crops = [change_image(crop, light) for crop in crops]
        batch = torch.from_numpy(stacked(crops))
        with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            features: Tensor = self.features(batch.to(self.features.mean.device))
        return features


def _ridge_regression(crops: _EndCrops, rng: np.random.Generator) -> tuple[Tensor, Tensor, float] | None:
    """Slope (3, C, h, w), intercept (3,) and turn's sd of an end, as `EndRegressionNetwork` has them.

    None where the rotation cannot be regressed on held-out frames (`MAX_UNEXPLAINED`).
    """
    n = len(crops.ends)
    mean, _, weight = appearance(crops.features_at())
    weight = weight.sqrt()
    unit = np.array([PERTURBATION_SD_PX, PERTURBATION_SD_PX, PERTURBATION_SD_RAD])
    perturbations, rows = [], []
    for repeat in range(int(np.clip(MAX_CROPS // n, MIN_CROPS_PER_FRAME, MAX_CROPS_PER_FRAME))):
        perturbations.append(rng.normal(size=(n, 3)))
        features = crops.features_at(unit * perturbations[-1], rng if repeat % 2 else None)
        rows.append(((features - mean) * weight).flatten(1))
    x = torch.cat(rows)
    rows.clear()
    middle = x.mean(dim=0)
    x = x - middle
    y = torch.from_numpy(-np.concatenate(perturbations)).to(x.device)
    # There are far fewer crops than features: the dual form solves for one weight a crop.
    gram = (x @ x.T).double()
    scale = float(gram.diagonal().mean())
    frame = torch.arange(len(x), device=x.device) % n
    errors = {ridge: _cross_validated_error(gram, y, frame % FOLDS, ridge * scale) for ridge in RIDGE_GRID}
    best = min(RIDGE_GRID, key=lambda ridge: float(errors[ridge].mean()))
    if not float(errors[best][2]) < MAX_UNEXPLAINED:
        return None
    per_unit = (x.T.double() @ _dual_weights(gram, y, best * scale)).T
    slope = per_unit * torch.from_numpy(unit).to(x.device)[:, None] * weight.flatten()
    intercept = -slope @ (mean.flatten() + middle / weight.flatten()).double()
    turn_sd_rad = PERTURBATION_SD_RAD * float(errors[best][2]) ** 0.5
    return slope.unflatten(1, mean.shape).float(), intercept.float(), turn_sd_rad


def _cross_validated_error(gram: Tensor, y: Tensor, fold: Tensor, penalty: float) -> Tensor:
    """Mean squared error (3,) of each crop's perturbation, predicted without the crops of its fold.

    Parameters
    ----------
    gram : (M, M) tensor
        Inner products of the crops' features.
    y : (M, 3) tensor
        What to predict, in standard deviations of the perturbations.
    fold : (M,) int tensor
    penalty : float
    """
    error = torch.zeros_like(y)
    for one in fold.unique():
        out = fold == one
        weights = _dual_weights(gram[~out][:, ~out], y[~out], penalty)
        error[out] = gram[out][:, ~out] @ weights - y[out]
    return (error**2).mean(dim=0)


def _dual_weights(gram: Tensor, y: Tensor, penalty: float) -> Tensor:
    """Weights (M, 3) of the crops in kernel ridge regression."""
    return torch.linalg.solve(gram + penalty * torch.eye(len(gram), device=gram.device), y)
