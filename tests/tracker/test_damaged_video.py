"""Damaged video files: what damage changed is never given out as sound, and what is left is used."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.video import Video, read_frame

FRAMES = 60


def damage(path: Path, out: Path, places: list[tuple[int, int]], seed: int = 0, count: int = 3) -> Path:
    """Flip bytes inside packets, leaving their headers."""
    data = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    for position, size in places:
        for offset in random.integers(min(12, size // 2), size, count):
            data[position + int(offset)] ^= int(random.integers(1, 255))
    out.write_bytes(data)
    return out


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mp4", "libx264", {"g": "20", "bf": "3"}),
        ("a.avi", "libx264", {"g": "20", "bf": "3"}),
        ("a.mp4", "mpeg4", {"g": "12"}),
    ],
)
def test_no_picture_that_damage_changed_is_given_out_as_sound(
    tmp_path, film, arm_images, name, codec, options, seed
):
    """FFmpeg conceals errors and continues from concealed frames; these must not pass as measured."""
    whole = film.encode(tmp_path / f"whole_{name}", arm_images, codec=codec, options=options)
    places = film.packet_places(whole)
    hit = int(np.random.default_rng(seed).integers(3, FRAMES - 3))
    video = Video(damage(whole, tmp_path / name, [places[hit]], seed))
    frames = list(video)
    truth = [frame.image for frame in Video(whole)]
    assert len(frames) == FRAMES
    assert sum(frame.decoded is None for frame in frames) == 1
    for frame, image in zip(frames, truth, strict=True):
        if frame.decoded is not None and not frame.damaged:
            np.testing.assert_array_equal(frame.image, image)
    last_gop = hit // 20 == FRAMES // 20 - 1 or codec == "mpeg4"
    assert last_gop or not frames[-1].damaged  # the next key frame ends the damage
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(FRAMES) / 30, atol=1e-3)
    assert "1 of 60 frames could not be decoded" in video.warnings[0]
    assert not video.complete


def test_b_frames_shown_before_the_damaged_frame_they_build_on_are_marked(tmp_path, arm_video, film):
    """The decoder gives them out first; only afterwards does it turn out that their reference was damaged."""
    with av.open(str(arm_video)) as container:
        stamps = [packet.pts for packet in container.demux(video=0) if packet.size]
    hit = next(n for n in range(22, 38) if stamps[n + 1] < stamps[n])  # a P frame, followed by its B frames
    frames = list(Video(damage(arm_video, tmp_path / "p.mp4", [film.packet_places(arm_video)[hit]])))
    shown_at = [sorted(stamps).index(stamp) for stamp in stamps]
    assert frames[shown_at[hit]].decoded is None
    assert shown_at[hit + 1] < shown_at[hit]
    assert frames[shown_at[hit + 1]].damaged
    assert not any(frame.damaged for frame in frames[:20])


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_packets_that_give_no_picture_keep_their_rows(tmp_path, film, arm_images, suffix):
    whole = film.encode(
        tmp_path / f"whole{suffix}", arm_images, options={"g": "20", "bf": "0"}, container_options={}
    )
    places = film.packet_places(whole)
    data = bytearray(whole.read_bytes())
    for hit in (25, 45):
        position, size = places[hit]
        data[position + 6 : position + size] = np.random.default_rng(hit).bytes(size - 6)
    path = tmp_path / f"holes{suffix}"
    path.write_bytes(data)
    video = Video(path)
    frames = list(video)
    assert [frame.index for frame in frames if frame.decoded is None] == [25, 45]
    assert [frame.index for frame in frames if frame.damaged] == [*range(26, 40), *range(46, 60)]
    sound = [frame for frame in frames if frame.decoded is not None and not frame.damaged]
    assert all(film.frame_number(frame.image) == frame.index for frame in sound)
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(FRAMES) / 30, atol=1.1e-3)
    with pytest.raises(VideoError, match="frame 25 cannot be decoded"):
        read_frame(path, 25)


def test_mjpeg_loses_only_the_damaged_frame(tmp_path, film, arm_images):
    whole = film.encode(tmp_path / "whole.avi", arm_images, codec="mjpeg", pix_fmt="yuvj420p")
    position, size = film.packet_places(whole)[30]
    data = bytearray(whole.read_bytes())
    data[position : position + size] = bytes(size)
    path = tmp_path / "hole.avi"
    path.write_bytes(data)
    frames = list(Video(path))
    assert [frame.index for frame in frames if frame.decoded is None] == [30]
    assert not any(frame.damaged for frame in frames)
    assert [film.frame_number(frame.image) for frame in frames if frame.decoded] == [
        n for n in range(FRAMES) if n != 30
    ]


def test_frames_lost_with_a_piece_of_matroska_are_noticed(tmp_path, film, arm_images):
    """A zeroed range swallows whole packets; nothing in the file counts frames, but the clock jumps."""
    whole = film.encode(tmp_path / "whole.mkv", arm_images, codec="mjpeg", pix_fmt="yuvj420p")
    places = film.packet_places(whole)
    data = bytearray(whole.read_bytes())
    start, end = places[20][0] - 20, places[26][0]
    data[start:end] = bytes(end - start)
    path = tmp_path / "gap.mkv"
    path.write_bytes(data)
    video = Video(path)
    n_sound = sum(frame.decoded is not None for frame in video)
    assert n_sound < FRAMES - 5
    assert not video.complete
    assert any("no frame for" in warning or "cut short" in warning for warning in video.warnings)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
def test_file_cut_in_the_middle_gives_what_there_is_and_a_warning(tmp_path, film, arm_images, suffix):
    whole = film.encode(
        tmp_path / f"whole{suffix}",
        arm_images,
        options={"g": "20", "bf": "0"},
        container_options={"movflags": "+faststart"} if suffix == ".mp4" else {},
    )
    video = Video(film.cut(whole, tmp_path / f"cut{suffix}", 0.7))
    frames = list(video)
    assert 20 < len(frames) < FRAMES
    sound = [frame for frame in frames if frame.decoded is not None]
    assert len(sound) >= len(frames) - 1
    assert [film.frame_number(frame.image) for frame in sound] == [frame.index for frame in sound]
    assert not video.complete
    assert any("cut short" in warning for warning in video.warnings)


def test_count_claimed_too_large_is_said(tmp_path, film, arm_images):
    whole = film.encode(tmp_path / "whole.avi", arm_images, codec="mjpeg", pix_fmt="yuvj420p")
    data = bytearray(whole.read_bytes())
    length = data.index(b"strh") + 8 + 32  # AVISTREAMHEADER.dwLength
    assert int.from_bytes(data[length : length + 4], "little") == FRAMES
    data[length : length + 4] = (90).to_bytes(4, "little")
    path = tmp_path / "claims.avi"
    path.write_bytes(data)
    video = Video(path)
    assert video.claimed_frames == 90
    assert len(list(video)) == FRAMES
    assert video.warnings == ["cut short or damaged: 60 of the 90 frames of its header"]
    assert not video.complete
