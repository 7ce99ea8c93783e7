"""Learning how a moving end lies in a closer picture of it: a linear regression on what a network's first stage sees.

A patch shows an end at the scale at which a network finds it anywhere and in any state; the closer picture, cut where
it was found, shows twice as much detail of what little is left to be told. As in supervised descent (Xiong & De la
Torre 2013) pictures are cut a little off in all labelled frames, half of them changed as in other light, and how far
off they are is regressed on them. How strongly it is held back is judged on frames that it has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..data.augmentation import change_picture
from ..inference.affine import stacked
from ..inference.crops import crop_end, move_ends
from ..inference.roi import RegionOfInterest
from ..networks.end_regressor import EndRegressionNetwork
from ..networks.heatmap_network import FirstStage
from .registration import appearance, moving_ends

OFF_PX, OFF_RAD = 1.0, 0.02
"""Standard deviations of how far off pictures are cut, in their px and radians: about as far as ends are found."""

PICTURES = 480
MOST_OF_A_FRAME, LEAST_OF_A_FRAME = 16, 4
"""Pictures to learn an end from, and how many of each frame."""

FOLDS = 5
RIDGES = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Ridge penalties that are tried, as shares of the pictures' mean square."""

UNEXPLAINED = 0.5
"""An end of which so much of the turns' variance stays unexplained, in frames that were not learnt from, is left to
the network."""


def fit_end_regression(
    pictures: Sequence[ImageArray],
    regions: Sequence[RegionOfInterest],
    xy: FloatArray,
    known: BoolArray,
    reference: Sequence[int],
    videos: Sequence[str],
    features: FirstStage,
    seed: int,
) -> EndRegressionNetwork | None:
    """An aligner of the moving ends; None where there are none whose pictures tell how they lie.

    Parameters
    ----------
    pictures, regions : of N frames
    xy : (N, K, 2) px, where the keypoints are
    known : (N, K), which positions are believed
    partner : from `regions.partners`
    videos : which video each of the frames is from
    features : what ends are told by, in evaluation mode
    """
    rng = np.random.default_rng([seed, 3])
    learnt: list[tuple[list[int], Tensor, Tensor]] = []
    for end, rows in moving_ends(xy, known, reference, videos):
        every = -(-len(rows) * LEAST_OF_A_FRAME // PICTURES)
        some = rows[::every]
        shown = _Shown(
            [pictures[i] for i in some], [regions[i] for i in some], xy[np.ix_(some, end)], features
        )
        found = _regression(shown, rng)
        if found is not None:
            learnt.append((end, *found))
    if not learnt:
        return None
    aligner = EndRegressionNetwork(len(learnt))
    aligner.first.load_state_dict(features.state_dict())
    for number, (end, slope, rest) in enumerate(learnt):
        aligner.ends[number] = torch.tensor(end)
        aligner.slope[number], aligner.rest[number] = slope, rest
    return aligner.to(features.mean.device).eval()


class _Shown:
    """One end in N frames, and what is seen of it."""

    def __init__(
        self,
        pictures: Sequence[ImageArray],
        regions: Sequence[RegionOfInterest],
        ends: FloatArray,
        features: FirstStage,
    ) -> None:
        self.pictures, self.regions, self.ends, self.features = pictures, regions, ends, features
        self.patch_scale = np.array([region.refiner_scale for region in regions])

    def seen(self, off: FloatArray | None = None, light: np.random.Generator | None = None) -> Tensor:
        """Features (N, C, h, w) of pictures cut `off` (N, 3) where the end is, in other light where there is one."""
        ends = self.ends if off is None else move_ends(self.ends, off, self.patch_scale)
        cut = [
            crop_end(picture, end, region).image
            for picture, end, region in zip(self.pictures, ends, self.regions, strict=True)
        ]
        if light is not None:
            cut = [change_picture(picture, light) for picture in cut]
        images = torch.from_numpy(stacked(cut))
        with torch.inference_mode(), torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            features: Tensor = self.features(images.to(self.features.mean.device))
        return features


def _regression(shown: _Shown, rng: np.random.Generator) -> tuple[Tensor, Tensor] | None:
    """Slope (3, C, h, w) and rest (3,) of an end, as `EndRegressionNetwork`'s; None where pictures do not tell how it lies."""
    n = len(shown.ends)
    mean, _, weight = appearance(shown.seen())
    weight = weight.sqrt()
    unit = np.array([OFF_PX, OFF_PX, OFF_RAD])
    off, rows = [], []
    for turn in range(int(np.clip(PICTURES // n, LEAST_OF_A_FRAME, MOST_OF_A_FRAME))):
        off.append(rng.normal(size=(n, 3)))
        seen = shown.seen(unit * off[-1], rng if turn % 2 else None)
        rows.append(((seen - mean) * weight).flatten(1))
    x = torch.cat(rows)
    rows.clear()
    middle = x.mean(dim=0)
    x = x - middle
    y = torch.from_numpy(-np.concatenate(off)).to(x.device)
    square = (x @ x.T).double()
    scale = float(square.diagonal().mean())
    frame = torch.arange(len(x), device=x.device) % n
    errors = {ridge: _error_elsewhere(square, y, frame % FOLDS, ridge * scale) for ridge in RIDGES}
    ridge = min(RIDGES, key=lambda one: float(errors[one].mean()))
    if not float(errors[ridge][2]) < UNEXPLAINED:
        return None
    per_unit = (x.T.double() @ _solved(square, y, ridge * scale)).T
    slope = per_unit * torch.from_numpy(unit).to(x.device)[:, None] * weight.flatten()
    rest = -slope @ (mean.flatten() + middle / weight.flatten()).double()
    return slope.unflatten(1, mean.shape).float(), rest.float()


def _error_elsewhere(square: Tensor, y: Tensor, fold: Tensor, penalty: float) -> Tensor:
    """Mean square errors (3,) of rows of which none of the same frame was learnt from."""
    error = torch.zeros_like(y)
    for own in fold.unique():
        out = fold == own
        weights = _solved(square[~out][:, ~out], y[~out], penalty)
        error[out] = square[out][:, ~out] @ weights - y[out]
    return (error**2).mean(dim=0)


def _solved(square: Tensor, y: Tensor, penalty: float) -> Tensor:
    return torch.linalg.solve(square + penalty * torch.eye(len(square), device=square.device), y)
