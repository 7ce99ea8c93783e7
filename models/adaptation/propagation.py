"""Label propagation: from a few labelled frames of a video to its other frames.

A pretrained network knows actuators in general. One to four labelled frames say which actuator of the video is meant,
where it is held, and where on it the keypoints lie. The network finds the actuator in frames spread over the video
(`localization/probe_frames.py`), is fitted to it (`adapt.py`), and each keypoint is put where the labels have it
relative to the end that it belongs to. These frames are then trained on like labelled ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...tracker.errors import VideoError
from ...tracker.types import BoolArray, FloatArray, ImageArray
from ..inference.calibration import turn_shrinkage
from ..inference.coarse_to_fine import CoarseToFineEstimator
from ..inference.metadata import CheckpointMetadata
from ..inference.roi import turned
from ..localization.localize import FitEnds, FitNetwork, fit_where_unsure
from ..localization.probe_frames import (
    FIXED,
    MOVING,
    Consensus,
    KnownEnds,
    inlier_mask,
    lengths_px,
    multi_frame_consensus,
)

MAX_LABELS = 4
"""Labelled frames of a video up to which its other frames help. From five on a training learns the ends' poses from
the labels alone."""

MAX_ARC_RAD = np.deg2rad(170.0)
"""Largest turn between both ends that gives the body's length: near a whole half turn the chord says little."""


@dataclass(frozen=True)
class PropagatedLabels:
    """Positions in the probe frames of a video that stand for labels.

    Attributes
    ----------
    xy : ndarray of float, shape (N, K, 2)
        px; NaN in the frames that are not sure, and of keypoints that belong to no end.
    sure : ndarray of bool, shape (N,)
    """

    xy: FloatArray
    sure: BoolArray


def propagate_labels(
    source: CheckpointMetadata,
    estimator: CoarseToFineEstimator,
    mapping: Mapping[str, str],
    keypoints: Sequence[str],
    labelled_images: ImageArray,
    labels: FloatArray,
    probe_frames: ImageArray,
    fit_ends: FitEnds | None = None,
    fit_network: FitNetwork | None = None,
) -> PropagatedLabels | None:
    """Find in probe frames what is labelled in a few frames of the same video.

    Parameters
    ----------
    source, estimator
        A pretrained network's metadata and networks.
    mapping : mapping from str to str
        The network's keypoint for each of ours (`training.transfer.keypoint_mapping`); both ends' are needed.
    keypoints : sequence of K str
        Ours.
    labelled_images : ndarray of uint8, shape (L, H, W, 3)
        RGB.
    labels : ndarray of float, shape (L, K, 2)
        px, NaN where not labelled.
    probe_frames : ndarray of uint8, shape (N, H, W, 3)
        RGB, of the same size.
    fit_ends, fit_network : callable, optional
        As `find_actuator`'s.

    Returns
    -------
    PropagatedLabels or None
        None where an end is not labelled, or the actuator is not found in enough frames.
    """
    ends = _columns_of_ends(source, mapping, keypoints)
    if ends is None:
        return None
    whole = ~np.isnan(labels[:, ends]).any(axis=(1, 2))
    if not whole.any():
        return None
    images, ours = labelled_images[whole], labels[whole][:, ends]
    frames = np.concatenate([images, probe_frames])
    known = _known_ends(ours, len(source.keypoints))
    try:
        consensus = multi_frame_consensus(frames, source, estimator, known)
    except VideoError:
        return None
    pseudo = consensus.pseudo_labels(frames, source, estimator)
    if fit_network is not None:
        before = consensus
        estimator, consensus = fit_where_unsure(
            frames, source, (estimator, consensus), pseudo, fit_network, known
        )
        if consensus is not before:
            pseudo = consensus.pseudo_labels(frames, source, estimator)
    return _as_labelled(consensus, pseudo.positive, frames, ours, ends, len(keypoints), fit_ends)


def _as_labelled(
    consensus: Consensus,
    sure: BoolArray,
    frames: ImageArray,
    ours: FloatArray,
    ends: list[int],
    k: int,
    fit_ends: FitEnds | None,
) -> PropagatedLabels | None:
    """The sure probe frames of a consensus with our keypoints, from the labels (L, 4, 2) in its first frames."""
    count = len(ours)
    if not sure[count:].any():
        return None
    found = consensus.found.xy
    if fit_ends is not None:
        found, _ = fit_ends(frames, found, consensus.inlier, consensus.view.region)
    # What the network does not find in a labelled frame says nothing of how the labels differ from it.
    seen = inlier_mask(found[:count], consensus.fixed_xy, consensus.body_px, consensus.end_px)
    if not seen.any():
        return None
    moving = _placed(found[:, MOVING], found[:count, MOVING][seen], ours[seen][:, 2:])
    base = np.median(found[consensus.inlier][:, FIXED], axis=0)[None]
    fixed = _placed(base, np.repeat(base, count, axis=0), ours[:, :2])
    xy = np.full((len(frames) - count, k, 2), np.nan)
    own = sure[count:]
    rows = np.flatnonzero(own).tolist()
    xy[np.ix_(rows, ends[:2])] = fixed
    xy[np.ix_(rows, ends[2:])] = moving[count:][own]
    return PropagatedLabels(xy, own)


def _columns_of_ends(
    source: CheckpointMetadata, mapping: Mapping[str, str], keypoints: Sequence[str]
) -> list[int] | None:
    """Our columns of the first two and the last two keypoints of the network's chain."""
    ours = {known: column for column, name in enumerate(keypoints) if (known := mapping.get(name))}
    wanted = (*source.keypoints[:2], *source.keypoints[-2:])
    return [ours[name] for name in wanted] if all(name in ours for name in wanted) else None


def _known_ends(labels: FloatArray, keypoints: int) -> KnownEnds:
    """From labels (L, 4, 2) px of both ends, for a chain of so many keypoints."""
    base, tip = labels[:, 1] - labels[:, 0], labels[:, 3] - labels[:, 2]
    cross, dot = base[:, 0] * tip[:, 1] - base[:, 1] * tip[:, 0], (base * tip).sum(axis=1)
    half = np.minimum(np.abs(np.arctan2(cross, dot)), MAX_ARC_RAD) / 2
    chord = np.linalg.norm(labels[:, 3] - labels[:, 0], axis=1)
    # An arc is longer than its chord by x / sin x, where x is half its turn.
    body_px = float(np.median(chord / np.sinc(half / np.pi)))
    xy = np.full((len(labels), keypoints, 2), np.nan)
    xy[:, FIXED], xy[:, MOVING] = labels[:, :2], labels[:, 2:]
    return KnownEnds(labels[:, 0].mean(axis=0), body_px, np.arange(len(labels)), xy)


def _placed(ends: FloatArray, seen: FloatArray, labels: FloatArray) -> FloatArray:
    """Ends (N, 2, 2) px of the network as they are labelled.

    From labels (L, 2, 2) px of ends that the network sees at `seen` (L, 2, 2) px: both points keep their mean place
    relative to the network's end; how far they are turned about their centre is shrunk, for clicks are noisy.
    """
    turn = np.angle(np.exp(1j * (_direction(labels) - _direction(seen))))
    end_px = max(float(lengths_px(labels).mean()), 1.0)
    turn_rad = float(np.mean(turn)) * turn_shrinkage(len(labels), end_px)
    centre = turned(labels.mean(axis=1) - seen.mean(axis=1), -_direction(seen)).mean(axis=0)
    direction = _direction(ends)
    middle = ends.mean(axis=1) + turned(np.broadcast_to(centre, (len(ends), 2)), direction)
    half = end_px / 2 * np.stack([np.cos(direction + turn_rad), np.sin(direction + turn_rad)], axis=1)
    return np.stack([middle - half, middle + half], axis=1)


def _direction(ends: FloatArray) -> FloatArray:
    """Direction (N,) of ends (N, 2, 2) px, rad from x toward y."""
    along = ends[:, 1] - ends[:, 0]
    return np.asarray(np.arctan2(along[:, 1], along[:, 0]))
