"""bendtrack new, import, export, render: what a project is made of goes in and comes out."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.project import Project
from bendtrack.tracker.synthetic.trial import read_trial
from bendtrack.tracker.types import LabelledFrame


def labels(root: Path) -> list[tuple[str, str, bytes]]:
    frames: list[LabelledFrame] = LabelStore.of(Project.open(root)).read()
    return [(frame.video, frame.image_path.name, frame.xy.tobytes()) for frame in frames]


def test_new_takes_names_and_angle(bendtrack, tmp_path: Path) -> None:
    assert bendtrack("new", tmp_path / "a").status == 0
    assert Project.open(tmp_path / "a").keypoints == ("base_1", "base_2", "tip_1", "tip_2")
    ran = bendtrack("new", tmp_path / "b", "--keypoints", "root, knee, tip", "--angle", "three-point")
    assert "root, knee, tip (three-point)" in ran.out
    assert Project.open(tmp_path / "b").settings.angle.definition == "three-point"


def test_labels_go_out_and_come_back_the_same(bendtrack, project: Project, tmp_path: Path) -> None:
    ran = bendtrack("export", project.root, tmp_path / "dlc", "--format", "dlc")
    assert ran.status == 0
    assert "10 labelled frames and 10 pictures" in ran.out
    ran = bendtrack("import", tmp_path / "again", tmp_path / "dlc")
    assert (ran.status, ran.err) == (0, "")
    assert "10 labelled frames imported" in ran.out
    assert labels(tmp_path / "again") == labels(project.root)
    ran = bendtrack("import", tmp_path / "again", tmp_path / "dlc")
    assert ran.status == 0
    assert "0 labelled frames imported, 10 already there" in ran.out


def test_what_is_left_out_is_said_and_is_status_1(bendtrack, project: Project, tmp_path: Path) -> None:
    source = tmp_path / "labeled-data"
    shutil.copytree(project.labels_dir, source)
    (source / "arm" / "img00003.png").unlink()
    ran = bendtrack("import", tmp_path / "new", source)
    assert ran.status == 1
    assert "9 labelled frames imported" in ran.out
    assert "left out: arm/img00003.png: no such image" in ran.err


def test_render_gives_a_trial_and_labels_that_import_takes(bendtrack, tmp_path: Path) -> None:
    trial = tmp_path / "trial"
    options = "--seed 5 --cycles 1 --frequency-hz 1 --frame-rate 12 --size 320x240 --end-vector-px 24"
    ran = bendtrack("render", trial, *options.split(), "--labels", 5, "--noise-px", 0)
    assert (ran.status, ran.err) == (0, "")
    truth = read_trial(trial)
    assert len(truth.time_s) == 13
    ran = bendtrack("import", tmp_path / "p", trial / "labels.csv", "--video", truth.video_path)
    assert (ran.status, ran.err) == (0, "")
    frames = LabelStore.of(Project.open(tmp_path / "p")).read()
    assert len(frames) == 5
    for frame in frames:
        np.testing.assert_allclose(frame.xy, truth.xy[frame.frame], atol=1e-3)
    again = bendtrack("render", trial)
    assert again.status == 2
    assert "expected a new or an empty folder" in again.err


@pytest.mark.parametrize("size", ["640", "x480", "640x-1", "wide"])
def test_a_size_is_two_numbers(bendtrack, tmp_path: Path, size: str) -> None:
    ran = bendtrack("render", tmp_path / "trial", "--size", size)
    assert ran.status == 2
    assert f"such as 640x480, got '{size}'" in ran.err


def test_an_empty_project_says_the_next_commands_with_its_name(bendtrack, tmp_path: Path) -> None:
    root = tmp_path / "my study"
    assert bendtrack("new", root).status == 0
    (tmp_path / "a.mp4").touch()
    for words in (("evaluate", root), ("track", root, tmp_path / "a.mp4")):
        ran = bendtrack(*words)
        assert ran.status == 2
        assert ran.err.count("\n") == 1
        assert ran.err.index(f"`bendtrack frames '{root}' VIDEO...`") < ran.err.index(
            f"`bendtrack label '{root}'`"
        )
        assert f"`bendtrack train '{root}'` trains one" in ran.err
    assert f"`bendtrack frames '{root}' VIDEO...` chooses some" in bendtrack("label", root).err
    assert f"`bendtrack label '{root}'` opens the page" in bendtrack("labels", "check", root).err
