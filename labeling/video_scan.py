"""One pass over a video that keeps a few frame descriptors of every pose, in memory independent of its length.

Which of these frames become images to label is decided in `selection.py`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from contextlib import closing
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np

from ..tracker.prefetch import read_ahead
from ..tracker.video import Video
from .frame_descriptors import DescriptorExtractor, FrameDescriptor
from .pressure_signal import PressureSignal
from .stream_clustering import AppearanceClusters, BinnedClusters, Cluster

Progress = Callable[[int, int | None], None]

# Of a longer video all frames are decoded and one in n is sampled. Which one is random: a fixed stride could be in
# phase with a periodic motion.
_MAX_SAMPLED_FRAMES = 10_000
_FRAMES_AHEAD = 16
DECODING_THREADS = min(4, os.cpu_count() or 1)
# Clusters kept for all videos of a run together, and at least for each. A cluster takes up to 60 kB.
_MAX_CLUSTERS, _MIN_CLUSTERS = 1200, 60
_TIME_BIN_S = 0.05  # bin width at first; it doubles when there are too many bins
_PRESSURE_BINS = 200  # bins over the range of pressure


class SampleBy(StrEnum):
    """The quantity over which selected frames are spread evenly."""

    PRESSURE = "pressure"
    APPEARANCE = "appearance"
    TIME = "time"


@dataclass(frozen=True)
class VideoScan:
    """Frame descriptors of one video.

    Attributes
    ----------
    video : Path
        The video file.
    clusters : list of Cluster
        Its poses, each a cluster of similar frames.
    known : list of FrameDescriptor
        Descriptors of the frames that have been extracted before.
    duration_s : float
        Time of its last frame, s.
    warnings : list of str
        Warnings of the video reader.
    """

    video: Path
    clusters: list[Cluster]
    known: list[FrameDescriptor]
    duration_s: float
    warnings: list[str]


def clusters_for(
    by: SampleBy, n_videos: int, pressure: PressureSignal | None = None
) -> AppearanceClusters | BinnedClusters:
    """Create the empty clusters for one of several videos.

    Parameters
    ----------
    by : SampleBy
        Quantity over which frames are spread.
    n_videos : int
        Number of videos that share the memory.
    pressure : PressureSignal or None, optional
        Pressure over the video's time; needed for `SampleBy.PRESSURE`.

    Returns
    -------
    AppearanceClusters or BinnedClusters
        Clusters without frames.
    """
    limit = max(_MIN_CLUSTERS, _MAX_CLUSTERS // n_videos)
    if by is SampleBy.APPEARANCE:
        return AppearanceClusters(limit)
    if pressure is None:
        return BinnedClusters(lambda time_s: (time_s, 0), _TIME_BIN_S, limit)
    return BinnedClusters(
        pressure.at, max(pressure.range_kpa / _PRESSURE_BINS, 1e-6), max(limit, 2 * _PRESSURE_BINS + 2)
    )


def scan_video(
    video: str | Path,
    clusters: AppearanceClusters | BinnedClusters,
    *,
    known: Collection[int] = (),
    progress: Progress | None = None,
) -> VideoScan:
    """Compute frame descriptors of a video and cluster them. Frames that are undecodable or damaged are skipped.

    Parameters
    ----------
    video : str or Path
        The video file.
    clusters : AppearanceClusters or BinnedClusters
        Empty clusters, which take its frames.
    known : collection of int, optional
        Indices of the frames that have been extracted before. They are kept apart from the clusters.
    progress : Progress or None, optional
        Called every 32 frames with the number of frames done and the number that the container claims.

    Returns
    -------
    VideoScan
        The clusters and the descriptors of the known frames.

    Raises
    ------
    VideoError
        The video cannot be read.
    """
    source = Video(video, threads=DECODING_THREADS)
    step = max(1, (source.claimed_frames or 0) // _MAX_SAMPLED_FRAMES)
    extractor, rng = DescriptorExtractor(), np.random.default_rng(0)
    next_index = 0
    found = []
    last_s = 0.0
    with closing(read_ahead(source, _FRAMES_AHEAD)) as frames:
        for frame in frames:
            last_s = frame.time_s
            is_known = frame.index in known
            is_due = frame.index >= next_index
            if frame.decoded is not None and not frame.damaged and (is_known or is_due):
                descriptor = extractor.describe(frame)
                if is_known:
                    found.append(descriptor)
                else:
                    clusters.add(descriptor)
                    next_index = (frame.index // step + 1) * step + int(rng.integers(step))
            if progress is not None and frame.index % 32 == 0:
                progress(frame.index, source.claimed_frames)
    return VideoScan(Path(video), clusters.clusters, found, last_s, list(source.warnings))
