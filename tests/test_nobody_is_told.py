"""No command talks to anybody: nothing is downloaded, and no library reports its use."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bendtrack.tracker.project import Project

# Runs a command and writes down whom it calls, in processes that it forks too.
LISTENING = """
import sys

def heard(event, args):
    if event in ("socket.getaddrinfo", "socket.gethostbyname", "urllib.Request"):
        called = args[0]
    elif event == "socket.connect" and isinstance(args[1], tuple):
        called = args[1]
    else:
        return
    with open(sys.argv[1], "a") as file:
        print(event, called, file=file)
    raise OSError("nobody is to be called")

sys.addaudithook(heard)
from bendtrack.tracker.cli import app
app(sys.argv[2:], prog_name="bendtrack")
"""


def listened_to(calls: Path, home: Path, *command: object) -> tuple[int, str]:
    """Exit status of a command on a machine where nobody has used it before, and whom it called."""
    # No library is to take this for a test of its own.
    kept = {name: value for name, value in os.environ.items() if name not in ("CI", "NNCF_CI", "NNCF_DEV")}
    own = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TORCH_HOME": str(home / "torch")}
    calls.touch()
    done = subprocess.run(
        [sys.executable, "-c", LISTENING, str(calls), *map(str, command)],
        env={**kept, **own},
        capture_output=True,
        check=False,
    )
    return done.returncode, calls.read_text()


@pytest.mark.slow
def test_training_compiling_and_measuring_call_nobody(
    project: Project, write_arm_video, tmp_path: Path
) -> None:
    home, video = tmp_path / "home", write_arm_video(tmp_path / "a.mp4")
    home.mkdir()
    settings = project.root / "bendtrack.toml"
    settings.write_text(settings.read_text().replace('init = "random"', 'init = "auto"'))
    assert listened_to(tmp_path / "train", home, "train", project.root) == (0, "")
    assert listened_to(tmp_path / "track", home, "track", project.root, video) == (0, "")
    status, calls = listened_to(
        tmp_path / "angle", home, "angle", video, "--quick", "--out", tmp_path / "out"
    )
    assert (status in (0, 1), calls) == (True, "")
    assert not (home / "intel").exists()


def test_what_is_called_is_heard(project: Project, tmp_path: Path) -> None:
    status, calls = listened_to(tmp_path / "calls", tmp_path, "train", project.root, "--init", "imagenet")
    assert status == 2
    assert "urllib.Request https://download.pytorch.org" in calls
