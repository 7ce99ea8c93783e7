"""Reading video: every frame in order, as displayed, with its presentation time; missing frames are reported.

Damaged streams are handled in `decoding.py`, container metadata in `container.py`; writing
video is in `video_writer.py`.
"""

from __future__ import annotations

import threading
from collections.abc import Generator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import cast

import av
import numpy as np
from av.video.reformatter import VideoReformatter

from .avi_index import ChunkSlots, index_at_end
from .container import (
    Orientation,
    claimed_duration_s,
    claimed_frames,
    displayed_wh,
    first_frame,
    has_times,
    is_cut_short,
    open_video,
    orientation,
)
from .decoding import Decoding, Row
from .deinterlacing import deinterlaced
from .errors import VideoError
from .matroska_checksums import damaged_ranges
from .picture_check import PictureCheck
from .types import FloatArray, ImageArray

# A pause of so many usual frame intervals gets a warning: it may be lost frames.
_PAUSE_INTERVALS = 4
# So many frame intervals without a frame are a gap in a clock that is even otherwise: in so large a share of its steps,
# which differ by so large a share of the usual one and by what containers round.
_GAP_INTERVALS, _MOSTLY, _EVEN, _ROUNDING_S = 1.5, 0.8, 0.1, 0.0011


_of_thread = threading.local()


def _reformatter() -> VideoReformatter:
    """The colour converter of this thread: creating one for each frame takes six times as long."""
    if not hasattr(_of_thread, "reformatter"):
        _of_thread.reformatter = VideoReformatter()
    return cast(VideoReformatter, _of_thread.reformatter)


@dataclass(frozen=True)
class _Found:
    """What one pass through a file found, besides its frames: counts, and seconds."""

    n_hidden: int
    n_indexed: int | None
    start_s: float
    last_s: float


class _Clusters:
    """Frames in the clusters of a Matroska file that do not match their checksums: any of them may be damaged."""

    def __init__(self, ranges: list[tuple[int, int]]) -> None:
        self.ranges = ranges
        self._frames: list[list[int]] = [[] for _ in ranges]
        self._is_located = [False] * len(ranges)

    def add(self, index: int, row: Row) -> None:
        """Take the next row."""
        for number, (begin, end) in enumerate(self.ranges):
            if begin <= row.position < end:
                self._frames[number].append(index)
                self._is_located[number] |= row.picture is None or row.damaged

    def doubtful(self) -> list[int]:
        """Indices of all frames of the clusters in which the decoder did not find the damage."""
        lost = zip(self._frames, self._is_located, strict=True)
        return [index for frames, is_located in lost if not is_located for index in frames]


@dataclass(frozen=True)
class Frame:
    """One frame of a video.

    Attributes
    ----------
    index : int
        0 for the first frame; frames that could not be decoded are counted.
    time_s : float
        Seconds from the first frame, from presentation times.
    decoded : VideoFrame or None
        The frame as decoded (mostly YUV, not turned); None if it could not be decoded.
    orientation : Orientation
        How `decoded` is turned to be displayed.
    damaged : bool
        Decoded with an error, or from a frame that is missing or not sound.
    stretched_wh : tuple of (int, int) or None
        Size to which `decoded` is stretched before it is turned, px; None where its pixels are square.
    """

    index: int
    time_s: float
    decoded: av.VideoFrame | None
    orientation: Orientation
    damaged: bool = False
    stretched_wh: tuple[int, int] | None = None

    @cached_property
    def image(self) -> ImageArray | None:
        """RGB uint8 (H, W, 3) as displayed, None if undecodable. Converted at first access."""
        if self.decoded is None:
            return None
        width, height = self.stretched_wh or (None, None)
        rgb = _reformatter().reformat(self.decoded, width, height, format="rgb24")
        return self.orientation.apply(np.asarray(rgb.to_ndarray(), dtype=np.uint8))


class Video:
    """A video file, read from its first frame to its last.

    Iterating yields a `Frame` for every frame. Each iteration starts again from the first frame; the file is
    closed in between. `warnings` and `complete` refer to the latest iteration and are final once it has ended.

    Parameters
    ----------
    path : str or Path
        The video file.
    threads : int, optional
        Number of decoding threads; one decodes 640 x 480 H.264 at more than 1000 frames/s.

    Attributes
    ----------
    path : Path
        The video file.
    size_wh : tuple of (int, int)
        Width and height as displayed, px.
    claimed_frames : int or None
        Number of frames according to the container, None where it does not say.
    frame_rate : float or None
        Mean frames/s according to the container, None where it does not say; for display only.
    codec : str
        FFmpeg's name of the codec.
    rotation_deg : int
        Counterclockwise turn that the file asks for and that is applied, degrees.
    warnings : list of str
        What the user should know, a line each.
    complete : bool
        False when frames are missing, undecodable or damaged.
    doubtful : list of int
        Indices of frames that were decoded without a complaint, but do not fit those before and after.

    Raises
    ------
    VideoError
        The file is missing, a folder, empty, not a video, has no video stream or no frame that can be
        decoded.
    """

    def __init__(self, path: str | Path, *, threads: int = 1) -> None:
        self.path = Path(path)
        self._threads = threads
        self._standing_warnings: list[str] = []
        self._standing_problems: list[str] = []
        with open_video(self.path, threads) as (container, stream, _):
            self.codec: str = stream.codec_context.name
            self.claimed_frames = claimed_frames(stream)
            self._claimed_duration_s = claimed_duration_s(container, stream)
            rate = stream.average_rate or stream.guessed_rate
            self.frame_rate = float(rate) if rate else None
            # 25 is FFmpeg's own default for streams without a rate.
            self._nominal_rate = Fraction(rate) if rate else Fraction(25)
            self._counts_slots = container.format.name == "avi"
            self._is_matroska = "matroska" in container.format.name
            self._is_mp4 = "mp4" in container.format.name
            if is_cut_short(container):
                self._standing_problems.append("the file ends before its last packet does: it is cut short")
            self._has_times = has_times(container)
            first = first_frame(container, stream, self.path)
            self._orientation, self.rotation_deg, warning = orientation(first)
            if warning:
                self._standing_warnings.append(warning)
            if not self._has_times and stream.codec_context.framerate:
                # FFmpeg takes 25 frames/s for elementary streams; some codecs say their own rate.
                self._nominal_rate = Fraction(stream.codec_context.framerate)
            self._stored_wh = (first.width, first.height)
            displayed, warning = displayed_wh(stream, self._stored_wh)
            if warning:
                self._standing_warnings.append(warning)
        self._stretched_wh = None if displayed == self._stored_wh else displayed
        self.size_wh = displayed[::-1] if self._orientation.transpose else displayed
        self.warnings = list(self._standing_warnings)
        self.complete = True
        self.doubtful: list[int] = []

    def __enter__(self) -> Video:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Each iteration closes its own file."""

    def _say_interlaced(self) -> None:
        self.warnings.append(
            "pictures are interlaced though the file does not say so; each was made from its first field"
        )

    def __iter__(self) -> Generator[Frame, None, None]:
        self.warnings, self.complete = list(self._standing_warnings), True
        times: list[float] = []
        undecodable_s: list[float] = []
        n_damaged = 0
        with open_video(self.path, self._threads) as (container, stream, heard):
            decoding = Decoding(
                container,
                stream,
                self._stored_wh,
                has_times=self._has_times,
                slots=self._slots(stream),
                is_cut=bool(self._standing_problems),
                heard_at_opening=heard,
            )
            check = PictureCheck(self.codec)
            clusters = _Clusters(damaged_ranges(self.path) if self._is_matroska else [])
            start: int | None = None
            for row in deinterlaced(decoding.rows(), self._say_interlaced):
                start = row.stamp if start is None else start
                time_s = self._time_s(row, len(times), start, stream.time_base or Fraction(1))
                times.append(time_s)
                if row.picture is None:
                    undecodable_s.append(time_s)
                n_damaged += row.damaged
                check.add(len(times) - 1, row, time_s)
                if clusters.ranges:
                    clusters.add(len(times) - 1, row)
                yield Frame(
                    len(times) - 1, time_s, row.picture, self._orientation, row.damaged, self._stretched_wh
                )
            time_base = stream.time_base or Fraction(0)
            found = _Found(
                n_hidden=decoding.n_hidden,
                n_indexed=len(stream.index_entries) if self._is_mp4 else None,
                start_s=float((start or 0) * time_base),
                last_s=float(decoding.last_duration * time_base),
            )
        is_damaged = bool(
            undecodable_s or n_damaged or clusters.ranges or self._standing_problems or decoding.problems
        )
        self.doubtful = check.doubtful(is_damaged=is_damaged)
        if self.doubtful and not is_damaged:
            self.doubtful = check.doubtful(is_damaged=True)
        if clusters.ranges:
            self._incomplete(f"{len(clusters.ranges)} parts of the file do not match their checksums")
            self.doubtful = sorted({*self.doubtful, *clusters.doubtful()})
        self._doubt_times(np.array(times))
        if undecodable_s:
            self._incomplete(
                f"{len(undecodable_s)} of {len(times)} frames could not be decoded, "
                f"the first at {undecodable_s[0]:.3f} s"
            )
        if n_damaged:
            self._incomplete(f"{n_damaged} frames are damaged, or were decoded from frames that are")
        if self.doubtful:
            self._incomplete(
                f"{len(self.doubtful)} frames do not fit those before and after, the first at"
                f" {times[self.doubtful[0]]:.3f} s: counted as damaged"
            )
        for problem in (*self._standing_problems, *decoding.problems):
            self._incomplete(problem)
        self._compare_with_claims(np.array(times), found)

    def _time_s(self, row: Row, index: int, start: int | None, time_base: Fraction) -> float:
        if row.stamp is not None and start is not None:
            return float((row.stamp - start) * time_base)
        if index == 0:
            self.warnings.append(
                "the file holds no presentation times: "
                f"they are counted at {float(self._nominal_rate):g} frames/s"
            )
        return float(index / self._nominal_rate)

    def _incomplete(self, warning: str) -> None:
        self.complete = False
        self.warnings.append(warning)

    def _cut(self, warning: str) -> None:
        """Say first that frames are missing: what else is said mostly follows from it."""
        self.complete = False
        self.warnings.insert(len(self._standing_warnings), warning)

    def _doubt_times(self, times: FloatArray) -> None:
        """Count frames as damaged whose times are not in the order of frames: a wrong time is a wrong row."""
        if len(times) > 1 and np.any(np.diff(times) < 0):
            late = times < np.maximum.accumulate(times)
            early = times > np.minimum.accumulate(times[::-1])[::-1]
            wrong = early if early.sum() <= late.sum() else late
            self.doubtful = sorted({*self.doubtful, *np.flatnonzero(wrong).tolist()})

    def _slots(self, stream: av.VideoStream) -> ChunkSlots | None:
        """The index of an AVI, None for other files and where there is none."""
        if not self._counts_slots:
            return None
        index, position = index_at_end(self.path, stream.index)
        return ChunkSlots(index, position) if index else None

    def _compare_with_claims(self, times: FloatArray, found: _Found) -> None:
        steps = np.diff(times)
        usual_s = float(np.median(steps)) if len(steps) else float(1 / self._nominal_rate)
        end_s = float(times[-1]) + max(usual_s, found.last_s) if len(times) else 0.0
        n_found = len(times)
        if self._counts_slots:  # an AVI counts the slots in which its recorder dropped a frame, too
            n_found = round((float(times[-1]) + usual_s if n_found else 0.0) * self._nominal_rate)
        if self.claimed_frames is not None:
            # MP4: what lies before an edit list is counted, but has no rows.
            counts = (n_found, n_found + found.n_hidden)
            if self.claimed_frames not in counts and found.n_indexed not in counts:
                if n_found < self.claimed_frames:
                    self._cut(
                        f"cut short or damaged: {n_found} of the {self.claimed_frames} frames of its header"
                    )
                else:
                    self._incomplete(
                        f"its header is wrong: it says {self.claimed_frames} frames, {n_found} were found"
                    )
        # Headers give the length from the first frame, or from the file's own zero.
        elif (self._claimed_duration_s or 0.0) - end_s - max(0.0, found.start_s) > max(
            0.1, _PAUSE_INTERVALS * usual_s
        ):
            self._cut(
                f"cut short: it ends at {end_s:.3f} s, its header says {self._claimed_duration_s:.3f} s"
            )
        n_backward = int(np.sum(steps <= 0))
        if n_backward:
            self.warnings.append(f"presentation times do not increase at {n_backward} frames")
        # Where nothing counts the frames, a single one that is missing from an even clock is said too.
        is_even = len(steps) > 0 and bool(
            np.mean(np.abs(steps - usual_s) < _EVEN * usual_s + _ROUNDING_S) > _MOSTLY
        )
        least = _GAP_INTERVALS if is_even and self.claimed_frames is None else _PAUSE_INTERVALS
        pauses = np.flatnonzero(steps > least * usual_s)
        if len(pauses):
            longest = pauses[np.argmax(steps[pauses])]
            # The camera paused, unless reading the file went wrong.
            self.warnings.append(
                f"no frame for {steps[longest]:.3f} s after {times[longest]:.3f} s, where one usually comes "
                f"every {usual_s:.3f} s ({len(pauses)} such pause{'s' if len(pauses) > 1 else ''})"
            )


def read_frame(path: str | Path, index: int) -> ImageArray:
    """The frame with this index as RGB uint8 (H, W, 3), found by decoding from the start.

    Parameters
    ----------
    path : str or Path
        The video file.
    index : int
        Index of the frame, from 0; frames that could not be decoded are counted.

    Returns
    -------
    ndarray of uint8
        RGB (H, W, 3).

    Raises
    ------
    VideoError
        The file cannot be read, has no such frame, or the frame cannot be decoded.
    """
    n_frames = 0
    for frame in Video(path):
        n_frames += 1
        if frame.index == index:
            if frame.image is None:
                raise VideoError(f"{path}: frame {index} cannot be decoded")
            return frame.image
    raise VideoError(f"{path}: expected a frame index from 0 to {n_frames - 1}, got {index}")


def spread_frames(path: str | Path, count: int) -> list[ImageArray]:
    """At most `count` frames spread over a video, RGB uint8 (H, W, 3); fewer where it has fewer that can be decoded.

    Parameters
    ----------
    path : str or Path
        The video file.
    count : int
        Largest number of frames.

    Returns
    -------
    list of ndarray of uint8
        RGB (H, W, 3) each, in the order of the video.

    Raises
    ------
    VideoError
        The file cannot be read.
    """
    kept: list[Frame] = []
    step = 1
    for frame in Video(path):
        if frame.index % step or frame.decoded is None or frame.damaged:
            continue
        kept.append(frame)
        # Works without a known length: when there are twice too many frames, every second one is discarded.
        if len(kept) >= 2 * count:
            kept, step = kept[::2], 2 * step
    places = np.linspace(0, len(kept) - 1, min(count, len(kept))).astype(int).tolist()
    return [image for image in (kept[i].image for i in places) if image is not None]


def video_stem(path: str | Path) -> str:
    """Name of a video without folder and suffix, by which its labels and results are named.

    Parameters
    ----------
    path : str or Path
        The video file.

    Returns
    -------
    str
        The stem.

    Examples
    --------
    >>> video_stem("rig/original 0.25Hz.mp4")
    'original 0.25Hz'
    """
    return Path(path).stem
