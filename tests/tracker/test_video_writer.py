"""Writing real video files, each whole or not at all."""

from __future__ import annotations

import av
import numpy as np
import pytest

from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.video import Video
from bendtrack.tracker.video_writer import VideoWriter


def test_written_video_keeps_times_size_and_colours(tmp_path, film):
    """Odd sizes are padded to even ones; times may be uneven; the index precedes the frames."""
    times_s = [0, 0.02, 0.12, 0.153, 0.9]
    images = [film.draw_arm(20 * n, (161, 121), number=n) for n in range(5)]
    path = tmp_path / "out.mp4"
    with VideoWriter(path, (161, 121), 29.97) as writer:
        for image, time_s in zip(images, times_s, strict=True):
            writer.write(image, time_s)
    video = Video(path)
    frames = list(video)
    assert video.size_wh == (162, 122)
    np.testing.assert_allclose([frame.time_s for frame in frames], times_s, atol=2e-5)
    for frame, image in zip(frames, images, strict=True):
        assert np.mean(np.abs(frame.image[:121, :161].astype(int) - image)) < 4
    with av.open(str(path)) as container:
        assert container.streams.video[0].codec_context.pix_fmt == "yuv420p"
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


def test_times_that_do_not_increase_are_moved_a_hair(tmp_path, film):
    path = tmp_path / "out.mp4"
    with VideoWriter(path, (160, 120), 30) as writer:
        for time_s in (0.0, 0.1, 0.1, 0.05, 0.2):
            writer.write(film.draw_arm(0), time_s)
    times_s = [frame.time_s for frame in Video(path)]
    assert np.all(np.diff(times_s) > 0)
    np.testing.assert_allclose(times_s, [0, 0.1, 0.1, 0.1, 0.2], atol=1e-3)


def test_failed_writing_leaves_the_old_file_and_nothing_else(tmp_path, film):
    path = tmp_path / "out.mp4"
    path.write_bytes(b"old")

    def fail_while_drawing() -> None:
        with VideoWriter(path, (160, 120), 30) as writer:
            writer.write(film.draw_arm(0))
            raise RuntimeError("drawing failed")

    with pytest.raises(RuntimeError, match="drawing failed"):
        fail_while_drawing()
    with pytest.raises(VideoError, match="no frames"), VideoWriter(path, (160, 120), 30):
        pass
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_unwritable_place_is_one_line(tmp_path):
    with pytest.raises(VideoError, match="cannot be written"):
        VideoWriter(tmp_path / "missing" / "out.mp4", (160, 120), 30)
