"""Sources of live frames: a file played in real time, a URL, a camera (found in `cameras.py`)."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import av
from av.codec.context import Flags as CodecFlags
from av.format import Flags as FormatFlags

from ..container import Orientation, decoder_options, displayed_wh, orientation
from ..decoder_log import complaints, listen
from ..errors import VideoError, reason
from ..video import Frame, Video
from .cameras import Camera, CameraMode, cameras, find_camera, is_camera_device, opening
from .low_latency import Arrival, LiveSource

_OPEN_S = 10.0
_SILENCE_S = 5.0

# A playlist that a camera serves must not reach for files of this machine.
_PROTOCOLS = ("http", "https", "rtmp", "rtmps", "rtp", "rtsp", "rtsps", "srt", "tcp", "udp")
_TRANSPORTS = ("crypto", "hls", "httpproxy", "tls")
# Servers of recordings send as fast as they can; other protocols send in real time.
_AS_FAST_AS_POSSIBLE = ("http", "https")
# Frames buffered while FFmpeg probes a live stream are outdated; those of a recording are its beginning, and kept.
_NO_PROBE_BUFFER = {"fflags": "nobuffer"}


def open_source(wanted: str | None, mode: CameraMode | None = None) -> LiveSource:
    """Open the file, URL or camera that the user names.

    Parameters
    ----------
    wanted : str or None
        Path of a video, URL, or a camera's number, device or name; None takes the first camera.
    mode : CameraMode or None, optional
        Requested mode of a camera; not allowed for files and URLs.

    Returns
    -------
    LiveSource
        The opened source.

    Raises
    ------
    VideoError
        No such source, it cannot be opened, or it is not video.
    """
    if wanted is not None and is_camera_device(wanted):
        return Stream.from_camera(Camera(wanted, wanted), mode)
    is_url = wanted is not None and "://" in wanted
    if wanted is None or not (is_url or Path(wanted).exists()):
        return Stream.from_camera(_camera(wanted), mode)
    if mode is not None:
        raise VideoError(f"--size, --rate and --camera-format: expected a camera, got {wanted}")
    return Stream.from_url(wanted) if is_url else PlayedFile(Path(wanted))


def _camera(wanted: str | None) -> Camera:
    try:
        return find_camera(wanted, cameras())
    except VideoError:
        if wanted is not None and (Path(wanted).suffix or "/" in wanted or "\\" in wanted):
            raise VideoError(f"{wanted}: no such file") from None
        raise


class PlayedFile:
    """A video file played in real time: each frame is delivered at its presentation time.

    Parameters
    ----------
    path : Path
        The video file.

    Raises
    ------
    VideoError
        See `Video`.
    """

    silence_s: float | None = None

    def __init__(self, path: Path) -> None:
        self._video = Video(path)
        self.name = str(path)
        self.size_wh = self._video.size_wh
        self.rate = self._video.frame_rate

    @property
    def warnings(self) -> list[str]:
        """Problems of the file (see `Video`)."""
        return self._video.warnings

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        """Frames in real time (see `LiveSource`).

        Parameters
        ----------
        begin, stop : threading.Event
            As in `LiveSource.arrivals`.

        Returns
        -------
        iterator of Arrival
            The frames.
        """
        begin.wait()
        yield from _in_real_time(self._video, stop)


class Stream:
    """A camera or a URL, opened and running.

    Parameters
    ----------
    address : str
        What FFmpeg opens: a URL, or the address of a camera.
    name : str
        Name for messages.
    format : str or None
        FFmpeg's input format of a camera, None for a URL.
    options : mapping of str to str
        FFmpeg's options.

    Raises
    ------
    VideoError
        It cannot be opened, or holds no video.
    """

    def __init__(self, address: str, name: str, format: str | None, options: Mapping[str, str]) -> None:
        self.name = name
        self.warnings: list[str] = []
        listen()
        try:
            with av.logging.Capture():
                self._container = av.open(
                    address,
                    format=format,
                    options=dict(options),
                    timeout=(_OPEN_S, _SILENCE_S),
                    metadata_errors="replace",
                )
        except av.ExitError as error:
            raise VideoError(f"{name}: no answer within {_OPEN_S:g} s") from error
        except (av.FFmpegError, OSError, ValueError) as error:
            raise VideoError(f"{name}: cannot be opened ({reason(error)})") from error
        streams = self._container.streams.video
        if not streams or streams[0].codec_context is None:
            self._container.close()
            raise VideoError(f"{name}: expected video, got a source without any that can be decoded")
        self._stream = streams[0]
        context = self._stream.codec_context
        context.thread_count = 1  # each further thread would delay by one frame
        context.flags |= CodecFlags.low_delay
        context.options = {**context.options, **decoder_options(context.name)}
        self.size_wh = (context.width, context.height)
        if not all(self.size_wh):
            self._container.close()
            raise VideoError(f"{name}: delivers no frame")
        # Pixels that are not square are stretched, as they are in files.
        displayed, warning = displayed_wh(self._stream, self.size_wh)
        self.warnings += [] if warning is None else [warning]
        self._stretched_wh = None if displayed == self.size_wh else displayed
        self.size_wh = displayed
        rate = self._stream.average_rate or self._stream.guessed_rate
        self.rate = float(rate) if rate else None
        # For formats without timestamps FFmpeg invents times at a constant rate.
        no_times = int(FormatFlags.no_timestamps.value)  # type: ignore[call-overload] # PyAV's stub errs
        self._has_times = not self._container.format.flags & no_times
        is_device = format is not None
        self._has_end = self._container.duration is not None and not is_device
        self._needs_pacing = self._has_end and _protocol(address) in _AS_FAST_AS_POSSIBLE
        self.silence_s = None if self._needs_pacing else _SILENCE_S

    @classmethod
    def from_url(cls, url: str) -> Stream:
        """A stream or a recording on the network.

        Parameters
        ----------
        url : str
            URL with one of the supported protocols.

        Returns
        -------
        Stream
            The opened stream.

        Raises
        ------
        VideoError
            It cannot be reached or is not video.
        """
        protocol = _protocol(url)
        if protocol not in _PROTOCOLS:
            raise VideoError(f"{url}: expected a URL that begins with {', '.join(_PROTOCOLS)}")
        options = {"protocol_whitelist": ",".join((*_PROTOCOLS, *_TRANSPORTS))}
        if protocol not in _AS_FAST_AS_POSSIBLE:
            options |= _NO_PROBE_BUFFER
        if protocol.startswith("rtsp"):
            # By UDP, a lost packet would damage all frames up to the next key frame.
            options["rtsp_flags"] = "prefer_tcp"
        return cls(url, url, None, options)

    @classmethod
    def from_camera(cls, camera: Camera, mode: CameraMode | None = None) -> Stream:
        """A camera, in its own mode or in the requested one.

        Parameters
        ----------
        camera : Camera
            The camera.
        mode : CameraMode or None, optional
            Requested mode, None for the camera's own.

        Returns
        -------
        Stream
            The opened camera.

        Raises
        ------
        VideoError
            It cannot be opened (in use, not permitted, not in this mode).
        """
        format, options = opening(mode)
        return cls(camera.address, f"camera {camera.name}", format, options | _NO_PROBE_BUFFER)

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        """Frames as they arrive; a recording that a server sends faster is paced to real time (see `LiveSource`).

        Parameters
        ----------
        begin, stop : threading.Event
            As in `LiveSource.arrivals`.

        Returns
        -------
        iterator of Arrival
            The frames.
        """
        with self._container:
            if self._needs_pacing:
                begin.wait()
                yield from _in_real_time((arrival.frame for arrival in self._on_arrival(begin)), stop)
            else:
                yield from self._on_arrival(begin)

    def _on_arrival(self, begin: threading.Event) -> Iterator[Arrival]:
        index = 0
        origin: Arrival | None = None
        for arrival in self._decoded():
            if not begin.is_set():
                continue
            origin = origin or arrival
            time_s = arrival.frame.time_s - origin.frame.time_s
            if math.isnan(time_s):  # without presentation times: the time of arrival
                time_s = arrival.at_s - origin.at_s
            yield Arrival(replace(arrival.frame, index=index, time_s=time_s), arrival.at_s)
            index += 1

    def _decoded(self) -> Iterator[Arrival]:
        """All frames; `time_s` is the raw presentation time, NaN where there is none."""
        turn: Orientation | None = None
        damaged = False  # since a frame that is missing or not sound, up to the next key frame
        for at_s, stamp_s, frame, is_sound in self._av_frames():
            if frame is None or frame.key_frame or not is_sound:
                damaged = frame is None or not is_sound
            if frame is not None and turn is None:
                turn, _, _ = orientation(frame)
                if frame.interlaced_frame:
                    self.warnings.append(
                        "pictures are interlaced: moving edges are seen twice; film progressively"
                    )
            is_damaged = damaged and frame is not None
            shown = Frame(0, stamp_s, frame, turn or Orientation(), is_damaged, self._stretched_wh)
            yield Arrival(shown, at_s)

    def _av_frames(self) -> Iterator[tuple[float, float, av.VideoFrame | None, bool]]:
        """Arrival and presentation time in s of each frame, the frame (None: undecodable), and whether it is sound."""
        packets = self._container.demux(self._stream)
        is_sound = True
        while True:
            try:
                with av.logging.Capture() as logs:
                    packet = next(packets)
            except (StopIteration, IndexError):  # IndexError: see `decoding.py`
                break
            except av.ExitError as error:
                raise VideoError(f"{self.name}: no frame came for {_SILENCE_S:g} s") from error
            except (av.FFmpegError, OSError) as error:
                raise VideoError(f"{self.name}: stopped delivering frames ({reason(error)})") from error
            at_s = time.perf_counter()
            is_sound = not complaints(logs) and not packet.is_corrupt
            frames: list[av.VideoFrame] = []
            failed = False
            with av.logging.Capture() as logs:
                try:
                    frames = self._stream.codec_context.decode(packet)
                except av.EOFError:
                    break
                except av.FFmpegError:
                    failed = True
            is_sound = is_sound and not complaints(logs)
            if failed:
                yield at_s, self._stamp_s(packet), None, False
            for frame in frames:
                yield at_s, self._stamp_s(frame), None if frame.is_corrupt else frame, is_sound
        if not self._has_end:
            raise VideoError(f"{self.name}: stopped delivering frames")

    def _stamp_s(self, of: av.Packet | av.VideoFrame) -> float:
        if of.pts is None or of.time_base is None or not self._has_times:
            return math.nan
        return float(of.pts * of.time_base)


def _protocol(url: str) -> str:
    return url.partition("://")[0].lower()


def _in_real_time(frames: Iterable[Frame], stop: threading.Event) -> Iterator[Arrival]:
    """Frames at their presentation times, which count as the times of capture."""
    start_s: float | None = None
    for frame in frames:
        if start_s is None:
            start_s = time.perf_counter() - frame.time_s
        due_s = start_s + frame.time_s
        if stop.wait(max(0.0, due_s - time.perf_counter())):
            return
        yield Arrival(frame, due_s)
