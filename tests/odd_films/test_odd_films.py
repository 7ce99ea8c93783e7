"""A selection of the odd films, one for each kind: sound ones are right, of damaged ones nothing wrong is left unsaid.

All of them are in `benchmarks/films.py`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.tracking import track
from bendtrack.tracker.video import Video, read_frame
from odd_films import damage, sound
from odd_films.encoding import write
from odd_films.scene import ANGLE, FRAMES, RATE, DiscDetector
from odd_films.verdict import COUNTED, Verdict, judge

SOUND = dict(sound.sound_films())
QUIET = (
    *(
        "h264b.mp4",
        "hevc.mp4",
        "vp8.webm",
        "av1.mkv",
        "ffv1.mkv",
        "prores.mov",
        "mjpeg.avi",
        "mpeg2.mxf",
        "gif.gif",
    ),
    *("uneven_h264.mkv", "late_h264.mkv", "uneven_h264.ts", "audio.avi", "fragmented.mp4", "ten_bit.mp4"),
    *(
        "turned_90.mp4",
        "aspect_16x11.mp4",
        "aspect_1x2.mp4",
        "aspect.mpg",
        "one_frame.mp4",
        "latin1_title.mp4",
    ),
    *(
        "latin1_title.avi",
        "interlaced_tff_x264.mp4",
        "interlaced_bff_mpeg2.ts",
        "interlaced_bff_prores.mov",
    ),
)


@pytest.mark.parametrize("name", QUIET)
def test_a_sound_film_is_right_and_nothing_is_said(tmp_path: Path, name: str) -> None:
    judged = judge(sound.write_film(name, SOUND[name], tmp_path), SOUND[name].frame_times_s)
    assert (judged.verdict, judged.words) == (Verdict.RIGHT, [])


@pytest.mark.parametrize("name", ["pauses_h264.mkv", "long_last_vp9.webm", "dropped_h264.ts"])
def test_an_uneven_clock_is_no_damage(tmp_path: Path, name: str) -> None:
    judged = judge(sound.write_film(name, SOUND[name], tmp_path), SOUND[name].frame_times_s)
    assert judged.verdict == Verdict.SAID
    assert judged.complete
    assert (judged.flagged, judged.wrong) == (0, 0)
    assert "no frame for" in judged.words[0]


@pytest.mark.parametrize("name", ["unmarked_bff_mjpeg.avi", "unmarked_tff_x264.mp4"])
def test_interlaced_pictures_that_are_not_marked_are_noticed(tmp_path: Path, name: str) -> None:
    judged = judge(sound.write_film(name, SOUND[name], tmp_path), SOUND[name].frame_times_s)
    assert (judged.verdict, judged.flagged, judged.wrong) == (Verdict.SAID, 0, 0)
    assert judged.words == [
        "pictures are interlaced though the file does not say so; each was made from its first field"
    ]


@pytest.mark.parametrize("name", ["h264.h264", "mjpeg.mjpeg", "av1.obu", "mpeg2.m2v"])
def test_times_that_are_counted_are_said(tmp_path: Path, name: str) -> None:
    judged = judge(sound.write_film(name, SOUND[name], tmp_path), SOUND[name].frame_times_s)
    assert (judged.verdict, judged.rows, judged.flagged) == (Verdict.SAID, FRAMES, 0)
    assert COUNTED in judged.words[0]


def test_frames_are_shown_with_square_pixels(tmp_path: Path) -> None:
    """The larger side grows, as in a browser; the images to label are these."""
    for name, shape in (("aspect_16x11.mp4", (120, 160, 3)), ("aspect_1x2.mp4", (240, 320, 3))):
        path = sound.write_film(name, SOUND[name], tmp_path)
        assert Video(path).size_wh == shape[1::-1]
        assert read_frame(path, 3).shape == shape


DAMAGED = (
    *(
        ("ffv1", ".mkv", "flip_1"),
        ("ffv1g", ".mkv", "garbage"),
        ("hevc", ".mkv", "flip_1"),
        ("vp9", ".webm", "cut_90"),
    ),
    *(
        ("vp8", ".webm", "lost"),
        ("av1", ".mp4", "garbage"),
        ("mjpeg", ".avi", "flip_few"),
        ("mjpeg", ".mov", "flip_many"),
    ),
    *(
        ("huffyuv", ".avi", "garbage"),
        ("h264", ".avi", "lost"),
        ("mpeg4", ".avi", "zeroed"),
        ("rawvideo", ".avi", "lost"),
    ),
    *(
        ("h264", ".mkv", "cut_99"),
        ("vp9", ".webm", "cut_99"),
        ("hevc", ".ts", "cut_99"),
        ("wmv2", ".wmv", "cut_90"),
    ),
    *(
        ("mpeg2", ".mxf", "lost"),
        ("mjpeg", ".mjpeg", "zeroed"),
        ("hevc", ".mkv", "lost"),
        ("vp8", ".webm", "hole"),
    ),
)


SEED = 11


@pytest.mark.parametrize(("codec", "suffix", "kind"), DAMAGED)
def test_nothing_that_damage_changed_is_left_unsaid(
    tmp_path: Path, codec: str, suffix: str, kind: str
) -> None:
    recipe = sound.recipe(codec, suffix)
    whole = write(recipe, tmp_path / f"whole{suffix}")
    path = damage.damaged(whole, tmp_path / f"damaged{suffix}", kind, seed=SEED)
    judged = judge(path, recipe.frame_times_s)
    assert judged.verdict == Verdict.SAID
    assert not judged.complete


@pytest.mark.parametrize("kind", ["lost", "zeroed"])
def test_the_times_after_a_chunk_that_an_avi_has_lost(tmp_path: Path, kind: str) -> None:
    """Its index says that it was there: a row without values, and all others at their own times."""
    recipe = sound.recipe("mpeg4", ".avi")
    whole = write(recipe, tmp_path / "whole.avi")
    table = track(damage.damaged(whole, tmp_path / "lost.avi", kind, seed=4), DiscDetector(), ANGLE)
    assert (table.flag == "undecodable").sum() == 1
    np.testing.assert_allclose(table.time_s, np.arange(FRAMES) / RATE, atol=1e-6)


def test_a_film_known_to_be_whole_by_its_checksums_is_not_doubted(tmp_path: Path) -> None:
    """Bits that change nothing for the decoder are found by Matroska's own checksum, and only in their cluster."""
    recipe = sound.recipe("h264", ".mkv")
    whole = write(recipe, tmp_path / "whole.mkv")
    assert Video(whole).complete
    data = bytearray(whole.read_bytes())
    first, second = [match.start() for match in re.finditer(bytes.fromhex("1f43b675"), data)][:2]
    assert first < second
    data[first + 8] ^= 1  # in the checksum itself
    (tmp_path / "one.mkv").write_bytes(data)
    video = Video(tmp_path / "one.mkv")
    assert all(frame.decoded is not None for frame in video)
    assert video.doubtful == list(range(10))
    assert "1 parts of the file do not match their checksums" in video.warnings


def test_damage_in_a_still_film_does_not_spread(tmp_path: Path) -> None:
    """One frame of a codec without checks becomes noise: that frame alone is doubted."""
    recipe = sound.recipe("huffyuv", ".avi")
    whole = write(recipe, tmp_path / "whole.avi")
    video = Video(damage.damaged(whole, tmp_path / "one.avi", "garbage", seed=4))
    assert len(list(video)) == FRAMES
    assert len(video.doubtful) == 1


def test_streams_that_appear_in_mid_file_end_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PyAV (18) raises IndexError at the end of such a file, or not, as memory happens to be."""
    path = sound.write_film("h264.ts", SOUND["h264.ts"], tmp_path)

    def packets(container, stream):
        yield from (packet for packet in container.demux(stream) if packet.size)
        raise IndexError("list index out of range")

    monkeypatch.setattr("bendtrack.tracker.decoding.packets_of", packets)
    judged = judge(path, SOUND["h264.ts"].frame_times_s)
    assert (judged.verdict, judged.rows) == (Verdict.RIGHT, FRAMES)
