"""Files are whole or not there: exceptions, full disks, read-only folders, killed processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from bendtrack.tracker.atomic import (
    atomic_folder,
    atomic_path,
    atomic_write_bytes,
    atomic_write_text,
    remove_leftovers,
)

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals and limits")


def test_a_file_appears_whole_and_alone(tmp_path: Path) -> None:
    target = tmp_path / "table.csv"
    with atomic_path(target) as temporary:
        temporary.write_text("half")
        assert not target.exists()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".csv"
        assert temporary.name.startswith(".")
    assert target.read_text() == "half"
    assert list(tmp_path.iterdir()) == [target]


def test_text_is_utf8_with_its_newlines_and_replaces_the_old(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    atomic_write_text(target, "old")
    atomic_write_text(target, "Grüße\r\n\n")
    assert target.read_bytes() == "Grüße\r\n\n".encode()
    atomic_write_bytes(target, b"\x00\xff")
    assert target.read_bytes() == b"\x00\xff"


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt])
def test_an_exception_keeps_the_old_file_and_leaves_nothing_behind(
    tmp_path: Path, problem: type[BaseException]
) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write_half() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half of the ne")
            raise problem

    with pytest.raises(problem):
        write_half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_long_name_fits(tmp_path: Path) -> None:
    target = tmp_path / ("t" * 240 + ".csv")
    atomic_write_text(target, "x")
    assert target.read_text() == "x"


def test_a_symbolic_link_stays_one(tmp_path: Path) -> None:
    (tmp_path / "share").mkdir()
    link = tmp_path / "link.txt"
    link.symlink_to(tmp_path / "share" / "real.txt")
    atomic_write_text(link, "x")
    assert link.is_symlink()
    assert (tmp_path / "share" / "real.txt").read_text() == "x"


def test_a_missing_folder_is_an_os_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        atomic_write_text(tmp_path / "nowhere" / "a.txt", "x")
    assert caught.value.filename == str(tmp_path / "nowhere" / "a.txt")  # not the temporary file's


@posix
def test_permissions_are_those_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    atomic_write_text(tmp_path / "a.txt", "x")
    assert (tmp_path / "a.txt").stat().st_mode == (tmp_path / "plain").stat().st_mode


@posix
def test_a_read_only_folder_is_an_os_error() -> None:
    with tempfile.TemporaryDirectory() as name:  # not tmp_path, whose parents another user cannot pass
        Path(name).chmod(0o555)
        me = os.geteuid()
        if me == 0:
            os.seteuid(65534)  # root may write anywhere
        try:
            with pytest.raises(PermissionError):
                atomic_write_text(Path(name) / "a.txt", "x")
        finally:
            os.seteuid(me)
        assert list(Path(name).iterdir()) == []


# A limit on the size of files fails a write in the middle, as a full disk does.
ON_A_FULL_DISK = """
import resource, signal, sys
from bendtrack.tracker.atomic import atomic_write_text
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    atomic_write_text(sys.argv[1], "new " * 1000)
except OSError as error:
    print(type(error).__name__)
"""


@posix
def test_a_full_disk_keeps_the_old_file_and_leaves_nothing_behind(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    done = subprocess.run(
        [sys.executable, "-c", ON_A_FULL_DISK, target], capture_output=True, text=True, check=True
    )
    assert done.stdout == "OSError\n"
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


WRITER = """
import sys
from bendtrack.tracker.atomic import atomic_write_text
print("ready", flush=True)
letters = "abcdefgh" * 1000
for i in range(10**9):
    atomic_write_text(sys.argv[1], letters[i % 8] * 300_000)
"""


@posix
def test_a_killed_writer_leaves_one_whole_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    for pause in (0.01, 0.05, 0.1):
        writer = subprocess.Popen([sys.executable, "-c", WRITER, target], stdout=subprocess.PIPE)
        assert writer.stdout is not None
        writer.stdout.readline()
        while not target.exists():
            time.sleep(0.01)
        time.sleep(pause)
        writer.send_signal(signal.SIGKILL)
        writer.wait()
        writer.stdout.close()
        text = target.read_text()
        assert len(text) == 300_000
        assert len(set(text)) == 1


SLOW_WRITER = """
import sys
from pathlib import Path
from bendtrack.tracker.atomic import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    Path(temporary).write_text("half")  # opens and closes it, as every writer does
    print("writing", flush=True)
    sys.stdin.readline()
    Path(temporary).write_text("whole")
"""


@posix
def test_leftovers_go_and_what_another_process_is_writing_stays(tmp_path: Path) -> None:
    def start(name: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-c", SLOW_WRITER, tmp_path / name]
        pipe = subprocess.PIPE
        writer = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        assert writer.stdout is not None
        assert writer.stdout.readline() == "writing\n"
        return writer

    long = "x" * 40  # as much of a name as a temporary file's shows
    killed, other, alive = start(f"{long}-1.csv"), start("other.csv"), start(f"{long}-2.csv")
    for writer in (killed, other):
        writer.kill()
        writer.communicate()
    assert len(list(tmp_path.iterdir())) == 3
    remove_leftovers(tmp_path, f"{long}-1")
    assert sorted(path.name[:3] for path in tmp_path.iterdir()) == [".ot", ".xx"]
    alive.communicate("go on\n")
    assert alive.returncode == 0
    assert (tmp_path / f"{long}-2.csv").read_text() == "whole"
    (tmp_path / ".mine.csv").touch()
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".mine.csv", f"{long}-2.csv"]


@posix
def test_a_folder_appears_whole_and_its_leftovers_go(tmp_path: Path) -> None:
    out = tmp_path / "export"
    left = tmp_path / ".export.0123456789ab.tmp"
    (left / "labeled-data").mkdir(parents=True)
    with atomic_folder(out) as staging:
        assert not left.exists()
        (staging / "a.txt").write_text("x")
        remove_leftovers(tmp_path)
        assert staging.is_dir()  # it is being written
        assert not out.exists()
    assert [path.name for path in out.iterdir()] == ["a.txt"]
    assert [path.name for path in tmp_path.iterdir()] == ["export"]


@posix
def test_leftovers_that_are_links_or_pipes_are_left_alone(tmp_path: Path) -> None:
    kept = tmp_path / "kept.txt"
    kept.write_text("x")
    (tmp_path / ".a.0123456789ab.tmp").symlink_to(kept)
    (tmp_path / ".b.0123456789ab.tmp").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(tmp_path / ".c.0123456789ab.tmp")
    remove_leftovers(tmp_path)
    assert kept.read_text() == "x"
