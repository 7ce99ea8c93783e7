"""Links in a project: nothing is written through one. Links to the project itself, and outside of it, work."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bendtrack.tracker.atomic import atomic_write_text, remove_leftovers
from bendtrack.tracker.links import LinkError, link_within_project, make_folder, open_own_file

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs symbolic links")

SHELL = "# a shell's start file\n"


@pytest.fixture
def project(tmp_path: Path) -> Path:
    root = tmp_path / "study"
    (root / "results").mkdir(parents=True)
    (root / "bendtrack.toml").write_text("")
    return root


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A file of the user's outside of the project."""
    file = tmp_path / "home" / ".bashrc"
    file.parent.mkdir()
    file.write_text(SHELL)
    return file


def test_a_file_that_is_a_link_is_refused_in_one_line(project, outside) -> None:
    (project / "results" / "a.csv").symlink_to(outside)
    with pytest.raises(LinkError, match=r"got a link to .*bashrc.*--out") as caught:
        atomic_write_text(project / "results" / "a.csv", "x")
    assert caught.value.filename == str(project / "results" / "a.csv")
    assert "\n" not in str(caught.value)
    assert outside.read_text() == SHELL
    assert os.listdir(outside.parent) == [".bashrc"]


@pytest.mark.parametrize("target", ["home", "nowhere", "study/other"], ids=["outside", "dangling", "inside"])
def test_a_folder_that_is_a_link_is_refused(project, outside, target) -> None:
    (project / "other").mkdir()
    (project / "models").symlink_to(project.parent / target)
    for refused in (
        lambda: atomic_write_text(project / "models" / "a.txt", "x"),
        lambda: atomic_write_text(project / "models" / "deep" / "a.txt", "x"),
        lambda: make_folder(project / "models" / "model"),
        lambda: make_folder(project / "models"),
        lambda: os.close(open_own_file(project / "models" / "a.txt", os.O_CREAT | os.O_WRONLY)),
    ):
        with pytest.raises(LinkError):
            refused()
    assert os.listdir(outside.parent) == [".bashrc"]
    assert not os.listdir(project / "other")


def test_dots_do_not_hide_a_link(project, outside) -> None:
    (project / "models").symlink_to(outside.parent)
    with pytest.raises(LinkError):
        atomic_write_text(project / "models" / ".." / "a.txt", "x")


def test_a_relative_path_is_looked_at_too(project, outside, monkeypatch) -> None:
    (project / "results" / "a.csv").symlink_to(outside)
    monkeypatch.chdir(project / "results")
    with pytest.raises(LinkError):
        atomic_write_text("a.csv", "x")


def test_a_link_to_another_project_is_refused(project, tmp_path) -> None:
    other = tmp_path / "mine"
    other.mkdir()
    (other / "bendtrack.toml").write_text("mine")
    (project / "results" / "sub").symlink_to(other)
    with pytest.raises(LinkError):
        atomic_write_text(project / "results" / "sub" / "bendtrack.toml", "theirs")
    assert (other / "bendtrack.toml").read_text() == "mine"


def test_settings_that_are_a_link_are_refused(tmp_path, outside) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "bendtrack.toml").symlink_to(outside)
    with pytest.raises(LinkError):
        atomic_write_text(tmp_path / "study" / "bendtrack.toml", "x")
    assert outside.read_text() == SHELL


def test_a_link_to_the_whole_project_works(project, tmp_path) -> None:
    (tmp_path / "short").symlink_to(project)
    atomic_write_text(tmp_path / "short" / "results" / "a.csv", "x")
    assert (project / "results" / "a.csv").read_text() == "x"
    assert link_within_project(tmp_path / "short") is None


def test_hard_links_are_broken_or_refused(project, outside) -> None:
    for name in ("a.csv", "journal.jsonl"):
        os.link(outside, project / "results" / name)
    atomic_write_text(project / "results" / "a.csv", "x")  # another file takes the name
    with pytest.raises(LinkError, match="hard link"):
        open_own_file(project / "results" / "journal.jsonl", os.O_APPEND | os.O_WRONLY)
    assert outside.read_text() == SHELL


def test_what_is_changed_in_place_is_a_plain_file(project) -> None:
    pipe = project / "results" / "journal.jsonl"
    os.mkfifo(pipe)
    for flags in (os.O_RDONLY, os.O_RDWR | os.O_APPEND):
        with pytest.raises(OSError, match="plain file"):  # and does not wait for whoever opens the other end
            open_own_file(pipe, flags)


def test_leftovers_behind_a_link_stay(project, outside) -> None:
    name = ".a.0123456789ab.tmp.csv"
    (outside.parent / name).write_text("somebody else's")
    (project / "models").symlink_to(outside.parent)
    remove_leftovers(project / "models")
    assert (outside.parent / name).exists()
    (project / "results" / name).symlink_to(outside)
    remove_leftovers(project / "results")
    assert outside.read_text() == SHELL
