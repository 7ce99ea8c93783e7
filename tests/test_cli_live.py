"""bendtrack live: values on stdout and by UDP as they come, words on stderr, and every way to end it."""

from __future__ import annotations

import csv
import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.live.output import COLUMNS, HEADER
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results


@pytest.fixture
def video(tmp_path: Path, write_arm_video) -> Path:
    return write_arm_video(tmp_path / "arm.mp4", 12)


@pytest.fixture
def long_video(tmp_path: Path, write_arm_video) -> Path:
    """Forty seconds: no test waits for its end."""
    return write_arm_video(tmp_path / "long.mp4", 1200)


@contextmanager
def running(bendtrack, *args: object) -> Iterator[subprocess.Popen[str]]:
    """The installed command at work; whatever happens, it does not outlive the test."""
    process = subprocess.Popen(
        [bendtrack.command, "live", *map(str, args)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": ""},
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def rows_of(lines: Sequence[str]) -> list[dict[str, str]]:
    assert lines[0] == HEADER
    return list(csv.DictReader(lines))


def test_a_file_to_csv(bendtrack, trained_project: Project, video: Path) -> None:
    ran = bendtrack("live", trained_project.root, video)
    assert ran.status == 0
    rows = rows_of(ran.out.splitlines())
    frames = [int(row["frame"]) for row in rows]
    assert frames == sorted(set(frames))
    assert frames[0] == 0
    assert frames[-1] == 11  # nothing newer came, so the last one is measured
    np.testing.assert_allclose([float(row["time_s"]) for row in rows], np.array(frames) / 30, atol=1e-4)
    passed_over = [int(row["passed_over"]) for row in rows]
    assert np.diff(frames).tolist() == [n + 1 for n in passed_over[1:]]
    assert all(float(row["latency_ms"]) > 0 for row in rows)
    said = ran.err.splitlines()
    assert said[0].startswith("Network: model ")
    assert said[-1].startswith(f"{len(rows)} value")
    assert f"{sum(passed_over)} frames dropped; capture to value: median" in said[-1]
    # --quiet leaves the values alone.
    quiet = bendtrack("--quiet", "live", trained_project.root, video)
    assert (quiet.status, quiet.err, quiet.out.splitlines()[0]) == (0, "", HEADER)


def test_the_values_are_the_tracked_ones(bendtrack, trained_project: Project, video: Path) -> None:
    """Of a network that is followed, the first frame is found in the same way live and from a file."""
    assert bendtrack("track", trained_project.root, video).status == 0
    table = read_results(trained_project.results_dir / "arm.csv")
    first = rows_of(bendtrack("live", trained_project.root, video).out.splitlines())[0]
    np.testing.assert_allclose(float(first["angle_deg"] or "nan"), table.angle_deg[0], atol=1e-3)
    np.testing.assert_allclose(float(first["angle_sd_deg"] or "nan"), table.angle_sd_deg[0], atol=1e-3)
    np.testing.assert_allclose(float(first["likelihood"]), table.likelihood[0].min(), atol=1e-4)
    assert first["flag"] == table.flag[0]


def test_json_lines_and_datagrams_of_the_same_text(bendtrack, trained_project: Project, video: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(20)
        address = f"127.0.0.1:{listener.getsockname()[1]}"
        ran = bendtrack("live", trained_project.root, video, "--format", "jsonl", "--udp", address)
        lines = ran.out.splitlines(keepends=True)
        assert [listener.recv(4096).decode() for _ in lines] == lines
    values = [json.loads(line) for line in lines]
    assert tuple(values[0]) == COLUMNS
    assert values[-1]["frame"] == 11


def test_duration_ends_it(bendtrack, trained_project: Project, long_video: Path) -> None:
    ran = bendtrack("live", trained_project.root, long_video, "--duration", 0.5)
    assert ran.status == 0
    assert float(rows_of(ran.out.splitlines())[-1]["time_s"]) < 0.5


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_is_the_way_to_end_it(
    bendtrack, trained_project: Project, long_video: Path, number: signal.Signals
) -> None:
    with running(bendtrack, trained_project.root, long_video, "--out", "rig") as process:
        assert process.stdout is not None
        # Each line is there as soon as it is known: the process goes on for half a minute.
        lines = [process.stdout.readline() for _ in range(4)]
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "Traceback" not in err
    rows = rows_of([*"".join(lines).splitlines(), *out.splitlines()])
    assert f"{len(rows)} values in " in err
    table = read_results(trained_project.results_dir / "rig.h5")
    assert len(table) == int(rows[-1]["frame"]) + 1
    assert int((table.flag == "passed_over").sum()) == sum(int(row["passed_over"]) for row in rows)
    measured = [int(row["frame"]) for row in rows]
    np.testing.assert_allclose(
        table.angle_deg[measured], [float(row["angle_deg"] or "nan") for row in rows], atol=1e-4
    )
    assert {path.suffix for path in trained_project.results_dir.glob("rig.*")} == {
        ".csv",
        ".h5",
        ".json",
        ".png",
    }


def test_a_reader_that_has_had_enough_ends_it_quietly(
    bendtrack, trained_project: Project, long_video: Path
) -> None:
    with running(bendtrack, trained_project.root, long_video) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == f"{HEADER}\n"
        process.stdout.close()
        assert process.stderr is not None
        err = process.stderr.read()
        assert process.wait(60) == 0, err
    assert "Traceback" not in err
    assert "BrokenPipe" not in err
    assert err.splitlines()[-1].split()[1].startswith("value")


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("nothing.mp4",), "error: nothing.mp4: no such file"),
        (("977",), "error: 977: no such camera, video file or URL"),
        (("rtsp://127.0.0.1:9/x",), "error: rtsp://127.0.0.1:9/x: cannot be opened (Connection refused)"),
        (("VIDEO", "--udp", "5005"), "error: --udp: expected HOST:PORT such as 127.0.0.1:5005, got '5005'"),
        (("VIDEO", "--size", "640x480"), "error: --size, --rate and --camera-format: expected a camera"),
        (("VIDEO", "--out", "../x"), "error: --out: expected the name of a table, got '../x'"),
        (("VIDEO", "--model", "other"), "error: --model: expected one of model, got 'other'"),
        (("VIDEO", "--engine", "warp"), "error: --engine: expected auto"),
        (("bendtrack.toml",), "no such file"),
    ],
)
def test_bad_input_is_one_line(
    bendtrack, trained_project: Project, video: Path, args: tuple[str, ...], message: str
) -> None:
    ran = bendtrack("live", trained_project.root, *(str(video) if arg == "VIDEO" else arg for arg in args))
    assert (ran.status, ran.out) == (2, "")
    assert message in ran.err
    assert ran.err.count("\n") == 1


def test_wrong_use(bendtrack, trained_project: Project, video: Path) -> None:
    ran = bendtrack("live", trained_project.root, video, "--format", "xml")
    assert (ran.status, ran.out) == (2, "")
    assert "--format: expected one of " in ran.err
    table = trained_project.results_dir / "rig.csv"
    table.parent.mkdir(exist_ok=True)
    table.write_text("the only copy of something")
    ran = bendtrack("live", trained_project.root, video, "--out", "rig")
    assert (ran.status, ran.out) == (2, "")
    assert "--out: expected a new name, got 'rig'" in ran.err
    assert table.read_text() == "the only copy of something"


def test_a_kill_loses_no_row_that_was_printed(bendtrack, trained_project: Project, long_video: Path) -> None:
    """SIGKILL, which no program can catch: the rows are on disk as they were printed."""
    partial = trained_project.results_dir / "rig.partial.csv"
    with running(bendtrack, trained_project.root, long_video, "--out", "rig") as process:
        assert process.stdout is not None
        for _ in range(6):
            process.stdout.readline()
        process.kill()
        printed = process.communicate()[0]
    rows = read_results(partial)
    assert len(rows) >= 5 + len(printed.splitlines()[:-1])
    assert np.isfinite(rows.time_s).all()
    # The next recording does not overwrite what was saved.
    again = bendtrack("live", trained_project.root, long_video, "--out", "rig", "--duration", "0.1")
    assert again.status == 2
    assert "rig.partial.csv is there already" in again.err


def test_a_folder_that_cannot_be_written_is_found_at_the_start(
    bendtrack, trained_project: Project, video: Path
) -> None:
    trained_project.results_dir.rmdir() if trained_project.results_dir.is_dir() else None
    trained_project.results_dir.write_text("a file where the folder should be")
    ran = bendtrack("live", trained_project.root, video, "--out", "rig")
    assert (ran.status, ran.out) == (2, "")
    assert "--out: expected a folder that can be written" in ran.err
