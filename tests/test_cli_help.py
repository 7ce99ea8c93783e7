"""What every command has in common: --help, --version, usage errors, --quiet and --debug."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

import pytest

from bendtrack.tracker.cli import app

COMMANDS = (
    *("demo", "new", "frames", "label", "import", "export", "train", "evaluate", "track", "live", "angle"),
    *("analyze", "render", "pretrain", "doctor"),
)


def test_these_are_the_commands(bendtrack) -> None:
    ran = bendtrack("--help")
    assert ran.status == 0
    listed = ran.out.split("Commands:")[1].split("\n\n")[0]
    assert tuple(line.split()[0] for line in listed.strip().splitlines()) == (*COMMANDS, "labels")
    assert "..." not in listed  # no sentence is cut off
    assert {command.name for command in app.registered_commands} == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(bendtrack, command: str) -> None:
    ran = bendtrack(command, "--help")
    assert (ran.status, ran.err) == (0, "")
    assert f"Usage: bendtrack {command}" in ran.out
    # Every option says what it is for.
    options = [line for line in ran.out.splitlines() if line.startswith("  --")]
    for place, line in enumerate(ran.out.splitlines()):
        if line.startswith("  --"):
            following = ran.out.splitlines()[place + 1 : place + 2]
            told = len(line.split("  ")) > 2 or (following and following[0].startswith("      "))
            assert told, line
    assert options


def test_version_as_installed(bendtrack) -> None:
    assert bendtrack.installed("--version").out == f"bendtrack {version('bendtrack')}\n"


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "Usage: bendtrack"),
        (("measure",), "No such command 'measure'"),
        (("train",), "Missing argument 'PROJECT'"),
        (("track", "somewhere"), "Missing argument"),
        (("train", "somewhere", "--max-minutes", "soon"), "Invalid value for '--max-minutes'"),
        (("export", "somewhere", "out", "--format", "yolo"), "Invalid value for '--format'"),
        (("train", "somewhere", "--fast"), "No such option"),
    ],
)
def test_wrong_use_is_status_2(bendtrack, args: tuple[str, ...], message: str) -> None:
    ran = bendtrack(*args)
    assert ran.status == 2
    assert message in ran.out + ran.err


@pytest.mark.parametrize("place", ["before", "after"])
def test_quiet_and_debug_stand_anywhere(bendtrack, tmp_path: Path, place: str) -> None:
    folder = tmp_path / "study"
    args = ("new", folder)
    assert bendtrack(*(("--quiet", *args) if place == "before" else (*args, "--quiet"))).out == ""
    again = bendtrack(*(("--debug", *args) if place == "before" else (*args, "--debug")))
    assert again.status == 2
    assert "Traceback" in again.err
    assert again.err.splitlines()[-1].startswith("error: expected a new folder, got a bendtrack project")
    assert bendtrack(*args).err.count("\n") == 1  # without --debug, one line


def test_a_file_called_like_a_switch_can_be_named(bendtrack, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert bendtrack("new", "--", "--quiet").status == 0
    assert (tmp_path / "--quiet" / "bendtrack.toml").is_file()


def test_doctor_says_what_would_be_used(bendtrack) -> None:
    ran = bendtrack("doctor")
    assert (ran.status, ran.err) == (0, "")
    lines = {line[:16].strip(): line[16:] for line in ran.out.splitlines()}
    assert version("torch") in lines["packages"]
    assert "written and read back" in lines["H.264 video"]
    assert "data_samples" in lines["sample trial"]
    assert lines["train would use"].strip().startswith("resnet18 from ")
