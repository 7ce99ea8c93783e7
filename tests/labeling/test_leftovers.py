"""Killed writers leave temporary files: the next start removes them, and never one that is being written."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from bendtrack.tracker.atomic import atomic_path
from bendtrack.tracker.project import Project

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")

WRITE = """
import sys, time
from contextlib import ExitStack
from bendtrack.tracker.atomic import atomic_path
with ExitStack() as stack:
    for path in sys.argv[1:]:
        stack.enter_context(atomic_path(path)).write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


def killed_while_writing(*paths: Path) -> None:
    writer = subprocess.Popen([sys.executable, "-c", WRITE, *paths], stdout=subprocess.PIPE)
    assert writer.stdout is not None
    writer.stdout.readline()
    writer.kill()
    writer.wait()
    writer.stdout.close()


def temporary(root: Path) -> set[str]:
    return {path.name for path in root.rglob(".*.tmp*")}


def places(project: Project) -> list[Path]:
    folder = project.labels_dir / "arm"
    names = ("CollectedData_bendtrack.csv", "img00099.png", "bendtrack-notes.json")
    return [*(folder / name for name in names), project.root / "bendtrack.toml"]


def test_frames_removes_what_killed_writers_left(
    bendtrack, project: Project, write_arm_video, tmp_path: Path
) -> None:
    killed_while_writing(*places(project))
    assert len(temporary(project.root)) == 4
    before = (project.root / "bendtrack.toml").read_bytes()
    with atomic_path(project.labels_dir / "arm" / "other.csv") as running:
        running.write_text("half")
        ran = bendtrack("frames", project.root, write_arm_video(tmp_path / "new.mp4"), "--count", "2")
        assert ran.status == 0, ran.err
        assert temporary(project.root) == {running.name}
    assert (project.labels_dir / "arm" / "other.csv").read_text() == "half"
    assert (project.root / "bendtrack.toml").read_bytes() == before


def test_label_removes_what_killed_writers_left(bendtrack, project: Project) -> None:
    (project.root / ".bendtrack").mkdir()
    killed_while_writing(*places(project), project.root / ".bendtrack" / "ports.json")
    assert len(temporary(project.root)) == 5
    with atomic_path(project.labels_dir / "arm" / "other.csv") as running:
        running.write_text("half")
        command = [str(bendtrack.command), "label", str(project.root), "--no-browser", "--model", "none"]
        serving = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        try:
            assert serving.stdout is not None
            assert b"Labelling" in serving.stdout.readline()
            assert temporary(project.root) == {running.name}
        finally:
            serving.send_signal(signal.SIGINT)
            with contextlib.suppress(subprocess.TimeoutExpired):
                serving.wait(10)
            serving.kill()
            serving.wait()
            serving.stdout.close()


def test_an_export_removes_the_folder_of_one_that_was_killed(
    bendtrack, project: Project, tmp_path: Path
) -> None:
    left = tmp_path / ".out.0123456789ab.tmp"
    (left / "labeled-data").mkdir(parents=True)
    ran = bendtrack("export", project.root, tmp_path / "out")
    assert ran.status == 0, ran.err
    assert not left.exists()
