"""A video streams by once and leaves a few glimpses of every pose, in memory that does not grow with it.

Which of them become pictures to label is decided in `selection.py`.
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
from .glimpses import Glimpse, Glimpser
from .pose_cells import BinCells, Cell, LookCells
from .pressure_order import PressureOrder

Progress = Callable[[int, int | None], None]

# Of a longer video one frame in n is looked at, all are decoded. Which one is drawn by chance: every n-th could keep
# step with a motion that repeats.
_LOOKS = 10_000
_FRAMES_AHEAD = 16
DECODING_THREADS = min(4, os.cpu_count() or 1)
# What all videos of a run may keep together, and each at least. A cell takes up to 60 kB.
_CELLS, _LEAST_CELLS = 1200, 60
_TIME_BIN_S = 0.05
_PRESSURE_BINS = 200


class By(StrEnum):
    """What chosen frames are spread evenly over."""

    PRESSURE = "pressure"
    APPEARANCE = "appearance"
    TIME = "time"


@dataclass(frozen=True)
class Survey:
    """What is kept of a video.

    Attributes
    ----------
    video : the file
    cells : its poses
    known : glimpses of the frames that are pictures to label already
    duration_s : time of its last frame
    warnings : what the video's reader says of it
    """

    video: Path
    cells: list[Cell]
    known: list[Glimpse]
    duration_s: float
    warnings: list[str]


def cells_for(by: By, n_videos: int, pressure: PressureOrder | None = None) -> LookCells | BinCells:
    """Empty cells for one of `n_videos` videos, whose pressure is known where frames are chosen by it."""
    limit = max(_LEAST_CELLS, _CELLS // n_videos)
    if by is By.APPEARANCE:
        return LookCells(limit)
    if pressure is None:
        return BinCells(lambda time_s: (time_s, 0), _TIME_BIN_S, limit)
    return BinCells(
        pressure.at, max(pressure.range_kpa / _PRESSURE_BINS, 1e-6), max(limit, 2 * _PRESSURE_BINS + 2)
    )


def survey(
    video: str | Path,
    cells: LookCells | BinCells,
    *,
    known: Collection[int] = (),
    progress: Progress | None = None,
) -> Survey:
    """Look at the frames of a video. Those that cannot be decoded, or are damaged, are passed over.

    Parameters
    ----------
    video : the video file
    cells : empty cells, where its frames go
    known : indices of the frames that are pictures to label already: kept apart, not put into cells
    progress : called now and then with the number of frames done and the number claimed

    Raises
    ------
    VideoError
        The video cannot be read.
    """
    source = Video(video, threads=DECODING_THREADS)
    step = max(1, (source.claimed_frames or 0) // _LOOKS)
    glimpser, rng = Glimpser(), np.random.default_rng(0)
    following = 0
    found = []
    last_s = 0.0
    with closing(read_ahead(source, _FRAMES_AHEAD)) as frames:
        for frame in frames:
            last_s = frame.time_s
            is_known = frame.index in known
            is_due = frame.index >= following
            if frame.decoded is not None and not frame.damaged and (is_known or is_due):
                glimpse = glimpser.glimpse(frame)
                if is_known:
                    found.append(glimpse)
                else:
                    cells.add(glimpse)
                    following = (frame.index // step + 1) * step + int(rng.integers(step))
            if progress is not None and frame.index % 32 == 0:
                progress(frame.index, source.claimed_frames)
    return Survey(Path(video), cells.cells, found, last_s, list(source.warnings))
