"""A closer look at the moving end of an actuator that nobody has labelled.

What is seen of it in frames spread over a video is laid over each other (`learning.registration`), and from there it is
learnt how it lies in closer pictures (`learning.alignment`), as in a training; only that no label says where it lies
on average.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..tracker.types import BoolArray, FloatArray, Frames
from .aligner import EndAligner
from .finding.regions import WorkingRegion
from .learning.alignment import learn_alignment
from .learning.dataset import prepare
from .learning.registration import registered, shipped_features

SEED = 0
"""The same video is measured the same way again."""


def closer_look(
    glimpses: Frames,
    xy: FloatArray,
    same: BoolArray,
    region: WorkingRegion,
    partner: Sequence[int],
    device: str = "cpu",
) -> tuple[FloatArray, EndAligner | None]:
    """Positions with the moving end's laid over each other, and what tells how it lies; None where pictures do not.

    Parameters
    ----------
    glimpses : (N, H, W, 3) uint8 RGB
    xy : (N, K, 2) px, found in them; the last two keypoints are the moving end
    same : (N,) bool, the frames that count; in the others nothing moves
    region : of frames of this size
    partner : from `regions.partners`
    device : where it is computed, and where the aligner is afterwards
    """
    features = shipped_features().to(device)
    rows = np.flatnonzero(same).tolist()
    pictures, regions, video = [glimpses[i] for i in rows], [region] * len(rows), ["glimpses"] * len(rows)
    moving = np.zeros((len(rows), xy.shape[1]), bool)
    moving[:, -2:] = True
    frames = [prepare(picture, own, region) for picture, own in zip(pictures, xy[rows], strict=True)]
    better = xy.copy()
    better[rows] = registered(frames, xy[rows], moving, partner, video, features)
    aligner = learn_alignment(pictures, regions, better[rows], moving, partner, video, features, SEED)
    return better, aligner
