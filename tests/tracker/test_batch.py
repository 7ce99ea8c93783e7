"""A batch of videos: whatever goes wrong with one, there is a line for it and the others are done."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.tracker.angle import AngleDefinition
from bendtrack.tracker.batch import Batch, State, measured, track_batch
from bendtrack.tracker.errors import CheckpointError, VideoError
from bendtrack.tracker.results import read_results

FAILURES = {
    "memory": MemoryError(),
    "disk": OSError(5, "Input/output error"),
    "bug": RuntimeError("first line\nsecond line"),
    "index": IndexError("list index out of range"),
}


def failing_detector(film, width_of: dict[int, BaseException]):
    """Fails for videos of certain widths."""

    class Failing(film.DiscDetector):
        def detect(self, frames):
            error = width_of.get(frames[0].shape[1])
            if error is not None:
                raise error
            return super().detect(frames)

    return Failing()


def test_whatever_goes_wrong_with_one_video_the_others_are_done(film, tmp_path: Path) -> None:
    videos, errors = [], {}
    for number, name in enumerate(["sound", *FAILURES, "opencv", "last"]):
        size = (160 + 2 * number, 120)
        images = [film.draw_arm(40.0, size)] * 3
        videos.append(film.encode(tmp_path / f"{name}.mp4", images, codec="mpeg4"))
        if name in FAILURES:
            errors[size[0]] = FAILURES[name]
        elif name == "opencv":
            with pytest.raises(cv2.error) as caught:
                cv2.resize(np.zeros((1, 500, 3), np.uint8), None, fx=0.01, fy=0.01)
            errors[size[0]] = caught.value
    videos.insert(3, tmp_path / "text.mp4")
    videos[3].write_text("no video")
    batch = Batch(
        failing_detector(film, errors), AngleDefinition("two-vector", film.keypoints), tmp_path / "out"
    )
    outcomes = list(track_batch(batch, videos))
    assert [outcome.video for outcome in outcomes] == videos
    failed = {outcome.video.stem: outcome for outcome in outcomes if outcome.state is State.FAILED}
    assert set(failed) == {*FAILURES, "opencv", "text"}
    assert all(outcome.problem and "\n" not in outcome.problem for outcome in failed.values())
    assert failed["memory"].problem == "there is not enough memory for it"
    assert failed["disk"].problem == "Input/output error"
    assert failed["bug"].problem == "cannot be measured (RuntimeError: first line second line)"
    assert failed["index"].error is FAILURES["index"]
    for name in ("sound", "last"):
        assert len(read_results(tmp_path / "out" / f"{name}.csv")) == 3


def test_what_every_video_would_have_ends_the_batch(film, tmp_path: Path) -> None:
    video = film.encode(tmp_path / "a.mp4", [film.draw_arm(40.0)], codec="mpeg4")
    detector = failing_detector(film, {160: CheckpointError("no such engine")})
    batch = Batch(detector, AngleDefinition("two-vector", film.keypoints), tmp_path / "out")
    with pytest.raises(CheckpointError, match="no such engine"):
        list(track_batch(batch, [video]))


def test_a_figure_that_fails_is_said_of_its_own_video(film, tmp_path: Path, monkeypatch) -> None:
    videos = [
        film.encode(tmp_path / f"{name}.mp4", [film.draw_arm(40.0)], codec="mpeg4") for name in ("a", "b")
    ]

    def broken(table, path):
        if path.stem == "a":
            raise ValueError("no fonts")

    monkeypatch.setattr("bendtrack.tracker.figures.write_angle_figure", broken)
    monkeypatch.setattr("bendtrack.tracker.batch.record_file", lambda *args: None)
    batch = Batch(film.DiscDetector(), AngleDefinition("two-vector", film.keypoints), tmp_path / "out")
    states = [(outcome.video.stem, outcome.state) for outcome in track_batch(batch, videos)]
    assert states == [("a", State.TRACKED), ("b", State.TRACKED), ("a", State.FAILED)]


@pytest.mark.parametrize(
    ("size", "message"), [((8000, 16), "got 8000 x 16 px"), ((16, 1600), "got 16 x 1600 px")]
)
def test_no_actuator_is_looked_for_where_none_fits(film, tmp_path: Path, size, message: str) -> None:
    video = film.encode(tmp_path / "wide.mkv", [np.zeros((*size[::-1], 3), np.uint8)] * 2, codec="ffv1")
    batch = Batch(
        film.DiscDetector(), None, tmp_path, localize=lambda frames, progress: pytest.fail("looked for")
    )
    with pytest.raises(VideoError, match=message):
        measured(batch, video)


def test_no_actuator_is_looked_for_without_a_sound_frame(film, tmp_path: Path, monkeypatch) -> None:
    video = film.encode(tmp_path / "a.mp4", [film.draw_arm(40.0)], codec="mpeg4")
    monkeypatch.setattr("bendtrack.tracker.batch.spread_frames", lambda path, count: [])
    batch = Batch(
        film.DiscDetector(), None, tmp_path, localize=lambda frames, progress: pytest.fail("looked for")
    )
    with pytest.raises(VideoError, match="expected frames that are sound, got none"):
        measured(batch, video)


def test_each_video_has_the_sign_of_its_own_actuator(film, tmp_path: Path) -> None:
    left, right = (
        film.encode(tmp_path / f"{name}.mp4", [film.draw_arm(angle)] * 3, codec="mpeg4")
        for name, angle in (("left", -40.0), ("right", 40.0))
    )
    definition = AngleDefinition("two-vector", film.keypoints)
    signs = {"left": -1, "right": 1}
    own = Batch(film.DiscDetector(), definition, tmp_path / "own", sign_of=lambda video: signs[video.stem])
    tracked = list(track_batch(own, [left, right]))
    assert [round(float(outcome.table.angle_deg[0]), -1) for outcome in tracked] == [40, 40]
    assert not any("bends the other way" in warning for outcome in tracked for warning in outcome.warnings)
    assert [outcome.state for outcome in track_batch(own, [left, right])] == [State.UP_TO_DATE] * 2
    # With one sign for both, what bends the other way is said.
    for _ in range(2):  # also where it is up to date
        backwards, forwards = track_batch(
            Batch(film.DiscDetector(), definition, tmp_path / "one", sign_of=lambda video: 1), [left, right]
        )
        assert "left.mp4: expected angles above 0" in backwards.warnings[0]
        assert forwards.warnings == ()
    # Where someone chose the sign, angles may be negative.
    chosen, _ = track_batch(Batch(film.DiscDetector(), definition, tmp_path / "chosen"), [left, right])
    assert chosen.warnings == ()
