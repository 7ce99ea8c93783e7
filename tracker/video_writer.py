"""Writing H.264 video that browsers play: yuv420p, index in front, source times kept, whole or not at all."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import numpy as np

from .atomic import atomic_path
from .errors import VideoError, reason
from .types import ImageArray

_TIME_BASE = Fraction(1, 90_000)  # divides 24, 25, 30, 50 and 60 frames/s
# Keeps letters sharp. On noisy camera frames "superfast" takes as long and makes files three times as large, slower
# presets take longer and make them no smaller.
_OPTIONS = {"crf": "20", "preset": "veryfast"}
_BT709 = 1  # FFmpeg's number for its matrix, primaries and transfer


class VideoWriter:
    """Write RGB images as an mp4. Use as a context manager; if the block raises, no file is left.

    Odd sizes are padded by a column or a row (4:2:0 colour needs even sizes), repeating the edge.

    Parameters
    ----------
    path : str or Path
        The mp4 file to write or replace.
    size_wh : tuple of (int, int)
        (width, height) of the images in px.
    frame_rate : float
        Frames/s: the times of images written without a time, and the rate stated in the file.

    Raises
    ------
    VideoError
        The file cannot be written.
    """

    def __init__(self, path: str | Path, size_wh: tuple[int, int], frame_rate: float) -> None:
        self.path = Path(path)
        self._size_wh = size_wh
        self._frame_rate = frame_rate
        self._n_written = 0
        self._last_stamp = -1
        self._file = atomic_path(self.path)
        try:
            temporary = self._file.__enter__().absolute()
            temporary.touch()  # FFmpeg would find out only at the first frame
            self._container = av.open(str(temporary), "w", format="mp4", options={"movflags": "+faststart"})
        except (OSError, av.FFmpegError) as error:
            raise self._error(error) from error
        rate = Fraction(frame_rate).limit_denominator(1001)
        self._stream = self._container.add_stream("libx264", rate=rate, options=_OPTIONS)
        width, height = size_wh
        self._stream.width, self._stream.height = width + width % 2, height + height % 2
        self._stream.pix_fmt = "yuv420p"
        context = self._stream.codec_context
        context.time_base = _TIME_BASE
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = 1  # limited ("MPEG")

    def write(self, image: ImageArray, time_s: float | None = None) -> None:
        """Append an RGB uint8 (H, W, 3) image, shown from `time_s` on (default: at the frame rate).

        Times that do not increase are moved by the smallest step that mp4 can represent (1/90000 s).

        Parameters
        ----------
        image : ndarray of uint8
            RGB uint8 (H, W, 3) of the writer's size.
        time_s : float or None, optional
            Time from which the image is shown, s; None for the next time at the frame rate.

        Raises
        ------
        ValueError
            An image of another shape or type.
        VideoError
            The file cannot be written.
        """
        width, height = self._size_wh
        if image.shape != (height, width, 3) or image.dtype != np.uint8:
            raise ValueError(
                f"expected an image uint8 ({height}, {width}, 3), got {image.dtype} {image.shape}"
            )
        if width % 2 or height % 2:
            image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        seconds = self._n_written / self._frame_rate if time_s is None else time_s
        stamp = max(round(seconds / _TIME_BASE), self._last_stamp + 1)
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image)).reformat(
            format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG"
        )
        frame.pts, frame.time_base = stamp, _TIME_BASE
        self._encode(frame)
        self._last_stamp = stamp
        self._n_written += 1

    def _encode(self, frame: av.VideoFrame | None) -> None:
        try:
            self._container.mux(self._stream.encode(frame))
        except (OSError, av.FFmpegError) as error:
            raise self._error(error) from error

    def _error(self, error: Exception) -> VideoError:
        return VideoError(f"{self.path}: cannot be written ({reason(error)})")

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            try:
                self._finish()
            except VideoError as failure:
                self._abandon(failure)
                raise
            try:
                self._file.__exit__(None, None, None)
            except OSError as failure:
                raise self._error(failure) from failure
        else:
            self._abandon(error)

    def _finish(self) -> None:
        if self._n_written == 0:
            raise VideoError(f"{self.path}: cannot be written (no frames were given)")
        self._encode(None)
        try:
            self._container.close()
        except (OSError, av.FFmpegError) as error:
            raise self._error(error) from error

    def _abandon(self, error: BaseException) -> None:
        with suppress(OSError, av.FFmpegError):
            self._container.close()
        self._file.__exit__(type(error), error, error.__traceback__)
