"""Low-latency mode: only the newest frame is measured, however slow the detector; values equal a table's rows."""

from __future__ import annotations

import csv
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.container import Orientation
from bendtrack.tracker.errors import AngleError, BendtrackError, VideoError
from bendtrack.tracker.live.low_latency import Arrival, LiveValue, measure_live
from bendtrack.tracker.live.output import COLUMNS, HEADER, UdpTarget, line_of
from bendtrack.tracker.live.recording import Recording
from bendtrack.tracker.live.sources import PlayedFile
from bendtrack.tracker.results import read_results, write_results
from bendtrack.tracker.tracking import track
from bendtrack.tracker.types import Detections, Flag
from bendtrack.tracker.video import Frame

ANGLE = AngleDefinition("two-vector", ("base_1", "base_2", "tip_1", "tip_2"))
NEVER_S = 20.0  # waits end by an event long before, or the test fails


class Scripted:
    """A source that does as a script says: it yields images, and between them waits for what it likes."""

    name = "script"
    rate = None
    warnings: Sequence[str] = []

    def __init__(
        self,
        script: Callable[[threading.Event], Iterator[np.ndarray | None]],
        size_wh: tuple[int, int],
        silence_s: float | None = None,
    ) -> None:
        self.size_wh, self.silence_s, self._script = size_wh, silence_s, script

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        begin.wait()
        for index, image in enumerate(self._script(stop)):
            frame = None if image is None else av.VideoFrame.from_ndarray(image)
            yield Arrival(Frame(index, index / 60, frame, Orientation()), time.perf_counter())


class Watched:
    """A source that says when it has come to its end."""

    def __init__(self, source: Any) -> None:
        self._source, self.ended = source, threading.Event()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._source, name)

    def arrivals(self, begin: threading.Event, stop: threading.Event) -> Iterator[Arrival]:
        yield from self._source.arrivals(begin, stop)
        self.ended.set()


@pytest.fixture
def short_video(tmp_path: Path, film) -> Path:
    """Twelve frames in a fifth of a second, beyond 90 degrees."""
    images = [film.draw_arm(angle, number=n) for n, angle in enumerate(np.linspace(0, 120, 12))]
    return film.encode(tmp_path / "short.mp4", images, rate=60, options={"crf": "16"})


def number_of(value: LiveValue) -> int:
    """The frame's number by its angle, which goes up by 10 degrees a frame."""
    return round(value.angle_deg / 10)


# --- dropped frames


def test_while_the_detector_works_only_the_newest_frame_is_kept(film):
    """Frame 0 is being measured until 1, 2, 3 and 4 have come: then 4 is measured, and the others never are."""
    images = [film.draw_arm(10.0 * n) for n in range(6)]
    at_work, four_is_kept, done = threading.Event(), threading.Event(), threading.Event()

    def script(stop: threading.Event) -> Iterator[np.ndarray]:
        yield images[0]
        assert at_work.wait(NEVER_S)
        yield from images[1:5]
        four_is_kept.set()  # the capture asks for the next one, so it has put this one away
        assert done.wait(NEVER_S)
        yield images[5]

    class Slow(film.DiscDetector):
        def detect(self, frames: np.ndarray) -> Detections:
            found = super().detect(frames)
            if len(self.batches) == 2:  # the first was the warming up
                at_work.set()
                assert four_is_kept.wait(NEVER_S)
            return found

    values = []
    for value in measure_live(Scripted(script, (160, 120)), Slow(), ANGLE):
        values.append(value)
        if value.frame == 4:
            done.set()
    assert [value.frame for value in values] == [0, 4, 5]
    assert [number_of(value) for value in values] == [0, 4, 5]
    assert [value.dropped for value in values] == [0, 3, 0]
    assert values[1].dropped_s == pytest.approx((1 / 60, 2 / 60, 3 / 60))
    assert all(value.latency_ms > 0 for value in values)


def test_a_file_is_not_waited_for_either(film, short_video):
    """A detector that is still at the first frame when the film is over goes on with the last one."""
    source = Watched(PlayedFile(short_video))

    class Slow(film.DiscDetector):
        def detect(self, frames: np.ndarray) -> Detections:
            found = super().detect(frames)
            assert len(self.batches) == 1 or source.ended.wait(NEVER_S)
            return found

    values = list(measure_live(source, Slow(), ANGLE))
    assert [value.frame for value in values] == [0, 11]
    assert values[1].dropped == 10
    assert values[1].angle_deg == pytest.approx(120, abs=1.5)
    # The last frame waited for the first to be measured, not longer; the first took as long as the film.
    assert values[0].latency_ms > values[1].latency_ms
    assert values[0].latency_ms >= 1e3 * 11 / 60


def test_the_detector_is_notified_of_dropped_frames(film):
    dropped: list[int] = []
    at_work, kept = threading.Event(), threading.Event()

    def script(stop: threading.Event) -> Iterator[np.ndarray | None]:
        yield film.draw_arm(0)
        assert at_work.wait(NEVER_S)
        for n in range(1, 4):
            yield film.draw_arm(10.0 * n)
        kept.set()

    class DetectorOfOneVideo(film.DiscDetector):
        def skip_frames(self, count: int) -> None:
            dropped.append(count)

        def detect(self, frames: np.ndarray) -> Detections:
            at_work.set()
            assert kept.wait(NEVER_S)
            return super().detect(frames)

    class Follows(film.DiscDetector):
        workers = 1

        def chunk_frames(self, size_wh: tuple[int, int], frames: int | None) -> int:
            return self.batch_size

        def follow(self) -> DetectorOfOneVideo:
            return DetectorOfOneVideo()

    values = list(measure_live(Scripted(script, (160, 120)), Follows(), ANGLE))
    assert [value.frame for value in values] == [0, 3]
    assert dropped == [2]


# --- what a value means


def test_values_are_the_rows_of_the_table(film, tmp_path):
    """With a frame that cannot be decoded, one that shows nothing, and a threshold."""
    images = [film.draw_arm(10.0 * n) for n in range(12)]
    images[5] = np.full_like(images[5], 90)
    images[8][:] = np.where(np.arange(160)[:, None] < 70, images[8], 90)  # the tip's end is hidden
    whole = film.encode(tmp_path / "whole.avi", images, codec="mjpeg", pix_fmt="yuvj420p", rate=10)
    position, size = film.packet_places(whole)[3]
    data = bytearray(whole.read_bytes())
    data[position : position + size] = bytes(size)
    path = tmp_path / "hole.avi"
    path.write_bytes(data)
    table = track(path, film.DiscDetector(), ANGLE, min_likelihood=0.7)
    assert {Flag.UNDECODABLE, Flag.LOW_LIKELIHOOD} < set(table.flag)

    values = list(measure_live(PlayedFile(path), film.DiscDetector(), ANGLE, min_likelihood=0.7))
    assert len(values) > 1
    for value in values:
        row = value.frame
        np.testing.assert_array_equal(value.angle_deg, table.angle_deg[row])
        np.testing.assert_array_equal(value.angle_sd_deg, table.angle_sd_deg[row])
        np.testing.assert_array_equal(value.likelihood, table.likelihood[row].min())
        np.testing.assert_array_equal(value.found.xy[0], table.xy[row])
        assert (value.flag, value.time_s) == (table.flag[row], table.time_s[row])


def test_likelihood_is_the_lowest_of_the_points_of_the_angle(film):
    class Unsure(film.DiscDetector):
        def detect(self, frames: np.ndarray) -> Detections:
            found = super().detect(frames)
            found.likelihood[:] = [0.9, 0.8, 0.7, 0.1]
            return found

    of_three = AngleDefinition("three-point", ANGLE.points[:3])
    source = Scripted(lambda stop: iter([film.draw_arm(30)]), (160, 120))
    (value,) = measure_live(source, Unsure(), of_three)
    assert (value.likelihood, value.flag) == (0.7, Flag.NONE)


def test_an_angle_of_points_that_are_not_found_is_refused(film):
    other = AngleDefinition("three-point", ("base_1", "elbow", "tip_2"))
    source = Scripted(lambda stop: iter([]), (160, 120))
    with pytest.raises(AngleError, match="needs keypoint 'elbow'"):
        next(measure_live(source, film.DiscDetector(), other))


# --- how it ends


def test_an_event_ends_it_and_the_thread(film):
    stop = threading.Event()

    def script(stop_source: threading.Event) -> Iterator[np.ndarray]:
        while True:
            yield film.draw_arm(20)

    values = measure_live(Scripted(script, (160, 120)), film.DiscDetector(), ANGLE, stop=stop)
    next(values)
    stop.set()
    assert list(values) == []
    assert "bendtrack-capture" not in [thread.name for thread in threading.enumerate()]


def test_it_ends_after_its_duration(film, tmp_path):
    path = film.encode(tmp_path / "long.mp4", [film.draw_arm(30)] * 120, rate=60)
    values = list(measure_live(PlayedFile(path), film.DiscDetector(), ANGLE, duration_s=0.3))
    assert values
    assert max(value.time_s for value in values) < 0.3  # later ones come later than that


def test_a_silent_source_counts_as_gone(film):
    def script(stop: threading.Event) -> Iterator[np.ndarray]:
        yield film.draw_arm(30)
        stop.wait(NEVER_S)

    values = measure_live(Scripted(script, (160, 120), silence_s=0.05), film.DiscDetector(), ANGLE)
    assert next(values).frame == 0
    with pytest.raises(VideoError, match=r"script: no frame came for 0\.05 s"):
        next(values)


def test_what_came_before_a_failure_is_measured_first(film):
    def script(stop: threading.Event) -> Iterator[np.ndarray]:
        yield film.draw_arm(30)
        raise VideoError("script: unplugged")

    values = measure_live(Scripted(script, (160, 120)), film.DiscDetector(), ANGLE)
    assert next(values).angle_deg == pytest.approx(30, abs=1.5)
    with pytest.raises(VideoError, match="unplugged"):
        next(values)


# --- output


def value_of(**changes: Any) -> LiveValue:
    nothing = Detections(np.full((1, 4, 2), np.nan), np.full((1, 4), np.nan), np.full((1, 4, 2, 2), np.nan))
    fields: dict[str, Any] = {
        "frame": 7,
        "time_s": 0.25,
        "angle_deg": -0.00001,
        "angle_sd_deg": 0.4,
        "likelihood": 0.87654,
        "flag": Flag.LOW_LIKELIHOOD,
        "latency_ms": 12.3456,
        "dropped_s": (0.1, 0.2),
        "found": nothing,
    }
    return LiveValue(**{**fields, **changes})


def test_lines():
    assert line_of(value_of(), "csv") == "7,0.250000,0.0000,0.4000,0.8765,low_likelihood,12.35,2"
    missing = value_of(angle_deg=np.nan, angle_sd_deg=np.nan, likelihood=np.nan, flag=Flag.UNDECODABLE)
    text = f"{HEADER}\n{line_of(missing, 'csv')}\n"
    (row,) = csv.DictReader(text.splitlines())
    assert (row["angle_deg"], row["likelihood"], row["flag"]) == ("", "", "undecodable")
    read = json.loads(line_of(missing, "jsonl"))
    assert tuple(read) == COLUMNS
    assert (read["angle_deg"], read["frame"], read["passed_over"]) == (None, 7, 2)
    assert json.loads(line_of(value_of(flag=Flag.NONE), "jsonl"))["flag"] == ""


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_a_datagram_a_line(host: str):
    family = socket.AF_INET6 if host == "[::1]" else socket.AF_INET
    try:
        listener = socket.socket(family, socket.SOCK_DGRAM)
        listener.bind(("::1" if host == "[::1]" else "127.0.0.1", 0))
    except OSError:
        pytest.skip("no IPv6 here")
    with listener:
        listener.settimeout(NEVER_S)
        with UdpTarget(f"{host}:{listener.getsockname()[1]}") as target:
            for text in ("one\n", "two\n"):
                target.send(text)
        assert [listener.recv(100) for _ in range(2)] == [b"one\n", b"two\n"]


def test_nobody_need_listen():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{unused.getsockname()[1]}"
    with UdpTarget(address) as target:
        for _ in range(3):
            target.send("into the void")


@pytest.mark.parametrize(
    "address", ["", "5005", "host", "host:", ":5005", "host:port", "1.2.3.4:70000", "h:0"]
)
def test_bad_addresses(address: str):
    with pytest.raises(BendtrackError, match=r"--udp: expected HOST:PORT such as 127\.0\.0\.1:5005, got"):
        UdpTarget(address)


def test_a_recording_has_a_row_for_every_frame(film, tmp_path):
    at_work, kept = threading.Event(), threading.Event()

    def script(stop: threading.Event) -> Iterator[np.ndarray | None]:
        yield film.draw_arm(0)
        assert at_work.wait(NEVER_S)
        yield film.draw_arm(10)
        yield film.draw_arm(20)
        kept.set()
        while not stop.is_set():
            yield None

    class Slow(film.DiscDetector):
        def detect(self, frames: np.ndarray) -> Detections:
            if self.batches:
                at_work.set()
                assert kept.wait(NEVER_S)
            return super().detect(frames)

    recording = Recording(film.keypoints, ANGLE)
    values = []
    stop = threading.Event()
    for value in measure_live(Scripted(script, (160, 120)), Slow(), ANGLE, stop=stop):
        recording.add(value)
        values.append(value)
        if len(values) == 3:
            stop.set()
    table = recording.table("script", {"name": "discs"}, {"min_likelihood": 0.6}, ["a word"])
    write_results(table, tmp_path, "live")
    read = read_results(tmp_path / "live.h5")
    frames = [value.frame for value in values]
    assert len(read) == frames[-1] + 1
    np.testing.assert_allclose(read.time_s, np.arange(len(read)) / 60)
    dropped = np.setdiff1d(np.arange(len(read)), frames)
    assert len(dropped) >= 1
    assert set(read.flag[dropped]) == {"passed_over"}
    assert np.isnan(read.angle_deg[dropped]).all()
    assert np.isnan(read.xy[dropped]).all()
    for value in values:
        np.testing.assert_array_equal(read.angle_deg[value.frame], value.angle_deg)
        np.testing.assert_array_equal(read.covariance[value.frame], value.found.covariance[0])
        assert read.flag[value.frame] == value.flag
    assert read.provenance["video"]["frames_passed_over"] == len(dropped)
    assert read.provenance["warnings"] == ["a word"]
