"""Opening a video file and reading its container's metadata: stream, frame count, orientation.

These values are claims: only decoding (`decoding.py`) shows whether they hold.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.format import Flags as FormatFlags
from av.sidedata.sidedata import Type as SideDataType
from av.stream import Disposition

from .decoder_log import complaints, listen
from .errors import VideoError, reason
from .types import ImageArray

# Images and text, which FFmpeg would open as a "video" of one frame.
_NO_TIMES = int(FormatFlags.no_timestamps.value)  # type: ignore[call-overload] # PyAV's stub errs
# Plain, with a time stamp (AVCHD), with a checksum.
_TS_PACKET_BYTES = (188, 192, 204)
# The object of an ASF's header that gives the size of the file, 40 bytes after its name.
_ASF_FILE_PROPERTIES = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")
_ASF_HEAD_BYTES = 1 << 16
# Anamorphic lenses reach 2; a file that asks for more is damaged.
_MAX_ASPECT = 4
_NOT_VIDEO_FORMATS = ("_pipe", "image2", "tty")


@dataclass(frozen=True)
class Orientation:
    """How a decoded frame is turned for display: transposed first, then flipped.

    Attributes
    ----------
    transpose : bool
        Whether rows and columns are exchanged, before any flip.
    flip_x, flip_y : bool
        Whether the image is then mirrored along x, along y.
    """

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False

    def apply(self, image: ImageArray) -> ImageArray:
        """Turn an image (H, W, 3) as decoded into the image as displayed, contiguous.

        Parameters
        ----------
        image : ndarray of uint8
            (H, W, 3) as decoded.

        Returns
        -------
        ndarray of uint8
            (H, W, 3) as displayed; H and W are exchanged by a transposition.
        """
        if self.transpose:
            image = image.swapaxes(0, 1)
        return np.ascontiguousarray(image[:: -1 if self.flip_y else 1, :: -1 if self.flip_x else 1])


@contextmanager
def open_video(path: Path, threads: int) -> Iterator[tuple[InputContainer, av.VideoStream, list[str]]]:
    """Open a file and its first video stream that is not a cover image, ready to decode.

    Parameters
    ----------
    path : Path
        The video file.
    threads : int
        Number of decoding threads.

    Yields
    ------
    container : InputContainer
        The open file.
    stream : VideoStream
        Its video stream.
    heard : list of str
        What FFmpeg said of damage while it probed the file.

    Raises
    ------
    VideoError
        The file is missing, a folder, empty, not a video, or has no video stream.
    """
    listen()
    with av.logging.Capture() as logs:
        container = _open(path)
    # The reader's own words; those of decoders it says again when frames are read.
    logs = [log for log in logs if log[1] == container.format.name and "Packet corrupt" not in log[2]]
    context = None
    try:
        stream = _video_stream(container, path)
        context = stream.codec_context
        # Whole frames in parallel, never slices: with slice threads FFmpeg (8, H.264) neither conceals nor
        # reports errors, and hands out garbage as sound.
        context.thread_count = threads
        context.thread_type = "FRAME"
        context.copy_opaque = True
        context.options = {**context.options, **decoder_options(context.name)}
        yield container, stream, complaints(logs)
    finally:
        if threads > 1 and context is not None and context.is_open:
            # Brings the threads to rest while Python runs on: one that logs waits for Python, which would wait for it.
            context.flush_buffers()
        container.close()


def decoder_options(codec: str) -> dict[str, str]:
    """FFmpeg's options with which a decoder finds damage.

    Parameters
    ----------
    codec : str
        FFmpeg's name of the codec.

    Returns
    -------
    dict of str to str
        Options.
    """
    # For MJPEG it finds most flipped bits instead of few. Every frame stands alone, so nothing else is lost; the
    # other codecs mark or log what they conceal without it.
    return {"err_detect": "explode"} if codec == "mjpeg" else {}


def _open(path: Path) -> InputContainer:
    if not path.exists():
        raise VideoError(f"{path}: no such file")
    if path.is_dir():
        raise VideoError(f"{path}: expected a video file, got a folder")
    if path.stat().st_size == 0:
        raise VideoError(f"{path}: the file is empty")
    try:
        # Absolute, so that a colon in the name is not taken for a protocol; files only, so that no playlist
        # reaches for the network.
        # Titles and comments may be in the alphabet of any land.
        container = av.open(
            str(path.absolute()), options={"protocol_whitelist": "file"}, metadata_errors="replace"
        )
    except av.InvalidDataError as error:
        raise VideoError(f"{path}: not a video, or cut off before its index was written") from error
    except (av.FFmpegError, OSError, ValueError) as error:
        raise VideoError(f"{path}: cannot be opened ({reason(error)})") from error
    name = container.format.name
    if any(word in name for word in _NOT_VIDEO_FORMATS):
        container.close()
        raise VideoError(f"{path}: expected a video, got an image or text (FFmpeg takes it for {name})")
    return container


def _video_stream(container: InputContainer, path: Path) -> av.VideoStream:
    for stream in container.streams.video:
        if not stream.disposition & Disposition.attached_pic:
            if stream.codec_context is None:
                raise VideoError(f"{path}: no decoder for the codec of its video stream")
            return stream
    kinds = ", ".join(sorted({stream.type for stream in container.streams.get()})) or "nothing"
    raise VideoError(f"{path}: expected a video stream, found only {kinds}")


def first_frame(container: InputContainer, stream: av.VideoStream, path: Path) -> av.VideoFrame:
    """The first frame decoded without error, for size and orientation.

    Parameters
    ----------
    container : InputContainer
        The open file.
    stream : VideoStream
        Its video stream.
    path : Path
        Path of the file, for messages.

    Returns
    -------
    VideoFrame
        The frame.

    Raises
    ------
    VideoError
        The file holds no such frame.
    """
    packets = container.demux(stream)
    packet: av.Packet | None
    while True:
        try:
            packet = next(packets, None)
        except (av.FFmpegError, IndexError):  # the file ends here (IndexError: see `decoding.py`)
            packet = None
        if packet is not None and packet.size == 0:
            continue
        try:
            decoded = stream.codec_context.decode(packet)
        except av.FFmpegError:
            decoded = []
        for frame in decoded:
            if not frame.is_corrupt:
                return frame
        if packet is None:
            raise VideoError(f"{path}: holds no frame that can be decoded ({stream.codec_context.name})")


def orientation(frame: av.VideoFrame) -> tuple[Orientation, int, str | None]:
    """Orientation of a decoded frame, from the container's display matrix.

    The matrix takes a decoded (x, y) to the displayed (a x + c y, b x + d y). Only quarter turns and
    mirrors are applied, which keep pixels whole.

    Parameters
    ----------
    frame : VideoFrame
        A decoded frame, with its side data.

    Returns
    -------
    orientation : Orientation
        How the frame is turned.
    rotation_deg : int
        The counterclockwise turn that the file asks for, degrees.
    warning : str or None
        A line where that turn is not applied.
    """
    if SideDataType.DISPLAYMATRIX not in frame.side_data:
        return Orientation(), 0, None
    matrix = frame.side_data[SideDataType.DISPLAYMATRIX]  # type: ignore[typeddict-item] # PyAV's stub errs
    a, b, _, c, d = np.frombuffer(bytes(matrix), np.int32)[:5] / 65536
    turn = round(math.degrees(math.atan2(-b, a)))
    if max(abs(b), abs(c)) < 1e-3 * max(abs(a), abs(d)):
        return Orientation(False, bool(a < 0), bool(d < 0)), turn, None
    if max(abs(a), abs(d)) < 1e-3 * max(abs(b), abs(c)):
        return Orientation(True, bool(c < 0), bool(b < 0)), turn, None
    return Orientation(), 0, f"the file asks for a turn of {turn} degrees, not a quarter turn: not applied"


def has_times(container: InputContainer) -> bool:
    """Whether a file's format holds presentation times. FFmpeg invents some for those that do not.

    Parameters
    ----------
    container : InputContainer
        The open file.

    Returns
    -------
    bool
        False for elementary streams such as raw H.264, MJPEG or AV1.
    """
    return not container.format.flags & _NO_TIMES


def is_cut_short(container: InputContainer) -> bool:
    """Whether a file is shorter than its format says.

    Parameters
    ----------
    container : InputContainer
        The open file.

    Returns
    -------
    bool
        MPEG-TS: True where the last packet is not whole. ASF, WMV: where the header gives a larger size.
    """
    if container.format.name == "mpegts":
        return all(container.size % size for size in _TS_PACKET_BYTES)
    if container.format.name == "asf":
        with open(container.name, "rb") as file:
            head = file.read(_ASF_HEAD_BYTES)
        at = head.find(_ASF_FILE_PROPERTIES)
        size = int.from_bytes(head[at + 40 : at + 48], "little") if at >= 0 else 0
        return size > container.size
    return False


def displayed_wh(stream: av.VideoStream, stored_wh: tuple[int, int]) -> tuple[tuple[int, int], str | None]:
    """Size to which frames are stretched where pixels are not square, before they are turned.

    Parameters
    ----------
    stream : VideoStream
        The video stream, of which a frame has been decoded.
    stored_wh : tuple of (int, int)
        Width and height of the frames as stored, px.

    Returns
    -------
    size_wh : tuple of (int, int)
        Width and height, px. One of them is larger, as in browsers (HTML: never drop rows or columns).
    warning : str or None
        A line where the file asks for a shape that no camera has.
    """
    width, height = stored_wh
    # The container's word counts more than the codec's, as for FFmpeg's own player.
    aspect = stream.sample_aspect_ratio or stream.codec_context.sample_aspect_ratio
    if not aspect or aspect == 1:
        return stored_wh, None
    if not 1 / _MAX_ASPECT <= aspect <= _MAX_ASPECT:
        return stored_wh, f"the file asks for pixels of {aspect} times their height: not applied"
    if aspect > 1:
        return (round(width * aspect), height), None
    return (width, round(height / aspect)), None


def claimed_frames(stream: av.VideoStream) -> int | None:
    """Frame count claimed by the container: its own counter, or a tag of some Matroska writers; None without either.

    Parameters
    ----------
    stream : VideoStream
        The video stream.

    Returns
    -------
    int or None
        The number of frames.
    """
    if stream.frames:
        return int(stream.frames)
    for tag, value in stream.metadata.items():
        if tag.upper().startswith("NUMBER_OF_FRAMES") and value.isdigit():
            return int(value)
    return None


def claimed_duration_s(container: InputContainer, stream: av.VideoStream) -> float | None:
    """Length of the video stream in s according to the container, None where it does not say.

    Parameters
    ----------
    container : InputContainer
        The open file.
    stream : VideoStream
        Its video stream.

    Returns
    -------
    float or None
        Seconds.
    """
    if stream.duration is not None and stream.time_base:
        return float(stream.duration * stream.time_base)
    for tag, value in stream.metadata.items():  # Matroska: 00:00:04.000000000
        if tag.upper() == "DURATION" and value.count(":") == 2:
            hours, minutes, seconds = value.split(":")
            return 3600 * int(hours) + 60 * int(minutes) + float(seconds)
    if container.duration is not None and len(container.streams) == 1:
        return float(container.duration / av.time_base)
    return None
