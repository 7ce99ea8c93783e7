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

from .container import Orientation, claimed_duration_s, claimed_frames, first_frame, open_video, orientation
from .decoding import Decoding, Row
from .errors import VideoError
from .types import FloatArray, ImageArray

# A pause of so many usual frame intervals gets a warning: it may be lost frames.
_PAUSE_INTERVALS = 4


_of_thread = threading.local()


def _reformatter() -> VideoReformatter:
    """The colour converter of this thread: creating one for each frame takes six times as long."""
    if not hasattr(_of_thread, "reformatter"):
        _of_thread.reformatter = VideoReformatter()
    return cast(VideoReformatter, _of_thread.reformatter)


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
        Decoded without error, but from a frame that could not be decoded.
    """

    index: int
    time_s: float
    decoded: av.VideoFrame | None
    orientation: Orientation
    damaged: bool = False

    @cached_property
    def image(self) -> ImageArray | None:
        """RGB uint8 (H, W, 3) as displayed, None if undecodable. Converted at first access."""
        if self.decoded is None:
            return None
        rgb = _reformatter().reformat(self.decoded, format="rgb24")
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
        with open_video(self.path, threads) as (container, stream):
            self.codec: str = stream.codec_context.name
            self.claimed_frames = claimed_frames(stream)
            self._claimed_duration_s = claimed_duration_s(container, stream)
            rate = stream.average_rate or stream.guessed_rate
            self.frame_rate = float(rate) if rate else None
            # 25 is FFmpeg's own default for streams without a rate.
            self._nominal_rate = Fraction(rate) if rate else Fraction(25)
            self._counts_slots = container.format.name == "avi"
            first = first_frame(container, stream, self.path)
            self._orientation, self.rotation_deg, warning = orientation(first)
            if warning:
                self._standing_warnings.append(warning)
            if stream.sample_aspect_ratio not in (None, 0, 1):
                self._standing_warnings.append(
                    f"pixels are not square (aspect {stream.sample_aspect_ratio}): positions and angles are "
                    "those of the frame as stored"
                )
        self._stored_wh = (first.width, first.height)
        self.size_wh = self._stored_wh[::-1] if self._orientation.transpose else self._stored_wh
        self.warnings = list(self._standing_warnings)
        self.complete = True

    def __enter__(self) -> Video:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Each iteration closes its own file."""

    def __iter__(self) -> Generator[Frame, None, None]:
        self.warnings, self.complete = list(self._standing_warnings), True
        times: list[float] = []
        undecodable_s: list[float] = []
        n_damaged = 0
        with open_video(self.path, self._threads) as (container, stream):
            decoding = Decoding(container, stream, self._stored_wh)
            start: int | None = None
            for row in decoding.rows():
                start = row.stamp if start is None else start
                time_s = self._time_s(row, len(times), start, stream.time_base or Fraction(1))
                times.append(time_s)
                if row.picture is None:
                    undecodable_s.append(time_s)
                n_damaged += row.damaged
                yield Frame(len(times) - 1, time_s, row.picture, self._orientation, row.damaged)
        if undecodable_s:
            self._incomplete(
                f"{len(undecodable_s)} of {len(times)} frames could not be decoded, "
                f"the first at {undecodable_s[0]:.3f} s"
            )
        if n_damaged:
            self._incomplete(f"{n_damaged} frames were decoded from frames that could not be decoded")
        for problem in decoding.problems:
            self._incomplete(problem)
        self._compare_with_claims(np.array(times), decoding.n_hidden)

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

    def _compare_with_claims(self, times: FloatArray, n_hidden: int) -> None:
        steps = np.diff(times)
        usual_s = float(np.median(steps)) if len(steps) else float(1 / self._nominal_rate)
        end_s = float(times[-1]) + usual_s if len(times) else 0.0
        n_found = len(times)
        if self._counts_slots:  # an AVI counts the slots in which its recorder dropped a frame, too
            n_found = round(end_s * self._nominal_rate)
        if self.claimed_frames is not None:
            if self.claimed_frames not in (n_found, n_found + n_hidden):
                verdict = (
                    "it is cut short or damaged" if n_found < self.claimed_frames else "its header is wrong"
                )
                self._incomplete(
                    f"the file claims {self.claimed_frames} frames, {n_found} were found: {verdict}"
                )
        elif (self._claimed_duration_s or 0.0) - end_s > max(0.1, _PAUSE_INTERVALS * usual_s):
            self._incomplete(
                f"the video ends at {end_s:.3f} s, its header says {self._claimed_duration_s:.3f} s: "
                "it is cut short"
            )
        n_backward = int(np.sum(steps <= 0))
        if n_backward:
            self.warnings.append(f"presentation times do not increase at {n_backward} frames")
        pauses = np.flatnonzero(steps > _PAUSE_INTERVALS * usual_s)
        if len(pauses):
            longest = pauses[np.argmax(steps[pauses])]
            warning = (
                f"no frame for {steps[longest]:.3f} s after {times[longest]:.3f} s, where one usually comes "
                f"every {usual_s:.3f} s ({len(pauses)} such pause{'s' if len(pauses) > 1 else ''})"
            )
            if self.claimed_frames is None:
                self._incomplete(warning)  # nothing counts the frames, so they may be lost
            else:
                self.warnings.append(warning)  # all there, so the camera paused


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
