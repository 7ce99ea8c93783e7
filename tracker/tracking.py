"""From a video and a detector to an angle table: decoding runs in parallel with detection, every frame gets its row.

Independent of any network: takes any `types.Detector`. Decoding is in `video.py`, the angle and its flags in
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

from .angle import AngleDefinition, bending_angle
from .hashing import file_sha256
from .measuring import MIN_LIKELIHOOD, check_points, measure
from .prefetch import parallel_map, read_ahead
from .results import AngleTable, json_ready
from .types import (
    Detections,
    Detector,
    FilmCalibratedDetector,
    Flag,
    FloatArray,
    Frames,
    ImageArray,
    ReportingDetector,
    TrainedDetector,
    VideoDetector,
)
from .video import Video

# Batches decoded ahead of those in use, in addition to the one being decoded.
_BATCHES_AHEAD = 1

Progress = Callable[[int, int | None], None]


@dataclass
class _Batch:
    """Consecutive frames: their times and states, and the images of those that could be decoded."""

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
    check_jumps: bool = False,
    progress: Progress | None = None,
    video_sha256: str | None = None,
) -> AngleTable:
    """Find the keypoints in every frame of a video and measure the bending angle.

    Memory does not grow with the length of the video, except for the table itself.

    Parameters
    ----------
    video : str or Path
        The video file.
    detector : Detector
        Finds keypoints in frames; a `VideoDetector` is given the video in chunks of consecutive frames.
    definition : AngleDefinition
        Which angle, of which of the detector's keypoints.
    min_likelihood : float, optional
        A row with a keypoint of the angle below this is flagged `low_likelihood`.
    check_jumps : bool, optional
        Whether the temporal-consistency check runs: a row whose angle differs from those of the frames around it
        is flagged `jump`.
    progress : Progress or None, optional
        Called after each batch with the number of frames done and the number claimed by the file.
    video_sha256 : str or None, optional
        SHA-256 of the file, where the caller has computed it already.

    Returns
    -------
    AngleTable
        One row for every frame, flagged as `types.Flag` defines, and its provenance.

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
        batch_size = detector.chunk_frames(source.size_wh, source.claimed_frames)
        workers = detector.workers
        detect = partial(_detect_chunk, detector)
    time_s: list[float] = []
    decoded: list[bool] = []
    damaged: list[bool] = []
    found: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    with (
        closing(read_ahead(_batches(source, batch_size), _BATCHES_AHEAD)) as batches,
        closing(parallel_map(lambda b: detect(b.images) if b.images else None, batches, workers)) as detected,
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

    for index in source.doubtful:
        damaged[index] = True
    is_decoded = np.array(decoded)
    detections = Detections(
        xy=_scatter([xy for xy, _, _ in found], is_decoded, (k, 2)),
        likelihood=_scatter([likelihood for _, likelihood, _ in found], is_decoded, (k,)),
        covariance=_scatter([covariance for _, _, covariance in found], is_decoded, (k, 2, 2)),
    )
    findings = dict(detector.findings) if isinstance(detector, ReportingDetector) else {}
    if isinstance(detector, FilmCalibratedDetector):
        detections, of_film = detector.film_calibrated(detections)
        findings |= of_film
    rows = measure(
        detections,
        detector.keypoints,
        definition,
        source.size_wh,
        decoded=is_decoded,
        damaged=np.array(damaged),
        min_likelihood=min_likelihood,
        check_jumps=check_jumps,
        correlations=detector.correlations if isinstance(detector, TrainedDetector) else (),
    )
    provenance = {
        "bendtrack": version("bendtrack"),
        "video": {
            # Linux allows names that are not text: invalid bytes become a replacement character.
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
        **({"findings": findings} if findings else {}),
        "settings": tracking_settings(definition, min_likelihood, check_jumps),
        "warnings": source.warnings,
        "uncertainty": _components(detector, definition, detections.xy, rows.angle_sd_deg),
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


def _components(
    detector: Detector, definition: AngleDefinition, xy: FloatArray, sd_deg: FloatArray
) -> dict[str, float] | None:
    """The two parts of the angle's standard deviation, each as its median over the frames; None without labels.

    The error that the labels leave is one offset of the whole film; the rest scatters from frame to frame.
    """
    if not isinstance(detector, TrainedDetector) or not detector.label_variance_px2:
        return None
    of_labels = np.broadcast_to(np.eye(2) * detector.label_variance_px2, (*xy.shape, 2))
    _, offset_deg, _ = bending_angle(xy, detector.keypoints, definition, of_labels)
    known = np.isfinite(sd_deg) & np.isfinite(offset_deg)
    if not known.any():
        return None
    scatter_deg = np.sqrt(np.maximum(sd_deg[known] ** 2 - offset_deg[known] ** 2, 0.0))
    return {
        "offset_sd_deg": float(np.median(offset_deg[known])),
        "scatter_sd_deg": float(np.median(scatter_deg)),
    }


def tracking_settings(
    definition: AngleDefinition, min_likelihood: float = MIN_LIKELIHOOD, check_jumps: bool = False
) -> dict[str, Any]:
    """Settings that determine a table, apart from video and detector; recorded, and compared by `is_up_to_date`.

    Parameters
    ----------
    definition : AngleDefinition
        Which angle, of which keypoints.
    min_likelihood : float, optional
        Threshold of the flag `low_likelihood`.
    check_jumps : bool, optional
        Whether the temporal-consistency check runs.

    Returns
    -------
    dict of str to Any
        JSON-ready settings; the check is recorded under the key `steady`, and only where it runs.
    """
    settings = {"angle": asdict(definition), "min_likelihood": min_likelihood}
    recorded: dict[str, Any] = json_ready(settings | ({"steady": True} if check_jumps else {}))
    return recorded


def _detect_chunk(detector: VideoDetector, frames: Frames) -> Detections:
    """Detections in a chunk, independent of other chunks: the same for any number of workers."""
    return detector.follow().detect(frames)


def _batches(source: Video, batch_size: int) -> Generator[_Batch, None, None]:
    """Frames in batches of at most `batch_size`, converted to RGB in this thread, in parallel with the detector."""
    batch = _Batch()
    for frame in source:
        batch.time_s.append(frame.time_s)
        batch.decoded.append(frame.decoded is not None)
        batch.damaged.append(frame.damaged)
        if frame.image is not None:
            batch.images.append(frame.image)
        # Counted by rows, so that a long run of undecodable frames does not accumulate either.
        if len(batch.time_s) == batch_size:
            yield batch
            batch = _Batch()
    if batch.time_s:
        yield batch


def _scatter(found: list[FloatArray], is_decoded: np.ndarray, shape: tuple[int, ...]) -> FloatArray:
    """Values of the decoded frames at their rows (T, ...), NaN at the other rows."""
    values = np.full((len(is_decoded), *shape), np.nan)
    if found:
        values[is_decoded] = np.concatenate(found)
    return values
