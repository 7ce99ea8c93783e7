"""The overlay video: every frame, its times, and marks where the numbers say."""

from __future__ import annotations

from dataclasses import replace

import av
import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition, bending_angle
from bendtrack.tracker.drawing import ORANGE, SKY_BLUE, VERMILLION, YELLOW
from bendtrack.tracker.errors import ResultsError
from bendtrack.tracker.overlay import Overlay, write_overlay
from bendtrack.tracker.results import AngleTable
from bendtrack.tracker.tracking import track
from bendtrack.tracker.video import Video

NAMES = ("base_1", "base_2", "tip_1", "tip_2")


def make_table(
    film, angles_deg: list[float], size_wh=(640, 480), name="two-vector", likelihood=1.0
) -> AngleTable:
    n = len(angles_deg)
    xy = np.array([film.arm_xy(angle, size_wh) for angle in angles_deg])
    points = NAMES if name in ("two-vector", "arc-fit") else (NAMES[0], NAMES[1], NAMES[3])
    definition = AngleDefinition(name, points)
    covariance = np.tile(0.1 * np.eye(2), (n, 4, 1, 1))
    angle_deg, angle_sd_deg, _ = bending_angle(xy, NAMES, definition, covariance)
    flag = np.array([""] * n, dtype=object)
    scores = np.full((n, 4), likelihood)
    return AngleTable(
        np.arange(n) / 30, angle_deg, angle_sd_deg, flag, xy, scores, covariance, NAMES, definition
    )


def near(image: np.ndarray, at: np.ndarray, colour: tuple[int, ...], reach: int = 6) -> int:
    """How many px of about this colour lie around a position."""
    x, y = np.round(at).astype(int)
    part = image[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1].astype(int)
    return int((np.abs(part - colour).max(axis=2) < 24).sum())


def test_overlay_of_a_real_video(arm_video, film, tmp_path):
    """Same frames, same times, playable by browsers; yellow and the end vectors' colours are in the image."""
    table = track(arm_video, film.DiscDetector(), AngleDefinition("two-vector", NAMES))
    path = tmp_path / "overlay.mp4"
    seen = []
    write_overlay(arm_video, table, path, progress=lambda done, total: seen.append((done, total)))
    video = Video(path)
    frames = list(video)
    np.testing.assert_allclose([frame.time_s for frame in frames], table.time_s, atol=1e-4)
    assert seen[-1] == (60, 60)
    assert video.size_wh == (160, 120)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
    original = [frame.image for frame in Video(arm_video)]
    assert all(np.mean(frame.image != image) > 0.05 for frame, image in zip(frames, original, strict=True))
    assert [path.name for path in tmp_path.iterdir()] == ["overlay.mp4"]


def test_marks_stand_where_the_numbers_say(film):
    for angle_deg in (-15.0, 30.0, 120.0, 205.0):
        table = make_table(film, [angle_deg])
        blank = np.full((480, 640, 3), 60, np.uint8)
        image = Overlay(table, (640, 480)).draw(blank, 0)
        base, tip = table.xy[0, :2].mean(axis=0), table.xy[0, 2:].mean(axis=0)
        assert near(image, base, SKY_BLUE) > 15
        assert near(image, tip, ORANGE) > 10
        for point in table.xy[0]:
            assert near(image, point, (255, 255, 255)) > 15
        # The arc's middle, half way between the two directions; clockwise for a positive angle.
        middle = np.radians(table.angle_deg[0] / 2)
        radius = np.clip(0.62 * np.linalg.norm(table.xy[0, 3] - table.xy[0, 2]), 20, 64)
        if abs(angle_deg) > 20:
            at = table.xy[0, 2] + radius * np.array([np.cos(middle), np.sin(middle)])
            assert near(image, at, YELLOW, 3) >= 3
            opposite = table.xy[0, 2] - radius * np.array([np.cos(middle), np.sin(middle)])
            assert near(image, opposite, YELLOW, 2) == 0
        assert np.all(blank == 60)  # the frame given is not drawn on


def test_doubtful_and_flagged_rows_are_seen(film):
    table = make_table(film, [60.0, 60.0])
    scores = np.ones((2, 4))
    scores[1, 2] = 0.2
    doubtful = replace(table, likelihood=scores, flag=np.array(["", "low_likelihood"]))
    overlay = Overlay(doubtful, (640, 480))
    blank = np.full((480, 640, 3), 60, np.uint8)
    sound, flagged = overlay.draw(blank, 0), overlay.draw(blank, 1)
    assert near(sound, table.xy[0, 2], VERMILLION) == 0
    assert near(flagged, table.xy[0, 2], VERMILLION) > 5
    bar = np.array([40.0, 50.0])
    assert near(flagged, bar, VERMILLION, 12) > 50
    assert near(sound, bar, VERMILLION, 12) == 0


def test_a_row_without_points_says_that_there_is_no_angle(film):
    table = make_table(film, [60.0, 60.0])
    table.angle_deg[1] = table.xy[1] = np.nan
    blank = np.full((480, 640, 3), 60, np.uint8)
    bars = []
    for flag in ("low_likelihood", "undecodable"):
        overlay = Overlay(replace(table, flag=np.array([flag, flag])), (640, 480))
        images = [overlay.draw(blank, index) for index in (0, 1)]
        bars.append(
            [int((np.abs(i[:70, :320].astype(int) - VERMILLION).max(axis=2) < 40).sum()) for i in images]
        )
    assert bars[0][1] > 1.4 * bars[0][0]  # more words
    assert bars[1][1] == bars[1][0]


def test_marks_leave_room_where_the_points_of_an_end_lie_close_together(film):
    """Arrow, points and arc of an end of 16 px do not cover each other: the arc stands clear of the end."""
    wide = make_table(film, [90.0])
    xy = wide.xy.copy()
    for near_one, far_one in ((1, 0), (2, 3)):
        direction = xy[0, far_one] - xy[0, near_one]
        xy[0, far_one] = xy[0, near_one] + 16 * direction / np.linalg.norm(direction)
    image = Overlay(replace(wide, xy=xy), (640, 480)).draw(np.full((480, 640, 3), 60, np.uint8), 0)
    middle = np.radians(45)
    assert near(image, xy[0, 2] + 32 * np.array([np.cos(middle), np.sin(middle)]), YELLOW, 3) >= 3
    assert near(image, xy[0, 2] + [0, 38], ORANGE, 4) >= 3  # the moving end's direction goes on to the arc
    assert near(image, xy[0, :2].mean(axis=0), SKY_BLUE, 4) > 5


def test_positions_beyond_all_bounds_can_be_drawn(film):
    table = make_table(film, [60.0])
    table.xy[0, 3] = 1e12
    Overlay(table, (640, 480)).draw(np.zeros((480, 640, 3), np.uint8), 0)


def test_undecodable_frame_shows_the_last_one_darkened(film):
    table = make_table(film, [60.0, 60.0])
    table.angle_deg[1] = table.xy[1] = np.nan
    overlay = Overlay(replace(table, flag=np.array(["", "undecodable"])), (640, 480))
    overlay.draw(np.full((480, 640, 3), 200, np.uint8), 0)
    assert overlay.draw(None, 1)[240, 320].tolist() == [70, 70, 70]


@pytest.mark.parametrize("size_wh", [(160, 120), (321, 241), (480, 640), (1920, 1080)])
@pytest.mark.parametrize("name", ["two-vector", "three-point", "chord", "arc-fit"])
def test_every_size_and_definition_can_be_drawn(film, size_wh, name):
    table = make_table(film, [0.0, -30.0, 90.0, 200.0, 359.0], size_wh, name)
    table.xy[1] += 2000  # far outside the frame
    table.covariance[2] *= 1e4
    table.xy[3, 1] = table.xy[3, 0]
    table.angle_deg[4] = np.nan
    overlay = Overlay(table, size_wh)
    for index in range(5):
        image = overlay.draw(np.zeros((size_wh[1], size_wh[0], 3), np.uint8), index)
        assert image.shape == (size_wh[1], size_wh[0], 3)
        assert image.any()


def test_table_of_another_video_is_refused(arm_video, film, tmp_path):
    table = track(arm_video, film.DiscDetector(), AngleDefinition("two-vector", NAMES))
    path = tmp_path / "overlay.mp4"
    shorter = make_table(film, [0.0] * 59, (160, 120))
    longer = make_table(film, [0.0] * 61, (160, 120))
    for wrong in (shorter, longer):
        with pytest.raises(ResultsError, match=f"expected the {len(wrong)} frames of the table"):
            write_overlay(arm_video, wrong, path)
    with pytest.raises(ResultsError, match="does not say which angle"):
        write_overlay(arm_video, replace(table, definition=None), path)
    assert list(tmp_path.iterdir()) == []
