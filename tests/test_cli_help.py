"""What every command has in common: --help, --version, usage errors, --quiet and --debug."""

from __future__ import annotations

import os
import re
import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest
from typer.core import TyperOption
from typer.main import get_command

from bendtrack.tracker.cli import app
from bendtrack.tracker.cli.app import COMMAND_GROUPS
from bendtrack.tracker.project import Project

COMMANDS = (
    *("demo", "new", "frames", "label", "import", "export", "train", "evaluate", "track", "live", "angle"),
    *("analyze", "render", "pretrain", "doctor"),
)


def test_these_are_the_commands(bendtrack) -> None:
    ran = bendtrack("--help")
    assert ran.status == 0
    listed = ran.out.split("--help ")[1]
    # Two spaces before a name; a sentence that is folded goes on further right.
    names = [line.split()[0] for line in listed.splitlines()[1:] if line[:2] == "  " and line[2:3].islower()]
    assert sorted(names) == sorted((*COMMANDS, "labels"))
    assert tuple(names) == tuple(name for group in COMMAND_GROUPS.values() for name in group)
    assert all(f"\n{title}:\n" in ran.out for title in COMMAND_GROUPS)
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
    if command == "render":  # its options are described with its own defaults elsewhere
        return
    # Words for people, not for programmers.
    assert not re.search(r"<(list|str|int|float|path|Path)|[{}]", ran.out), ran.out
    for option in click_options(command):
        assert option.help.endswith((".", "?")), option.name  # a sentence
        assert len(option.help.split()) >= 3, option.help


def click_options(command: str) -> list[TyperOption]:
    """The options of a command that its help shows, but for --help itself."""
    found = get_command(app).commands[command]
    return [p for p in found.params if isinstance(p, TyperOption) and not p.hidden]


@pytest.mark.parametrize("command", [name for name in COMMANDS if name != "render"])
def test_every_option_with_a_value_says_its_default(bendtrack, command: str) -> None:
    for option in click_options(command):
        if not option.is_flag and not option.multiple:
            assert option.default is not None or isinstance(option.show_default, str), option.name


def test_completion_is_offered(bendtrack) -> None:
    ran = bendtrack("--help")
    assert "--install-completion" in ran.out
    assert "--show-completion" in ran.out
    done = subprocess.run(
        [bendtrack.command],
        env={
            **os.environ,
            "_BENDTRACK_COMPLETE": "complete_bash",
            "COMP_WORDS": "bendtrack tr",
            "COMP_CWORD": "1",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert set(done.stdout.split()) == {"track", "train"}


@pytest.mark.parametrize(
    "command",
    [
        ("track", "a.mp4", "my study"),
        ("frames", "a.mp4", "my study"),
        ("export", "a", "my study"),
        ("import", "a.csv", "my study"),
    ],
)
def test_arguments_in_the_wrong_order_are_seen(
    bendtrack, tmp_path: Path, monkeypatch, command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    Project.create(tmp_path / "my study", keypoints=("a", "b", "c", "d"))
    ran = bendtrack(*command)
    assert ran.status == 2
    assert "did you swap them?" in ran.err
    assert f"`bendtrack {command[0]} 'my study' {command[1]}`" in ran.err  # can be pasted


def test_version_as_installed(bendtrack) -> None:
    assert bendtrack.installed("--version").out == f"bendtrack {version('bendtrack')}\n"


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((), "Usage: bendtrack"),
        (("measure",), "expected a command, got 'measure'"),
        (("trian",), "got 'trian': did you mean train"),
        (("train",), "expected PROJECT, got nothing"),
        (("track", "somewhere"), "expected VIDEO..., got nothing"),
        (("train", "somewhere", "--max-minutes", "soon"), "--max-minutes: expected a number, got 'soon'"),
        (("train", "somewhere", "--max-minutes=soon"), "--max-minutes: expected a number, got 'soon'"),
        (("train", "somewhere", "--seed", "1.5"), "--seed: expected a whole number, got '1.5'"),
        (("label", "somewhere", "--port", "99999"), "--port: expected at most 65535, got '99999'"),
        (("render", "out", "--seed=-1"), "--seed: expected at least 0, got '-1'"),
        (
            ("export", "somewhere", "out", "--format", "yolo"),
            "--format: expected one of dlc, coco, sleap, lightning-pose",
        ),
        (("train", "somewhere", "--fast"), "expected an option of bendtrack train, got --fast"),
        (("train", "somewhere", "--minutes", "5"), "got --minutes: did you mean --max-minutes?"),
        (("--vresion",), "expected an option of bendtrack, got --vresion: did you mean --version?"),
        (("labels", "chek"), "expected a command, got 'chek': did you mean check?"),
        (("angle", "a.mp4", "--no-browser"), "--no-browser belongs to --label"),
        (("train", "somewhere", "else"), "unexpected extra argument"),
        (("train", "somewhere", "--seed"), "--seed' requires an argument (help: bendtrack train --help)"),
    ],
)
def test_wrong_use_is_status_2(bendtrack, args: tuple[str, ...], message: str) -> None:
    ran = bendtrack(*args)
    assert ran.status == 2
    assert message in ran.out + ran.err
    if args:  # without a command there is the help
        assert ran.err.startswith("error: ")
        assert ran.err.count("\n") == 1
        assert "(help: bendtrack" in ran.err


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
