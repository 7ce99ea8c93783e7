"""Where the video of a folder of labelled frames lies."""

from __future__ import annotations

import json
import os
import shutil
import sys
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
        json.dumps({"format": "bendtrack-video-1", "path": "//127.0.0.1/share/a.mp4"}),
        json.dumps({"format": "bendtrack-video-1", "path": "\\\\127.0.0.1\\share\\a.mp4"}),
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


@pytest.mark.skipif(sys.platform != "linux", reason="names that are not text exist on Linux only")
def test_a_video_whose_name_is_not_text_is_no_reason_to_fail(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9"))
    odd.mkdir()
    (odd / "a.mp4").touch()
    remember_video(folder, odd / "a.mp4")
    assert remembered_video(folder) is None


def test_on_windows_nobody_signs_in_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "a"
    folder.mkdir()
    asked: list[Path] = []
    monkeypatch.setattr(Path, "is_file", lambda path: bool(asked.append(path)) or True)
    for path in ("//127.0.0.1/share/a.mp4", "\\\\127.0.0.1\\share\\a.mp4"):
        (folder / VIDEO_FILE).write_text(json.dumps({"format": "bendtrack-video-1", "path": path}))
        assert remembered_video(folder) is None
    assert not any("share" in str(path) for path in asked)
