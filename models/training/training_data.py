"""The data of one training: labelled frames in memory, split into those trained on and those held out.

Nothing here changes while a training runs; the positions trained on (targets) are the trainer's.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...tracker.errors import LabelError
from ...tracker.types import FloatArray, ImageArray, LabelledFrame
from ..data.images import frame_id, read_image
from ..data.prepared import PreparedFrame, prepare
from ..inference.roi import RegionOfInterest, reference_keypoints, regions_of_interest
from .settings import TrainingSettings
from .split import split


@dataclass(frozen=True)
class TrainingData:
    """N labelled frames of K keypoints.

    Attributes
    ----------
    frames : sequence of N LabelledFrame
    keypoints : tuple of K str
    images : sequence of N (H, W, 3) uint8 arrays
        RGB, as they were read: validation cuts its crops from them as inference does.
    prepared : sequence of N PreparedFrame
        The same frames at both networks' scales.
    labels : (N, K, 2) float array
        px, NaN where not labelled.
    regions : tuple of RegionOfInterest
        One for each frame size.
    reference : tuple of K int
        From `roi.reference_keypoints`.
    trained, held_out : list of int
        Indices of the frames trained on, and of those that validate.
    """

    frames: Sequence[LabelledFrame]
    keypoints: tuple[str, ...]
    images: Sequence[ImageArray]
    prepared: Sequence[PreparedFrame]
    labels: FloatArray
    regions: tuple[RegionOfInterest, ...]
    reference: tuple[int, ...]
    trained: list[int]
    held_out: list[int]

    def end_px(self, rows: Sequence[int]) -> float:
        """Median distance between the two points of an end in some frames, px; 1 where none shows both."""
        pairs = [(k, p) for k, p in enumerate(self.reference) if k < p and self.reference[p] == k]
        apart = [np.linalg.norm(self.labels[i, p] - self.labels[i, k]) for i in rows for k, p in pairs]
        known = [length for length in apart if np.isfinite(length)]
        return float(np.median(known)) if known else 1.0

    def identity(self, settings: TrainingSettings) -> str:
        """SHA-256 of everything that a resumed training must have in common with the stopped one."""
        return settings_and_labels_sha256(self.frames, self.keypoints, settings)


def settings_and_labels_sha256(
    frames: Sequence[LabelledFrame], keypoints: Sequence[str], settings: TrainingSettings
) -> str:
    """SHA-256 of what a network is trained with, which its checkpoint records.

    Parameters
    ----------
    frames : sequence of LabelledFrame
        Those without any label do not count.
    keypoints : sequence of str
    settings : TrainingSettings
        The time limit does not count.
    """
    own = {**settings.to_dict(), "max_minutes": None}
    digest = hashlib.sha256(json.dumps([own, list(keypoints)], sort_keys=True).encode())
    for frame in frames:
        if not np.isnan(frame.xy).all():
            digest.update(f"{frame_id(frame)} {frame.actuator}".encode())
            digest.update(np.ascontiguousarray(frame.xy, dtype=np.float64).tobytes())
    return digest.hexdigest()


def load_training_data(
    frames: Sequence[LabelledFrame], keypoints: Sequence[str], settings: TrainingSettings
) -> TrainingData:
    """Read and prepare labelled frames.

    Parameters
    ----------
    frames : sequence of LabelledFrame
        Those without any label are skipped.
    keypoints : sequence of K str
    settings : TrainingSettings
        Its `held_out` and `seed` decide the split.

    Returns
    -------
    TrainingData

    Raises
    ------
    LabelError
        No frame has a label, a keypoint is labelled nowhere, or an image cannot be read.
    """
    labelled = [frame for frame in frames if not np.isnan(frame.xy).all()]
    if not labelled:
        raise LabelError(f"training: expected frames with labels, got {len(frames)} without any")
    missing = [n for k, n in enumerate(keypoints) if all(np.isnan(f.xy[k]).any() for f in labelled)]
    if missing:
        raise LabelError(
            f"training: expected every keypoint in some frame, got none for {', '.join(missing)}"
        )
    trained, held_out = split(labelled, settings.held_out, settings.seed)
    images = [read_image(frame) for frame in labelled]
    sizes = [(image.shape[1], image.shape[0]) for image in images]
    labels = np.stack([frame.xy for frame in labelled]).astype(np.float64)
    regions = regions_of_interest(labels, sizes)
    by_size = {region.frame_wh: region for region in regions}
    return TrainingData(
        frames=labelled,
        keypoints=tuple(keypoints),
        images=images,
        prepared=[prepare(i, xy, by_size[size]) for i, xy, size in zip(images, labels, sizes, strict=True)],
        labels=labels,
        regions=regions,
        reference=tuple(reference_keypoints(labels)),
        trained=trained,
        held_out=held_out,
    )
