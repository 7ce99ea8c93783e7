"""Where the video of a folder of labelled frames lies."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from bendtrack.labeling.frame_extraction import extract_frames
from bendtrack.labeling.video_record import VIDEO_FILE, remember_video, remembered_video
from bendtrack.tracker.project import Project


def test_chosen_frames_know_their_video_also_when_the_study_has_moved(
    write_arm_video, tmp_path: Path
) -> None:
    study = tmp_path / "study"
    study.mkdir()
    video = write_arm_video(study / "a.mp4")
    project = Project.create(study / "project", keypoints=("a", "b", "c", "d"))
    extract_frames(project, [video], count=1)
    assert remembered_video(project.labels_dir / "a") == video.resolve()
    shutil.move(study, tmp_path / "moved")
    assert remembered_video(tmp_path / "moved/project/labeled-data/a") == (tmp_path / "moved/a.mp4").resolve()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"format": "bendtrack-video-1"}',
        '{"format": "bendtrack-video-1", "path": "\\u0000"}',
        '{"format": "bendtrack-video-1", "path": 7}',
        json.dumps({"format": "bendtrack-video-1", "path": "../gone/a.mp4"}),
        json.dumps({"format": "bendtrack-video-1", "path": "../other.mp4"}),
        json.dumps({"format": "of another program", "path": "../a.mp4"}),
    ],
)
def test_a_record_that_leads_nowhere_gives_no_video(text: str, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    for name in ("a.mp4", "other.mp4"):
        (tmp_path / name).touch()
    assert remembered_video(folder) is None
    remember_video(folder, tmp_path / "a.mp4")
    assert remembered_video(folder) == tmp_path / "a.mp4"
    (folder / VIDEO_FILE).write_text(text)
    assert remembered_video(folder) is None
