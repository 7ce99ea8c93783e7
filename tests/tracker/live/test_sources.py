"""Where live frames come from: files in real time, real servers on this machine, and which camera is meant."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.live.cameras import Camera, CameraMode, cameras, find_camera, opening
from bendtrack.tracker.live.low_latency import measure_live
from bendtrack.tracker.live.sources import PlayedFile, Stream, open_source
from bendtrack.tracker.video import Video

ANGLE = AngleDefinition("two-vector", ("base_1", "base_2", "tip_1", "tip_2"))
NEVER_S = 20.0


@contextmanager
def served(handler: type[BaseHTTPRequestHandler]) -> Iterator[str]:
    """A web server on this machine, and its address."""
    handler.log_message = lambda *args: None  # type: ignore[method-assign]
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def files_of(folder: Path) -> type[BaseHTTPRequestHandler]:
    """What serves the files of a folder."""

    class Files(SimpleHTTPRequestHandler):
        def __init__(self, *args: object) -> None:
            super().__init__(*args, directory=str(folder))  # type: ignore[arg-type]

    return Files


# --- files


def test_a_file_plays_by_its_presentation_times(film, tmp_path):
    """Odd times, the first not 0: frames come when they are due, never before."""
    times_s = 2.5 + np.cumsum([0.0, 0.03, 0.01, 0.12, 0.02])
    images = [film.draw_arm(20, number=n) for n in range(5)]
    path = film.encode(tmp_path / "odd.mp4", images, times_s=list(times_s))
    begin, stop = threading.Event(), threading.Event()
    begin.set()
    begun_s = time.perf_counter()
    arrivals = []
    for arrival in PlayedFile(path).arrivals(begin, stop):
        assert time.perf_counter() >= arrival.at_s
        arrivals.append(arrival)
    assert [film.frame_number(arrival.frame.image) for arrival in arrivals] == list(range(5))
    expected_s = times_s - times_s[0]
    np.testing.assert_allclose([arrival.frame.time_s for arrival in arrivals], expected_s, atol=2e-5)
    np.testing.assert_allclose([a.at_s - arrivals[0].at_s for a in arrivals], expected_s, atol=2e-5)
    assert arrivals[0].at_s >= begun_s


def test_a_pause_in_a_file_can_be_left(film, tmp_path):
    path = film.encode(tmp_path / "pause.mp4", [film.draw_arm(20)] * 2, times_s=[0.0, 3600.0])
    begin, stop = threading.Event(), threading.Event()
    begin.set()
    arrivals = PlayedFile(path).arrivals(begin, stop)
    next(arrivals)
    threading.Timer(0.05, stop.set).start()
    assert list(arrivals) == []


# --- streams


def test_a_camera_that_serves_jpegs(film):
    """Pictures without times, as network cameras send them; then the camera is gone."""
    jpeg = io.BytesIO()
    PIL.Image.fromarray(film.draw_arm(70.0)).save(jpeg, "JPEG", quality=95, subsampling=0)
    gone = threading.Event()

    class JpegCamera(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            while not gone.wait(0.01):
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {jpeg.tell()}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg.getvalue() + b"\r\n")

    with served(JpegCamera) as url:
        source = open_source(f"{url}/live")
        assert source.size_wh == (160, 120)
        live = measure_live(source, film.DiscDetector(), ANGLE)
        values = [next(live) for _ in range(5)]
        gone.set()
        with pytest.raises(VideoError, match=r"127\.0\.0\.1:\d+/live: stopped delivering frames"):
            list(live)
    assert values[0].frame == 0
    np.testing.assert_allclose([value.angle_deg for value in values], 70, atol=1.5)
    # Frames that came before it was ready are not counted, and time is the time of their coming.
    times_s = [value.time_s for value in values]
    assert times_s[0] == 0
    assert (np.diff(times_s) > 0).all()


def test_a_recording_on_a_server_plays_in_real_time(film, tmp_path):
    """A server sends it as fast as it can, and its end is an end like a file's."""
    images = [film.draw_arm(10.0 * n, number=n) for n in range(12)]
    film.encode(tmp_path / "film.mp4", images, rate=60, container_options={"movflags": "+faststart"})

    begin, stop = threading.Event(), threading.Event()
    begin.set()
    with served(files_of(tmp_path)) as url:
        arrivals = []
        for arrival in open_source(f"{url}/film.mp4").arrivals(begin, stop):
            assert time.perf_counter() >= arrival.at_s
            arrivals.append(arrival)
    assert [film.frame_number(arrival.frame.image) for arrival in arrivals] == list(range(12))
    np.testing.assert_allclose([a.at_s - arrivals[0].at_s for a in arrivals], np.arange(12) / 60, atol=1e-3)
    np.testing.assert_allclose([a.frame.time_s for a in arrivals], np.arange(12) / 60, atol=1e-3)


@pytest.mark.parametrize(("codec", "options"), [("mjpeg", {}), ("libx264", {"g": "6", "bf": "0"})])
def test_damage_means_in_a_stream_what_it_means_in_a_file(film, tmp_path, codec, options):
    """A packet of zeros: that frame is lost, and with H.264 those up to the next key frame are doubtful."""
    images = [film.draw_arm(10.0 * n, number=n) for n in range(12)]
    pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    whole = film.encode(
        tmp_path / "whole.mkv", images, codec=codec, options=options, pix_fmt=pix_fmt, rate=60
    )
    position, size = film.packet_places(whole)[2]
    data = bytearray(whole.read_bytes())
    data[position + size // 4 : position + size] = bytes(size - size // 4)
    (tmp_path / "hole.mkv").write_bytes(data)
    begin, stop = threading.Event(), threading.Event()
    begin.set()
    with served(files_of(tmp_path)) as url:
        frames = [arrival.frame for arrival in open_source(f"{url}/hole.mkv").arrivals(begin, stop)]
    states = [(frame.index, frame.decoded is None, frame.damaged) for frame in frames]
    expected = [(n, n == 2, codec == "libx264" and n in (3, 4, 5)) for n in range(12)]
    assert states == expected
    in_file = [(frame.index, frame.decoded is None, frame.damaged) for frame in Video(tmp_path / "hole.mkv")]
    assert in_file == expected


def test_a_device_of_ffmpeg_delivers_as_it_likes(film):
    """FFmpeg's own test source replaces a camera: the same kind of input, available on every machine."""
    source = Stream("testsrc=size=160x120:rate=100,realtime", "camera test", "lavfi", {})
    assert (source.size_wh, source.rate) == ((160, 120), 100)
    begin, stop = threading.Event(), threading.Event()
    begin.set()
    arrivals = []
    for arrival in source.arrivals(begin, stop):
        arrivals.append(arrival)
        if len(arrivals) == 8:
            break
    assert [arrival.frame.index for arrival in arrivals] == list(range(8))
    np.testing.assert_allclose([arrival.frame.time_s for arrival in arrivals], np.arange(8) / 100, atol=1e-6)
    assert arrivals[0].frame.image.shape == (120, 160, 3)


def test_frames_before_the_beginning_are_not_wanted():
    source = Stream("testsrc=size=160x120:rate=200,realtime", "camera test", "lavfi", {})
    begin, stop = threading.Event(), threading.Event()
    threading.Timer(0.1, begin.set).start()
    begun_s = time.perf_counter()
    first = next(iter(source.arrivals(begin, stop)))
    assert (first.frame.index, first.frame.time_s) == (0, 0.0)
    assert first.at_s >= begun_s + 0.1


# --- which source is meant


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ("nothing.mp4", "nothing.mp4: no such file"),
        ("some/where", "some/where: no such file"),
        ("ftp://camera/1", "ftp://camera/1: expected a URL that begins with http"),
        ("file:///etc/hostname", "expected a URL that begins with http"),
        ("rtsp://127.0.0.1:9/live", r"rtsp://127\.0\.0\.1:9/live: cannot be opened \(Connection refused\)"),
        ("/dev/null", r"camera /dev/null: cannot be opened"),
        ("977", "977: no such camera, video file or URL; "),
        ("No Such Webcam", "No Such Webcam: no such camera, video file or URL; "),
    ],
)
def test_what_is_not_there(wanted: str, message: str):
    with pytest.raises(VideoError, match=message):
        open_source(wanted)


def test_a_text_and_a_page_are_not_video(tmp_path: Path):
    (tmp_path / "notes.mp4").write_text("no video at all")
    with pytest.raises(VideoError, match="not a video"):
        open_source(str(tmp_path / "notes.mp4"))

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<html>Not found, but nicely</html>")

    with served(Page) as url, pytest.raises(VideoError, match="cannot be opened"):
        open_source(f"{url}/live")


def test_a_file_cannot_be_told_how_to_run(film, tmp_path):
    path = film.encode(tmp_path / "a.mp4", [film.draw_arm(0)])
    with pytest.raises(VideoError, match="--size, --rate and --camera-format: expected a camera, got"):
        open_source(str(path), CameraMode(rate=60))


ON_LINUX = [Camera("/dev/video0", "HD Webcam"), Camera("/dev/video2", "USB Microscope")]
ELSEWHERE = [Camera("video=@device_1", "HD Webcam"), Camera("video=@device_2", "USB Microscope")]


@pytest.mark.parametrize(
    ("wanted", "among", "address"),
    [
        (None, ON_LINUX, "/dev/video0"),
        ("2", ON_LINUX, "/dev/video2"),
        ("usb microscope", ON_LINUX, "/dev/video2"),
        ("webcam", ON_LINUX, "/dev/video0"),
        ("1", ELSEWHERE, "video=@device_2"),
        ("Microscope", ELSEWHERE, "video=@device_2"),
    ],
)
def test_a_camera_is_called_by_number_or_name(wanted, among, address):
    assert find_camera(wanted, among).address == address


@pytest.mark.parametrize(
    ("wanted", "among", "message"),
    [
        (None, [], "expected a camera, a video file or a URL: no camera was found"),
        ("1", ON_LINUX, "no such camera, .*; the cameras here are 0: HD Webcam; 2: USB Microscope"),
        ("2", ELSEWHERE, "no such camera, .*; the cameras here are 0: HD Webcam; 1: USB Microscope"),
        ("e", ON_LINUX, "more than one camera is called so"),
    ],
)
def test_a_camera_that_is_not_there(wanted, among, message):
    with pytest.raises(VideoError, match=message):
        find_camera(wanted, among)


@pytest.mark.parametrize(
    ("system", "input", "format_option"),
    [
        ("linux", "v4l2", "input_format"),
        ("darwin", "avfoundation", "pixel_format"),
        ("win32", "dshow", "vcodec"),
    ],
)
def test_how_ffmpeg_is_asked(monkeypatch, system, input, format_option):
    monkeypatch.setattr("sys.platform", system)
    asked, options = opening(CameraMode((1280, 720), 59.94, "mjpeg"))
    assert asked == input
    assert options == {"video_size": "1280x720", "framerate": "59.94", format_option: "mjpeg"}


def test_listing_cameras_never_fails():
    assert all(camera.address and camera.name for camera in cameras())
