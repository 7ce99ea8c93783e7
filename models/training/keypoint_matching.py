"""Which of a project's keypoints a pretrained network knows already, told by the first labels where no name says it.

What it finds in the labelled frames of a video, held against each other as glimpses of any video are, lies near some of
the labels: these are its keypoints, whatever they are called and in whichever order.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...tracker.errors import VideoError
from ...tracker.types import FloatArray, ImageArray
from ..localization.localize import MIN_INLIER_SHARE
from ..localization.probe_frames import multi_frame_consensus
from ..networks.checkpoint import Checkpoint
from .transfer import ENDS

NEAR = 0.1
"""A label is of a known keypoint that lies within so much of the body's length, in the median over the frames: points
along the midline are found a twentieth of it off, and lie an eighth of it apart."""

ENDS_FIRST = 0.03
"""What is near an end's point and a midline's is the end's, unless it is nearer to the midline's by so much of the
body's length: it is ends that are mostly labelled."""

LEAST_FRAMES, MOST_FRAMES = 4, 32
"""Frames of one video by which that is told: fewer do not tell which end rests."""

LEAST_TIMES = 3
"""Labels of a keypoint among them that make a median."""


def match_keypoints(
    source: Checkpoint,
    keypoints: Sequence[str],
    labels: FloatArray,
    pictures: Sequence[ImageArray],
    videos: Sequence[str],
) -> dict[str, str]:
    """The network's keypoint for each of ours that is labelled where the network finds one.

    Parameters
    ----------
    parent : a network; of one that was not pretrained nothing is said
    keypoints : names of the K keypoints
    labels : (N, K, 2) px, NaN where not labelled
    pictures : RGB uint8 (H, W, 3), N of them
    videos : which video each is from; the one with the most labels counts
    """
    video, count = Counter(videos).most_common(1)[0]
    if not source.pretrained or count < LEAST_FRAMES:
        return {}
    rows = [
        i
        for i, own in enumerate(videos)
        if own == video and pictures[i].shape == pictures[videos.index(video)].shape
    ]
    rows = rows[:: -(-len(rows) // MOST_FRAMES)]
    try:
        consensus = multi_frame_consensus(
            np.stack([pictures[i] for i in rows]), source, source.network.estimator(source.candidates)
        )
    except VideoError:
        return {}
    if consensus.inlier.mean() < MIN_INLIER_SHARE:
        return {}
    away = labels[rows][consensus.inlier][:, :, None] - consensus.found.xy[consensus.inlier][:, None]
    apart = np.linalg.norm(away, axis=-1) / consensus.body_px
    labelled = np.isfinite(apart[..., 0]).sum(axis=0) >= LEAST_TIMES
    usual = np.full(apart.shape[1:], np.inf)
    usual[labelled] = np.nanmedian(apart[:, labelled], axis=0)
    midline = ENDS_FIRST * ~np.isin(source.keypoints, ENDS)
    # What is near nothing is not to push others away.
    ours, theirs = linear_sum_assignment(np.where(usual <= NEAR, usual, 1.0) + midline)
    return {
        keypoints[k]: source.keypoints[known]
        for k, known in zip(ours, theirs, strict=True)
        if usual[k, known] <= NEAR
    }
