"""Real videos, drawn and encoded by the tests, and a detector that finds what they show."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from bendtrack.tracker.types import Detections

# Colours of the four discs, far apart also after 4:2:0 chroma.
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]], dtype=np.uint8)
KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


def draw_arm(
    angle_deg: float, size_wh: tuple[int, int] = (160, 120), number: int | None = None
) -> np.ndarray:
    """Four discs as a chain that turns by `angle_deg` (clockwise as seen), and a frame number in binary."""
    width, height = size_wh
    image = np.full((height, width, 3), 90, np.uint8)
    y, x = np.mgrid[:height, :width]
    for (u, v), colour in zip(arm_xy(angle_deg, size_wh), COLOURS, strict=True):
        image[(x - u) ** 2 + (y - v) ** 2 <= 25] = colour
    if number is not None:
        for bit in range(10):
            image[:8, 8 * bit : 8 * bit + 8] = 255 if number >> bit & 1 else 0
    return image


def arm_xy(angle_deg: float, size_wh: tuple[int, int] = (160, 120)) -> np.ndarray:
    """Centres (4, 2) of the discs: base from left to right, tip turned by the angle."""
    width, height = size_wh
    base = np.array([[0.2 * width, 0.4 * height], [0.45 * width, 0.4 * height]])
    half, turn = np.radians(angle_deg / 2), np.radians(angle_deg)
    tip = base[1] + 0.18 * width * np.array([np.cos(half), np.sin(half)])
    return np.stack([*base, tip, tip + 0.2 * width * np.array([np.cos(turn), np.sin(turn)])])


def frame_number(image: np.ndarray) -> int:
    """The number that `draw_arm` drew."""
    return sum(int(image[4, 8 * bit + 4].mean() > 128) << bit for bit in range(10))


def encode(
    path: Path,
    images: Sequence[np.ndarray],
    *,
    codec: str = "libx264",
    times_s: Sequence[float] | None = None,
    rotation_deg: int | None = None,
    options: Mapping[str, str] | None = None,
    container_options: Mapping[str, str] | None = None,
    pix_fmt: str = "yuv420p",
    rate: int = 30,
    flip: bool = False,
    with_audio: bool = False,
) -> Path:
    """Encode RGB images with their own times (default: at the rate)."""
    time_base = Fraction(1, 90_000)
    with av.open(str(path), "w", options=dict(container_options or {})) as container:
        stream = container.add_stream(codec, rate=rate, options=dict(options or {}))
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = pix_fmt
        if times_s is not None:
            stream.codec_context.time_base = time_base
        if rotation_deg is not None or flip:
            stream.set_display_rotation(rotation_deg or 0, hflip=flip)
        if with_audio:
            container.add_stream("aac", rate=16_000)
        for number, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image)
            if times_s is not None:
                frame.pts, frame.time_base = round(times_s[number] / time_base), time_base
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


def packet_places(path: Path) -> list[tuple[int, int]]:
    """(position, size) in the file of each video packet, in decoding order."""
    with av.open(str(path)) as container:
        return [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]


def cut(path: Path, out: Path, fraction: float) -> Path:
    """The first part of a file."""
    data = path.read_bytes()
    out.write_bytes(data[: int(len(data) * fraction)])
    return out


class DiscDetector:
    """Finds the discs of `draw_arm` by colour, counting what it was given."""

    keypoints = KEYPOINTS
    provenance: Mapping[str, Any] = {"name": "discs"}

    def __init__(self, batch_size: int = 4) -> None:
        self.batch_size = batch_size
        self.batches: list[int] = []

    def detect(self, frames: np.ndarray) -> Detections:
        self.batches.append(len(frames))
        xy = np.empty((len(frames), 4, 2))
        likelihood = np.ones((len(frames), 4))
        for n, image in enumerate(frames):
            for k, colour in enumerate(COLOURS):
                distance = np.abs(image.astype(int) - colour).sum(axis=2)
                distance[:8] = 1000  # the frame number
                v, u = np.nonzero(distance < 150)
                xy[n, k] = (u.mean(), v.mean()) if len(u) else np.nan
                likelihood[n, k] = min(1.0, len(u) / 60)
        covariance = np.broadcast_to(0.04 * np.eye(2), (len(frames), 4, 2, 2)).copy()
        return Detections(xy, likelihood, covariance)


def peak_memory(code: str, videos: Mapping[int, Path], *args: str) -> list[int]:
    """Peak memory of a script for each video, in processes of their own that run at the same time.

    The script gets the video as its first argument, prints the number of frames, and ends.
    """
    # On Linux not ru_maxrss, which includes the memory of the process that started this one.
    code += (
        "\nimport re, resource\nfrom pathlib import Path\nstatus = Path('/proc/self/status')\n"
        "print(re.search(r'VmHWM:\\s+(\\d+)', status.read_text())[1] if status.exists() else\n"
        "      resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    running = [
        subprocess.Popen([sys.executable, "-c", code, str(path), *args], stdout=subprocess.PIPE, text=True)
        for path in videos.values()
    ]
    outputs = [process.communicate()[0].split() for process in running]
    assert [process.returncode for process in running] == [0] * len(videos)
    assert [int(n) for n, _ in outputs] == list(videos)
    return [int(peak) for _, peak in outputs]


class Film:
    """What the tests of video need to make their own: functions of this file by name."""

    keypoints = KEYPOINTS
    draw_arm = staticmethod(draw_arm)
    arm_xy = staticmethod(arm_xy)
    frame_number = staticmethod(frame_number)
    encode = staticmethod(encode)
    packet_places = staticmethod(packet_places)
    cut = staticmethod(cut)
    DiscDetector = DiscDetector
    peak_memory = staticmethod(peak_memory)


@pytest.fixture(scope="session")
def film() -> type[Film]:
    return Film


@pytest.fixture(scope="session")
def arm_angles_deg() -> np.ndarray:
    """Angles of the frames of `arm_video`: beyond 90 degrees and back."""
    return 60 - 60 * np.cos(np.linspace(0, 2 * np.pi, 60))


@pytest.fixture(scope="session")
def arm_images(arm_angles_deg: np.ndarray) -> list[np.ndarray]:
    return [draw_arm(angle, number=n) for n, angle in enumerate(arm_angles_deg)]


@pytest.fixture(scope="session")
def arm_video(tmp_path_factory: pytest.TempPathFactory, arm_images: list[np.ndarray]) -> Path:
    """Sixty frames of H.264 with B-frames, a key frame every 20, index in front."""
    path = tmp_path_factory.mktemp("arm") / "arm.mp4"
    options = {"g": "20", "bf": "3", "crf": "16"}
    return encode(path, arm_images, options=options, container_options={"movflags": "+faststart"})


@pytest.fixture(scope="session")
def short_and_long_video(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """Two videos by their number of frames, one ten times as long: memory must not grow with the length."""
    folder = tmp_path_factory.mktemp("lengths")
    images = [draw_arm(angle) for angle in np.linspace(0, 90, 20)]
    return {
        count: encode(folder / f"{count}.mp4", [images[n % 20] for n in range(count)], codec="mpeg4")
        for count in (300, 3000)
    }
