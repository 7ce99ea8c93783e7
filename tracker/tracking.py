"""From a video and a detector to an angle table: decoding runs beside detection, every frame gets its row.

Knows no network: any `types.Detector` will do. Decoding is in `video.py`, what the detections mean in
`measuring.py`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from .angle import AngleDefinition
from .hashing import file_sha256
from .measuring import MIN_LIKELIHOOD, check_points, measure
from .read_ahead import read_ahead, side_by_side
from .results import AngleTable, json_ready
from .types import Detections, Detector, Flag, FloatArray, Frames, ImageArray, VideoDetector
from .video import Video

# Batches decoded ahead, beside those being used and one in the making.
_BATCHES_AHEAD = 1

Progress = Callable[[int, int | None], None]


@dataclass
class _Batch:
    """Consecutive frames: their times and states, and the pictures of those that could be decoded."""

    time_s: list[float] = field(default_factory=list)
    decoded: list[bool] = field(default_factory=list)
    damaged: list[bool] = field(default_factory=list)
    images: list[ImageArray] = field(default_factory=list)


def track(
    video: str | Path,
    detector: Detector,
    definition: AngleDefinition,
    *,
    min_likelihood: float = MIN_LIKELIHOOD,
    steady: bool = False,
    progress: Progress | None = None,
    video_sha256: str | None = None,
) -> AngleTable:
    """Find the keypoints in every frame of a video and measure the bending angle.

    Memory does not grow with the video, but for the table itself.

    Parameters
    ----------
    video : the video file
    detector : finds keypoints in frames; a `VideoDetector` follows them through stretches of the video
    definition : which angle, of which of the detector's keypoints
    min_likelihood : a row with a keypoint of the angle below this is flagged `low_likelihood`
    steady : whether a row whose neighbours say another angle is flagged `jump`
    progress : called after each batch with the number of frames done and the number claimed by the file
    video_sha256 : the file's hash where the caller knows it already

    Returns
    -------
    AngleTable
        With a row for every frame, flagged as `types.Flag` says, and its provenance.

    Raises
    ------
    VideoError
        The video cannot be read.
    AngleError
        The definition names a keypoint that the detector does not find.
    """
    check_points(detector.keypoints, definition)
    source = Video(video)
    k = len(detector.keypoints)
    batch_size, workers, detect = detector.batch_size, 1, detector.detect
    if isinstance(detector, VideoDetector):
        batch_size = detector.stretch_frames(source.size_wh, source.claimed_frames)
        workers = detector.workers
        detect = partial(_followed, detector)
    time_s: list[float] = []
    decoded: list[bool] = []
    damaged: list[bool] = []
    found: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    with (
        closing(read_ahead(_batches(source, batch_size), _BATCHES_AHEAD)) as batches,
        closing(side_by_side(lambda b: detect(b.images) if b.images else None, batches, workers)) as detected,
    ):
        for batch, detections in detected:
            if detections is not None:
                if detections.likelihood.shape != (len(batch.images), k):
                    raise ValueError(
                        f"expected detections of {len(batch.images)} frames and {k} keypoints, "
                        f"got {detections.likelihood.shape}"
                    )
                found.append((detections.xy, detections.likelihood, detections.covariance))
            time_s += batch.time_s
            decoded += batch.decoded
            damaged += batch.damaged
            if progress is not None:
                progress(len(time_s), source.claimed_frames)

    is_decoded = np.array(decoded)
    detections = Detections(
        xy=_scatter([xy for xy, _, _ in found], is_decoded, (k, 2)),
        likelihood=_scatter([likelihood for _, likelihood, _ in found], is_decoded, (k,)),
        covariance=_scatter([covariance for _, _, covariance in found], is_decoded, (k, 2, 2)),
    )
    rows = measure(
        detections,
        detector.keypoints,
        definition,
        source.size_wh,
        decoded=is_decoded,
        damaged=np.array(damaged),
        min_likelihood=min_likelihood,
        steady=steady,
    )
    provenance = {
        "bendtrack": version("bendtrack"),
        "video": {
            # Linux allows names that are no text: what is not becomes a question mark.
            "name": os.fsencode(source.path.name).decode("utf-8", "replace"),
            "sha256": video_sha256 or file_sha256(source.path),
            "size_wh": source.size_wh,
            "rotation_deg": source.rotation_deg,
            "codec": source.codec,
            "frame_rate": source.frame_rate,
            "frames_claimed": source.claimed_frames,
            "frames": len(time_s),
            "frames_decoded": int(is_decoded.sum()),
            "frames_undecodable": int((~is_decoded).sum()),
            "frames_damaged": int(np.sum(damaged)),
            "complete": source.complete,
        },
        "detector": detector.provenance,
        "settings": tracking_settings(definition, min_likelihood, steady),
        "warnings": source.warnings,
        "rows": {kind.value or "sound": int((rows.flag == kind).sum()) for kind in Flag},
    }
    return AngleTable(
        time_s=np.array(time_s),
        angle_deg=rows.angle_deg,
        angle_sd_deg=rows.angle_sd_deg,
        flag=rows.flag,
        xy=detections.xy,
        likelihood=detections.likelihood,
        covariance=detections.covariance,
        keypoints=detector.keypoints,
        definition=definition,
        provenance=json_ready(provenance),
    )


def tracking_settings(
    definition: AngleDefinition, min_likelihood: float = MIN_LIKELIHOOD, steady: bool = False
) -> dict[str, Any]:
    """What besides video and detector decides the table; recorded in it and compared by `is_up_to_date`."""
    asked = {"angle": asdict(definition), "min_likelihood": min_likelihood}
    settings: dict[str, Any] = json_ready(asked | ({"steady": True} if steady else {}))
    return settings


def _followed(detector: VideoDetector, frames: Frames) -> Detections:
    """What is found in a stretch, by itself: the same, however many are worked on at once."""
    return detector.follow().detect(frames)


def _batches(source: Video, batch_size: int) -> Generator[_Batch, None, None]:
    """Frames in batches of at most `batch_size` pictures, converted to RGB here, beside the detector."""
    batch = _Batch()
    for frame in source:
        batch.time_s.append(frame.time_s)
        batch.decoded.append(frame.decoded is not None)
        batch.damaged.append(frame.damaged)
        if frame.image is not None:
            batch.images.append(frame.image)
        # Counted by rows, so that a long undecodable stretch does not pile up either.
        if len(batch.time_s) == batch_size:
            yield batch
            batch = _Batch()
    if batch.time_s:
        yield batch


def _scatter(found: list[FloatArray], is_decoded: np.ndarray, shape: tuple[int, ...]) -> FloatArray:
    """What was found in the decoded frames at its rows (T, ...), NaN in between."""
    values = np.full((len(is_decoded), *shape), np.nan)
    if found:
        values[is_decoded] = np.concatenate(found)
    return values
