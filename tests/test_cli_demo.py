"""bendtrack demo on the bundled trial, with a training of two steps; .ci/run runs the real one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


@pytest.mark.slow
def test_the_whole_job_and_once_more(bendtrack, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    Project.create(out, keypoints=KEYPOINTS)
    toml = out / "bendtrack.toml"
    toml.write_text(toml.read_text().replace("[training]\n", "[training]\nsteps = 2\nbatch_frames = 1\n"))
    ran = bendtrack("demo", "--out", out)
    assert (ran.status, ran.err) == (0, "")
    assert re.search(r"RMS error \d+\.\d\d°", ran.out)
    assert re.search(r"label-noise floor 0\.\d\d°", ran.out)
    for name in ("results/video.csv", "results/video.png", "results/video.overlay.mp4", "models/model"):
        assert str(out / name) in ran.out
        assert (out / name).exists()
    assert len(read_results(out / "results" / "video.csv")) == 601
    assert (out / "trial" / "pressure.csv").is_file()

    again = bendtrack("demo", "--out", out)
    assert (again.status, again.err) == (0, "")
    assert "30 already there" in again.out
    assert "'model' is trained already" in again.out
    assert "video.mp4: up to date" in again.out
    figures = [re.search(r"RMS error \S+", text) for text in (ran.out, again.out)]
    assert figures[0] is not None
    assert figures[1] is not None
    assert figures[0][0] == figures[1][0]


def test_a_folder_with_other_things_in_it_is_left_alone(bendtrack, tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    ran = bendtrack("demo", "--out", tmp_path)
    assert ran.status == 2
    assert "expected a new or an empty folder" in ran.err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
