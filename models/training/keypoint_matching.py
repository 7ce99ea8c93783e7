"""Keypoint matching by image content: which of a project's keypoints a pretrained network knows, whatever their names.

The network finds its own keypoints in the labelled frames of a video (multi-frame consensus); each label that lies near
one of them, in the median over the frames, is that keypoint. Matching by name and order is in `transfer`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from ...tracker.errors import VideoError
from ...tracker.types import FloatArray, ImageArray
from ..localization.localize import MIN_INLIER_SHARE
from ..localization.probe_frames import multi_frame_consensus
from ..networks.checkpoint import Checkpoint
from .transfer import ENDS

MAX_DISTANCE = 0.1
"""Largest median distance of a label from the keypoint that it matches, in body lengths: points along the midline are
located to a twentieth of it, and are an eighth of it apart."""

MIDLINE_PENALTY = 0.03
"""Added to the distances, in body lengths, from keypoints along the midline: mostly ends are labelled, so a label near
both an end's keypoint and one of the midline matches the end."""

MIN_FRAMES, MAX_FRAMES = 4, 32
"""Frames of one video that are compared: fewer than the first do not show which end rests, the second are enough for
a median."""

MIN_LABELS = 3
"""Fewest labels of a keypoint among these frames that make a median."""


def match_keypoints(
    source: Checkpoint,
    keypoints: Sequence[str],
    labels: FloatArray,
    images: Sequence[ImageArray],
    videos: Sequence[str],
) -> dict[str, str]:
    """The source network's keypoint for each of ours that is labelled where the network finds one.

    Parameters
    ----------
    source : Checkpoint
        A pretrained network; for any other nothing matches.
    keypoints : sequence of K str
        Names of the project's keypoints.
    labels : (N, K, 2) float array
        px, NaN where not labelled.
    images : sequence of N (H, W, 3) uint8 arrays
        RGB.
    videos : sequence of N str
        The video that each frame is from; the one with the most labelled frames is used.

    Returns
    -------
    dict from str to str
        Empty where the frames are too few or show no actuator.
    """
    video, count = Counter(videos).most_common(1)[0]
    if not source.pretrained or count < MIN_FRAMES:
        return {}
    rows = [
        i
        for i, own in enumerate(videos)
        if own == video and images[i].shape == images[videos.index(video)].shape
    ]
    rows = rows[:: -(-len(rows) // MAX_FRAMES)]
    # Labelled frames are few, and chosen to be unlike each other: what moves between them is not asked.
    estimator = source.network.estimator(source.candidates)
    estimator = replace(estimator, stages=replace(estimator.stages, motion_evidence=False))
    try:
        consensus = multi_frame_consensus(np.stack([images[i] for i in rows]), source, estimator)
    except VideoError:
        return {}
    if consensus.inlier.mean() < MIN_INLIER_SHARE:
        return {}
    offset = labels[rows][consensus.inlier][:, :, None] - consensus.found.xy[consensus.inlier][:, None]
    distance = np.linalg.norm(offset, axis=-1) / consensus.body_px
    labelled = np.isfinite(distance[..., 0]).sum(axis=0) >= MIN_LABELS
    median = np.full(distance.shape[1:], np.inf)
    median[labelled] = np.nanmedian(distance[:, labelled], axis=0)
    penalty = MIDLINE_PENALTY * ~np.isin(source.keypoints, ENDS)
    # All pairs that are too far apart cost the same, so that they do not displace others in the assignment.
    ours, theirs = linear_sum_assignment(np.where(median <= MAX_DISTANCE, median, 1.0) + penalty)
    return {
        keypoints[k]: source.keypoints[known]
        for k, known in zip(ours, theirs, strict=True)
        if median[k, known] <= MAX_DISTANCE
    }
