"""Low-latency mode: the newest frame of a source is measured; frames that became outdated meanwhile are dropped.

Independent of network (any `types.Detector`) and camera: sources of frames are in `sources.py`, values are sent by
`output.py`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..angle import AngleDefinition
from ..errors import VideoError
from ..measuring import MIN_LIKELIHOOD, check_points, measure
from ..types import Detections, Detector, DropAwareDetector, Flag, TrainedDetector, VideoDetector
from ..video import Frame

_POLL_S = 0.1  # longest delay until a stop is noticed while no frame arrives
_JOIN_S = 1.0  # a capture thread that hangs is abandoned after this time


@dataclass(frozen=True)
class Arrival:
    """A frame, and when it was captured: seconds of `time.perf_counter`, like all times in this file.

    Attributes
    ----------
    frame : Frame
        The frame.
    at_s : float
        Time of capture, seconds of `time.perf_counter`.
    """

    frame: Frame
    at_s: float


class LiveSource(Protocol):
    """A source that delivers frames in real time.

    Attributes
    ----------
    name : str
        Name of the source, used in messages.
    size_wh : tuple of (int, int)
        (width, height) px that the frames are expected to have.
    rate : float or None
        Nominal frames/s, None where the source has none.
    silence_s : float or None
        A pause in s after which the source counts as lost; None where a pause means nothing.
    warnings : list of str
        Notes for the user, a line each; complete once the source has ended.
    """

    name: str
    size_wh: tuple[int, int]
    rate: float | None
    silence_s: float | None

    @property
    def warnings(self) -> list[str]:
        """Notes for the user, a line each; complete once the source has ended."""

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        """Frames as they arrive, from when `begin` is set until `stop` is set; the first of them is frame 0.

        Parameters
        ----------
        begin : threading.Event
            Set when frames are wanted; frames before are discarded.
        stop : threading.Event
            Set when no more frames are wanted.

        Returns
        -------
        iterator of Arrival
            The frames; ends with the source.
        """


@dataclass(frozen=True)
class LiveValue:
    """The measurement of one frame.

    Attributes
    ----------
    frame : int
        Index of the frame at the source; dropped frames are counted.
    time_s : float
        Capture time in s from the first frame.
    angle_deg, angle_sd_deg : float
        Degrees; NaN where unknown.
    likelihood : float
        Lowest likelihood of the angle's keypoints, NaN where the frame could not be decoded.
    flag : Flag
        Flag of the row, as in an angle table.
    latency_ms : float
        Time from capture to this value, ms.
    dropped_s : tuple of float
        `time_s` of the frames dropped since the previous value.
    found : Detections
        The keypoints of the frame, N = 1.
    """

    frame: int
    time_s: float
    angle_deg: float
    angle_sd_deg: float
    likelihood: float
    flag: Flag
    latency_ms: float
    dropped_s: tuple[float, ...]
    found: Detections

    @property
    def dropped(self) -> int:
        """Number of frames dropped since the previous value."""
        return len(self.dropped_s)


def measure_live(
    source: LiveSource,
    detector: Detector,
    definition: AngleDefinition,
    *,
    min_likelihood: float = MIN_LIKELIHOOD,
    duration_s: float | None = None,
    stop: threading.Event | None = None,
) -> Generator[LiveValue, None, None]:
    """Measure the bending angle of the newest frame of a source, repeatedly.

    A separate thread captures frames while one is being measured, and keeps only the newest. So the latency of a
    value is at most the time of two measurements, however slow the detector is.

    Parameters
    ----------
    source : LiveSource
        Source of the frames; read once.
    detector : Detector
        Finds keypoints in frames; a `VideoDetector` is asked for a new detector for this source.
    definition : AngleDefinition
        Which angle, of which of the detector's keypoints.
    min_likelihood : float, optional
        A value with a keypoint of the angle below this is flagged `low_likelihood`.
    duration_s : float or None, optional
        End after this time, s.
    stop : threading.Event or None, optional
        Ends the measurement when set.

    Yields
    ------
    LiveValue
        Each value as soon as it is measured. Ends with the source.

    Raises
    ------
    VideoError
        The source is lost.
    AngleError
        The definition names a keypoint that the detector does not find.
    """
    check_points(detector.keypoints, definition)
    stop = stop or threading.Event()
    with _LatestFrame(source) as latest:
        # Warm-up: networks are slow the first time. Frames that arrive meanwhile are ignored.
        detector.detect(np.zeros((1, *source.size_wh[::-1], 3), np.uint8))
        if isinstance(detector, VideoDetector):
            detector = detector.follow()
        measurement = _FrameMeasurement(detector, definition, min_likelihood, source.size_wh)
        start_s = last_s = time.perf_counter()
        latest.begin.set()
        while not stop.is_set():
            now_s = time.perf_counter()
            left_s = np.inf if duration_s is None else start_s + duration_s - now_s
            if left_s <= 0:
                return
            taken = latest.take(min(_POLL_S, left_s))
            if taken is not None:
                last_s = now_s
                yield measurement.value(*taken)
            elif latest.is_over:
                return
            elif source.silence_s is not None and now_s - last_s > source.silence_s:
                raise VideoError(f"{source.name}: no frame came for {source.silence_s:g} s")


class _LatestFrame:
    """Captures the frames of a source in a thread and keeps the newest. The thread ends with the `with` block."""

    def __init__(self, source: LiveSource) -> None:
        self.begin = threading.Event()
        self._ended = False
        self._stop = threading.Event()
        self._source = source
        self._changed = threading.Condition()
        self._arrival: Arrival | None = None
        self._dropped_s: list[float] = []
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="bendtrack-capture", daemon=True)

    def __enter__(self) -> _LatestFrame:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self.begin.set()
        self._thread.join(_JOIN_S)

    @property
    def is_over(self) -> bool:
        """Whether the source has ended and its last frame was taken."""
        with self._changed:
            return self._ended and self._arrival is None and self._error is None

    def take(self, timeout_s: float) -> tuple[Arrival, tuple[float, ...]] | None:
        """The newest frame not yet taken, and the times of frames dropped before it; None after the timeout."""
        with self._changed:
            if self._arrival is None and not self._ended:
                self._changed.wait(timeout_s)
            if self._arrival is None:
                if self._error is not None:
                    raise self._error
                return None
            taken = self._arrival, tuple(self._dropped_s)
            self._arrival = None
            self._dropped_s.clear()
            return taken

    def _run(self) -> None:
        arrivals = self._source.arrivals(self.begin, self._stop)
        try:
            for arrival in arrivals:
                if self._stop.is_set():
                    break
                self._put(arrival)
        except BaseException as error:
            self._error = error
        finally:
            close = getattr(arrivals, "close", None)
            if close is not None:
                close()
            with self._changed:
                self._ended = True
                self._changed.notify()

    def _put(self, arrival: Arrival) -> None:
        with self._changed:
            if self._arrival is not None:
                self._dropped_s.append(self._arrival.frame.time_s)
            self._arrival = arrival
            self._changed.notify()


class _FrameMeasurement:
    """Applies a detector to the frames of one source."""

    def __init__(
        self,
        detector: Detector,
        definition: AngleDefinition,
        min_likelihood: float,
        size_wh: tuple[int, int],
    ) -> None:
        self._detector = detector
        self._size_wh = size_wh
        self._definition = definition
        self._min_likelihood = min_likelihood
        self._chain = [detector.keypoints.index(point) for point in definition.points]
        self._correlations = detector.correlations if isinstance(detector, TrainedDetector) else ()
        self._n_not_seen = 0  # frames since the last one given to the detector

    def value(self, arrival: Arrival, dropped_s: tuple[float, ...]) -> LiveValue:
        frame, image = arrival.frame, arrival.frame.image
        self._n_not_seen += len(dropped_s)
        if image is None:
            self._n_not_seen += 1
            found = _no_detection(len(self._detector.keypoints))
        else:
            if self._n_not_seen and isinstance(self._detector, DropAwareDetector):
                self._detector.skip_frames(self._n_not_seen)
            self._n_not_seen = 0
            found = self._detector.detect(image[None])
        rows = measure(
            found,
            self._detector.keypoints,
            self._definition,
            self._size_wh if image is None else (image.shape[1], image.shape[0]),
            decoded=np.array([image is not None]),
            damaged=np.array([frame.damaged]),
            min_likelihood=self._min_likelihood,
            correlations=self._correlations,
        )
        return LiveValue(
            frame=frame.index,
            time_s=frame.time_s,
            angle_deg=float(rows.angle_deg[0]),
            angle_sd_deg=float(rows.angle_sd_deg[0]),
            likelihood=float(found.likelihood[0, self._chain].min()),
            flag=Flag(str(rows.flag[0])),
            latency_ms=1e3 * (time.perf_counter() - arrival.at_s),
            dropped_s=dropped_s,
            found=found,
        )


def _no_detection(k: int) -> Detections:
    return Detections(np.full((1, k, 2), np.nan), np.full((1, k), np.nan), np.full((1, k, 2, 2), np.nan))
