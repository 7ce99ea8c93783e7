"""Live: the newest frame of a source becomes a bending angle; frames that were older by then are passed over.

Knows no network (any `types.Detector`) and no camera: where frames come from is in `sources.py`, how values are
sent in `output.py`.
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
from ..types import Detections, Detector, Flag, SparingDetector, VideoDetector
from ..video import Frame

_POLL_S = 0.1  # how late a wish to stop may be noticed while no frame comes
_JOIN_S = 1.0  # a camera that hangs is left alone after this


@dataclass(frozen=True)
class Arrival:
    """A frame, and when it was captured: seconds of `time.perf_counter`, as all moments here."""

    frame: Frame
    at_s: float


class LiveSource(Protocol):
    """Whatever delivers frames as time goes by.

    Attributes
    ----------
    name : str
        For messages.
    size_wh : tuple of (int, int)
        (width, height) px that the frames will most likely have.
    rate : float or None
        frames/s that it promises, None where it does not.
    silence_s : float or None
        A pause after which it counts as gone; None where a pause says nothing.
    warnings : list of str
        What the user should know, a line each; whole once it has ended.
    """

    name: str
    size_wh: tuple[int, int]
    rate: float | None
    silence_s: float | None

    @property
    def warnings(self) -> list[str]: ...

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        """Frames, each when it is there, from the moment `begin` is set until `stop` is; frame 0 is the first then."""


@dataclass(frozen=True)
class LiveValue:
    """What was measured in one frame.

    Attributes
    ----------
    frame : int
        Its number at the source, passed over ones counted.
    time_s : float
        When it was captured, from the first frame.
    angle_deg, angle_sd_deg : float
        Degrees, NaN where unknown.
    likelihood : float
        The lowest of the angle's keypoints, NaN where the frame could not be decoded.
    flag : Flag
        As in an angle table.
    latency_ms : float
        From capture to this value.
    passed_over_s : tuple of float
        `time_s` of the frames passed over since the value before.
    found : Detections
        The keypoints, N = 1.
    """

    frame: int
    time_s: float
    angle_deg: float
    angle_sd_deg: float
    likelihood: float
    flag: Flag
    latency_ms: float
    passed_over_s: tuple[float, ...]
    found: Detections

    @property
    def passed_over(self) -> int:
        """Frames passed over since the value before."""
        return len(self.passed_over_s)


def measure_live(
    source: LiveSource,
    detector: Detector,
    definition: AngleDefinition,
    *,
    min_likelihood: float = MIN_LIKELIHOOD,
    duration_s: float | None = None,
    stop: threading.Event | None = None,
) -> Generator[LiveValue, None, None]:
    """Measure the bending angle in the newest frame of a source, again and again.

    While a frame is being measured the source goes on in a thread of its own, of whose frames only the newest is
    kept. So a value is never older than its own measurement and the one before it, however slow the detector is.

    Parameters
    ----------
    source : LiveSource
        Where the frames come from; read once.
    detector : Detector
        Finds keypoints in frames; a `VideoDetector` is asked for one of its own for this source.
    definition : AngleDefinition
        Which angle, of which of the detector's keypoints.
    min_likelihood : float, optional
        A value with a keypoint of the angle below this is flagged `low_likelihood`.
    duration_s : float or None, optional
        End after this time.
    stop : threading.Event or None, optional
        Ends it when set.

    Yields
    ------
    LiveValue
        As soon as it is measured. Ends with the source.

    Raises
    ------
    VideoError
        The source is gone.
    AngleError
        The definition names a keypoint that the detector does not find.
    """
    check_points(detector.keypoints, definition)
    stop = stop or threading.Event()
    with _Newest(source) as newest:
        # Networks are slow the first time. Frames that come meanwhile are not yet wanted.
        detector.detect(np.zeros((1, *source.size_wh[::-1], 3), np.uint8))
        if isinstance(detector, VideoDetector):
            detector = detector.follow()
        measuring = _Measuring(detector, definition, min_likelihood, source.size_wh)
        begun_s = last_s = time.perf_counter()
        newest.begin.set()
        while not stop.is_set():
            now_s = time.perf_counter()
            left_s = np.inf if duration_s is None else begun_s + duration_s - now_s
            if left_s <= 0:
                return
            taken = newest.take(min(_POLL_S, left_s))
            if taken is not None:
                last_s = now_s
                yield measuring.value(*taken)
            elif newest.is_over:
                return
            elif source.silence_s is not None and now_s - last_s > source.silence_s:
                raise VideoError(f"{source.name}: no frame came for {source.silence_s:g} s")


class _Newest:
    """Takes all frames of a source in a thread, and keeps the newest. Leave the `with` block to end the thread."""

    def __init__(self, source: LiveSource) -> None:
        self.begin = threading.Event()
        self._ended = False
        self._stop = threading.Event()
        self._source = source
        self._changed = threading.Condition()
        self._arrival: Arrival | None = None
        self._passed_over_s: list[float] = []
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="bendtrack-capture", daemon=True)

    def __enter__(self) -> _Newest:
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self.begin.set()
        self._thread.join(_JOIN_S)

    @property
    def is_over(self) -> bool:
        """Whether the source has ended and there is nothing left to take."""
        with self._changed:
            return self._ended and self._arrival is None and self._error is None

    def take(self, timeout_s: float) -> tuple[Arrival, tuple[float, ...]] | None:
        """The newest frame not yet taken, and the times of those passed over for it; None if there is none in time."""
        with self._changed:
            if self._arrival is None and not self._ended:
                self._changed.wait(timeout_s)
            if self._arrival is None:
                if self._error is not None:
                    raise self._error
                return None
            taken = self._arrival, tuple(self._passed_over_s)
            self._arrival = None
            self._passed_over_s.clear()
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
                self._passed_over_s.append(self._arrival.frame.time_s)
            self._arrival = arrival
            self._changed.notify()


class _Measuring:
    """A detector at work on frames of one source."""

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
        self._unseen = 0  # frames since the last that the detector was given

    def value(self, arrival: Arrival, passed_over_s: tuple[float, ...]) -> LiveValue:
        frame, image = arrival.frame, arrival.frame.image
        self._unseen += len(passed_over_s)
        if image is None:
            self._unseen += 1
            found = _nothing(len(self._detector.keypoints))
        else:
            if self._unseen and isinstance(self._detector, SparingDetector):
                self._detector.pass_over(self._unseen)
            self._unseen = 0
            found = self._detector.detect(image[None])
        rows = measure(
            found,
            self._detector.keypoints,
            self._definition,
            self._size_wh if image is None else (image.shape[1], image.shape[0]),
            decoded=np.array([image is not None]),
            damaged=np.array([frame.damaged]),
            min_likelihood=self._min_likelihood,
        )
        return LiveValue(
            frame=frame.index,
            time_s=frame.time_s,
            angle_deg=float(rows.angle_deg[0]),
            angle_sd_deg=float(rows.angle_sd_deg[0]),
            likelihood=float(found.likelihood[0, self._chain].min()),
            flag=Flag(str(rows.flag[0])),
            latency_ms=1e3 * (time.perf_counter() - arrival.at_s),
            passed_over_s=passed_over_s,
            found=found,
        )


def _nothing(k: int) -> Detections:
    return Detections(np.full((1, k, 2), np.nan), np.full((1, k), np.nan), np.full((1, k, 2, 2), np.nan))
