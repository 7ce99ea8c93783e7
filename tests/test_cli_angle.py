"""bendtrack angle: from video to table without project or labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bendtrack.models.detector import NetworkDetector
from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results
from bendtrack.tracker.synthetic.stream import KEYPOINTS, TRAINING, Renderer, drawn_look, inflation_deg
from bendtrack.tracker.video import Video
from bendtrack.tracker.video_writer import VideoWriter


def test_where_no_actuator_is_seen_it_is_said(
    bendtrack, trained_project: Project, write_arm_video, tmp_path: Path
) -> None:
    """This network has learnt nothing: what it sees is nothing."""
    video = write_arm_video(tmp_path / "a.mp4")
    out = tmp_path / "out"
    ran = bendtrack("angle", video, "--network", trained_project.models_dir / "model", "--out", out)
    assert ran.status == 1
    assert "a.mp4: expected an actuator in sight, got one in 0 % of the frames looked at" in ran.err
    assert list(out.iterdir()) == []


def test_what_comes_with_bendtrack_sees_no_actuator_in_grey(
    bendtrack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    grey = np.random.default_rng(0).normal(128, 3, (30, 96, 128, 3)).astype(np.uint8)
    with VideoWriter(tmp_path / "grey.mp4", (128, 96), frame_rate=30) as writer:
        for picture in grey:
            writer.write(picture)
    ran = bendtrack("angle", tmp_path / "grey.mp4", "--engine", "torch", "--out", tmp_path / "out")
    assert ran.status == 1
    assert "Network: actuator-resnet18 (resnet18, torch on cpu)" in ran.out
    assert "grey.mp4: expected an actuator" in ran.err


def test_self_training_runs_unless_quick(
    bendtrack, write_arm_video, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    self_trains: list[bool] = []

    def for_video(detector, probe_frames, progress):
        self_trains.append(detector.stages.self_training)
        raise VideoError("expected nothing more")

    monkeypatch.setattr(NetworkDetector, "for_video", for_video)
    asked = "angle", write_arm_video(tmp_path / "a.mp4"), "--engine", "torch", "--out", tmp_path / "out"
    for options in ((), ("--quick",)):
        assert bendtrack(*asked, *options).status == 1
    assert self_trains == [True, False]


@pytest.mark.slow
def test_what_comes_with_bendtrack_measures_an_actuator_that_nobody_labelled(
    bendtrack, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the points along its midline in the table."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    look = drawn_look(21, 3, size_wh=(400, 300), families=TRAINING, bend_deg=(0.0, 150.0))
    renderer, truth_deg = Renderer(look), []
    with VideoWriter(tmp_path / "film.mp4", (400, 300), frame_rate=30) as writer:
        for index, bend in enumerate(inflation_deg(look, 36)):
            sample = renderer.frame(float(bend), noise_seed=index)
            writer.write(sample.image)
            truth_deg.append(sample.angle_deg)
    asked = "angle", tmp_path / "film.mp4", "--engine", "torch", "--quick", "--out", tmp_path / "out"
    assert bendtrack(*asked).status == 0
    table = read_results(tmp_path / "out" / "film.h5")
    assert (table.flag == "").mean() > 0.95
    assert np.sqrt(np.mean((table.angle_deg - truth_deg) ** 2)) < 3
    header = (tmp_path / "out" / "film.csv").read_text().splitlines()[0]
    assert all(f"{name}_x" in header for name in KEYPOINTS)
    assert "up to date" in bendtrack(*asked).out


def test_without_a_network_there_is_one_line(bendtrack, write_arm_video, tmp_path: Path) -> None:
    video = write_arm_video(tmp_path / "a.mp4")
    ran = bendtrack("angle", video, "--model", tmp_path / "nothing", "--out", tmp_path / "out")
    assert ran.status == 2
    assert "expected a trained network at" in ran.err


@pytest.mark.slow
def test_an_actuator_that_the_network_knows_is_found_and_measured(
    bendtrack, project: Project, write_arm_video, tmp_path: Path
) -> None:
    """A network that knows this one kind of arm stands for one that knows them all."""
    settings = project.root / "bendtrack.toml"
    settings.write_text(
        settings.read_text()
        .replace("steps = 2", "steps = 150")
        .replace("batch_frames = 1", "batch_frames = 4")
    )
    assert bendtrack("train", project.root, "--init", "random").status == 0
    video, out = write_arm_video(tmp_path / "new.mp4", 40), tmp_path / "out"
    network = project.models_dir / "model"
    ran = bendtrack("angle", video, "--model", network, "--out", out)
    assert (ran.status, ran.err) == (0, "")
    table = read_results(out / "new.h5")
    truth = 50 - 50 * np.cos(np.linspace(0, 2 * np.pi, 40))
    assert np.sqrt(np.nanmean((table.angle_deg - truth) ** 2)) < 5
    assert (out / "new.png").is_file()
    assert "up to date" in bendtrack("angle", video, "--model", network, "--out", out).out
    # Its light goes out in every second frame, and those that are looked at first are the others: that is told.
    steady, blinking = write_arm_video(tmp_path / "steady.mp4", 63), tmp_path / "blinking.mp4"
    with VideoWriter(blinking, Video(steady).size_wh, frame_rate=30) as writer:
        for frame in Video(steady):
            writer.write(frame.image * (frame.index % 2 == 0))
    ran = bendtrack("angle", blinking, "--model", network, "--out", out)
    assert ran.status == 0
    assert "blinking.mp4: expected the actuator in most frames, got it without a flag in" in ran.err
    assert (read_results(out / "blinking.h5").flag[1::2] != "").all()
    again = bendtrack("angle", blinking, "--model", network, "--out", out)
    assert "up to date" in again.out
    assert again.err == ran.err
