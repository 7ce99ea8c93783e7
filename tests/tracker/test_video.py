"""Reading real video files: whole, rotated, uneven in time, or no video at all."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.hashing import file_sha256
from bendtrack.tracker.video import Video, read_frame, spread_frames, video_stem

FRAMES = 60


def test_every_frame_comes_in_order_with_its_time(arm_video, film):
    """H.264 with B-frames: not decoded in the order of display, and held back by the decoder to the end."""
    with Video(arm_video) as video:
        assert (video.size_wh, video.claimed_frames, video.codec) == ((160, 120), FRAMES, "h264")
        assert video.frame_rate == pytest.approx(30)
        frames = list(video)
        assert video.warnings == []
        assert video.complete
    assert [frame.index for frame in frames] == list(range(FRAMES))
    assert [film.frame_number(frame.image) for frame in frames] == list(range(FRAMES))
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(FRAMES) / 30, atol=1e-4)
    assert not any(frame.damaged for frame in frames)


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mkv", "libx264", {"bf": "3"}),
        ("a.avi", "libx264", {"bf": "3"}),
        ("b.avi", "mpeg4", {"bf": "2"}),
        ("c.avi", "mjpeg", {}),
        ("a.ts", "libx264", {"bf": "3"}),
        ("a.mov", "libx264", {"bf": "3"}),
        ("a.webm", "libvpx", {"auto-alt-ref": "1", "lag-in-frames": "16", "cpu-used": "5"}),
        ("b.webm", "libvpx-vp9", {"deadline": "realtime", "cpu-used": "8"}),
        ("h.mp4", "libx265", {"x265-params": "log-level=none"}),
    ],
)
def test_containers_and_codecs(tmp_path, arm_images, film, name, codec, options):
    pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
    path = film.encode(tmp_path / name, arm_images, codec=codec, options=options, pix_fmt=pix_fmt)
    video = Video(path)
    frames = list(video)
    assert [film.frame_number(frame.image) for frame in frames] == list(range(FRAMES))
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(FRAMES) / 30, atol=1.1e-3)
    assert video.warnings == []


def test_colours_survive(tmp_path, film):
    image = np.zeros((64, 96, 3), np.uint8)
    image[:, :32], image[:, 32:64], image[:, 64:] = (230, 40, 30), (20, 160, 110), (10, 110, 180)
    path = film.encode(tmp_path / "colour.mp4", [image] * 3, options={"crf": "5"})
    found = read_frame(path, 1)
    for column in (16, 48, 80):
        np.testing.assert_allclose(found[32, column].astype(int), image[32, column], atol=6)


def test_variable_frame_rate_keeps_its_odd_times(tmp_path, film, arm_images):
    times_s = np.round(np.cumsum(np.random.default_rng(1).uniform(0.008, 0.05, FRAMES)) + 3.7, 3)
    for name in ("odd.mp4", "odd.mkv"):
        path = film.encode(tmp_path / name, arm_images, times_s=list(times_s))
        found = np.array([frame.time_s for frame in Video(path)])
        np.testing.assert_allclose(found, times_s - times_s[0], atol=1.1e-3 if name.endswith("mkv") else 2e-5)


def trim(path, arm_video, n_frames):
    """Write the video with an edit list that begins after some frames."""
    with av.open(str(arm_video)) as source, av.open(str(path), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        shift = n_frames * int(1 / 30 / source.streams.video[0].time_base)
        for packet in source.demux(video=0):
            if packet.size:
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, stream
                target.mux(packet)
    return path


def test_frames_before_an_edit_list_are_not_shown(tmp_path, arm_video, film):
    """A phone's trimmed clip: the file holds frames that no player shows. They have no rows."""
    video = Video(trim(tmp_path / "trimmed.mp4", arm_video, 5))
    frames = list(video)
    assert [film.frame_number(frame.image) for frame in frames] == list(range(5, FRAMES))
    assert frames[0].time_s == 0
    assert video.warnings == []


def test_a_file_whose_frames_are_all_hidden_is_refused(tmp_path, arm_video):
    path = trim(tmp_path / "all.mp4", arm_video, FRAMES + 5)
    with pytest.raises(VideoError, match="holds no frame that can be decoded"):
        list(Video(path))


def test_stream_without_times_says_so(tmp_path, arm_images, film):
    video = Video(film.encode(tmp_path / "raw.h264", arm_images))
    frames = list(video)
    assert [film.frame_number(frame.image) for frame in frames] == list(range(FRAMES))
    assert np.all(np.diff([frame.time_s for frame in frames]) > 0)
    assert any("no presentation times" in warning for warning in video.warnings)


@pytest.mark.parametrize("rotation_deg", [0, 90, 180, 270])
@pytest.mark.parametrize("flip", [False, True])
def test_rotation_metadata_is_applied(tmp_path, film, rotation_deg, flip):
    """Every corner lands where a player shows it: turned counterclockwise, then mirrored left to right."""
    image = np.zeros((80, 128, 3), np.uint8)
    image[:40, :64], image[:40, 64:], image[40:, :64] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    path = film.encode(
        tmp_path / "turned.mp4", [image] * 2, rotation_deg=rotation_deg, flip=flip, options={"crf": "5"}
    )
    expected = np.rot90(image, rotation_deg // 90)[:, :: -1 if flip else 1]
    video = Video(path)
    found = next(iter(video)).image
    assert found.shape == expected.shape
    assert video.size_wh == found.shape[1::-1]
    assert np.median(np.abs(found.astype(int) - expected)) <= 3
    inner = np.ix_([20, found.shape[0] - 20], [20, found.shape[1] - 20])
    np.testing.assert_allclose(found[inner].astype(int), expected[inner], atol=12)


def test_turn_that_is_not_a_quarter_is_left_and_said(tmp_path, film, arm_images):
    video = Video(film.encode(tmp_path / "skew.mp4", arm_images[:2], rotation_deg=30))
    assert video.size_wh == (160, 120)
    assert "30 degrees" in video.warnings[0]


def test_odd_size_and_single_frame(tmp_path, film):
    image = film.draw_arm(30, (161, 121))
    path = film.encode(tmp_path / "one.mkv", [image], codec="ffv1", pix_fmt="yuv444p")
    video = Video(path)
    frames = list(video)
    assert len(frames) == 1
    assert frames[0].image.shape == (121, 161, 3)
    assert video.size_wh == (161, 121)
    assert frames[0].time_s == 0
    assert video.warnings == []


def test_audio_does_not_matter(tmp_path, film, arm_images):
    path = film.encode(tmp_path / "sound.mp4", arm_images[:10], with_audio=True)
    assert len(list(Video(path))) == 10


def test_camera_pause_is_said_but_nothing_is_missing(tmp_path, film, arm_images):
    times_s = np.arange(FRAMES) / 30
    times_s[30:] += 1.5
    video = Video(film.encode(tmp_path / "pause.mp4", arm_images, times_s=list(times_s)))
    assert len(list(video)) == FRAMES
    assert video.complete
    assert "no frame for 1.533 s after 0.967 s" in video.warnings[0]


def test_frames_that_an_avi_recorder_dropped_are_no_lost_frames(tmp_path, film, arm_images):
    """Its header counts the slots; the dropped ones are empty and have no image."""
    slots = [0, 1, 2, 3, 6, 7, 8, 9, 10, 11]
    path = film.encode(
        tmp_path / "dropped.avi",
        arm_images[:10],
        codec="mjpeg",
        pix_fmt="yuvj420p",
        times_s=[slot / 30 for slot in slots],
    )
    video = Video(path)
    np.testing.assert_allclose([frame.time_s for frame in video], np.array(slots) / 30, atol=1e-3)
    assert video.complete


def test_iterating_again_starts_anew(arm_video):
    video = Video(arm_video)
    for frame in video:
        if frame.index == 3:
            break
    assert [frame.index for frame in video] == list(range(FRAMES))


def test_read_frame_is_the_frame_of_that_index(arm_video, film):
    for index in (0, 1, 33, FRAMES - 1):
        assert film.frame_number(read_frame(arm_video, index)) == index
    with pytest.raises(VideoError, match="from 0 to 59, got 60"):
        read_frame(arm_video, 60)
    with pytest.raises(VideoError, match="got -1"):
        read_frame(arm_video, -1)


@pytest.mark.parametrize("count", [1, 7, 16, 60, 100])
def test_spread_frames_reach_from_the_first_to_nearly_the_last(arm_video, film, count):
    numbers = [film.frame_number(image) for image in spread_frames(arm_video, count)]
    assert len(numbers) == min(count, FRAMES)
    assert numbers == sorted(set(numbers))
    assert numbers[0] == 0
    if count > 1:
        assert numbers[-1] >= FRAMES - 1 - FRAMES / count
        assert np.ptp(np.diff(numbers)) <= np.diff(numbers).mean() + 1


def test_names_and_hashes(tmp_path):
    path = tmp_path / "a trial.0.25Hz.mp4"
    path.write_bytes(b"x" * 3_000_000)
    assert video_stem(path) == "a trial.0.25Hz"
    assert file_sha256(path) == hashlib.sha256(path.read_bytes()).hexdigest()


def test_colon_in_the_name_is_no_protocol(tmp_path, arm_video, monkeypatch):
    shutil.copy(arm_video, tmp_path / "take 1: slow.mp4")
    monkeypatch.chdir(tmp_path)
    assert Video("take 1: slow.mp4").size_wh == (160, 120)


def test_what_is_no_video_is_refused_in_one_line(tmp_path, arm_video, arm_images, film):
    def audio_only(path: Path) -> None:
        with av.open(str(path), "w") as container:
            stream = container.add_stream("aac", rate=16_000)
            for n in range(20):
                sound = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
                sound.sample_rate, sound.pts = 16_000, 1024 * n
                container.mux(stream.encode(sound))
            container.mux(stream.encode(None))

    def zeroed(path: Path) -> None:
        data = bytearray(arm_video.read_bytes())
        for position, size in film.packet_places(arm_video):
            data[position : position + size] = bytes(size)
        path.write_bytes(data)

    def without_index(path: Path) -> None:
        film.cut(film.encode(tmp_path / "index_last.mp4", arm_images), path, 0.6)

    cases = {
        "empty.mp4": (lambda path: path.touch(), "is empty"),
        "text.mp4": (lambda path: path.write_text("no video\n" * 200), "not a video"),
        "notes.txt": (lambda path: path.write_text("no video\n" * 200), "got an image or text"),
        "photo.png": (lambda path: cv2.imwrite(str(path), arm_images[0]), "got an image or text"),
        "sound.m4a": (audio_only, "found only audio"),
        "index.mp4": (without_index, "cut off before its index was written"),
        "zeroed.mp4": (zeroed, "no frame that can be decoded"),
        "folder.mp4": (lambda path: path.mkdir(), "got a folder"),
        "missing.mp4": (lambda path: None, "no such file"),
    }
    for name, (make, message) in cases.items():
        path = tmp_path / name
        make(path)
        with pytest.raises(VideoError, match=message) as caught:
            Video(path)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


def test_memory_does_not_grow_with_the_video(film, short_and_long_video):
    """Peak memory of reading 3000 frames against 300, each in a process of its own."""
    code = (
        "import sys; from bendtrack.tracker.video import Video\n"
        "print(sum(frame.image.shape[0] > 0 for frame in Video(sys.argv[1])))"
    )
    short, long = film.peak_memory(code, short_and_long_video)
    assert long < 1.1 * short
