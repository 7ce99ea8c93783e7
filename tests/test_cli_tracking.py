"""bendtrack track: which videos, what is written, what is up to date, what a kill leaves."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results
from bendtrack.tracker.video import Video


@pytest.fixture
def videos(tmp_path: Path, write_arm_video) -> Path:
    """A folder with a.mp4 and b.MP4, and a text."""
    folder = tmp_path / "videos"
    folder.mkdir()
    write_arm_video(folder / "a.mp4", 12)
    write_arm_video(folder / "b.mp4", 7).rename(folder / "b.MP4")
    (folder / "notes.txt").write_text("not a video")
    return folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_becomes_tables_figures_and_overlays(
    bendtrack, trained_project: Project, videos: Path
) -> None:
    ran = bendtrack("track", trained_project.root, videos, "--overlay")
    assert (ran.status, ran.err) == (0, "")
    results = trained_project.results_dir
    assert names(results) == [
        f"{stem}.{kind}" for stem in "ab" for kind in ("csv", "h5", "json", "overlay.mp4", "png")
    ]
    assert "a.mp4: 12 frames" in ran.out
    table = read_results(results / "a.csv")
    assert len(table) == 12
    assert table.definition == read_results(results / "a.h5").definition
    assert len(list(Video(results / "a.overlay.mp4"))) == 12
    record = json.loads((results / "a.json").read_text())
    assert record["detector"]["checkpoint_sha256"]
    assert set(record["files"]) == {"csv", "h5", "png", "mp4"}


def test_what_is_up_to_date_is_passed_over(bendtrack, trained_project: Project, videos: Path) -> None:
    results = trained_project.results_dir
    pattern = videos / "*"  # the text among them is no video
    assert bendtrack("track", trained_project.root, pattern).status == 0
    before = {path.name: path.stat().st_mtime_ns for path in results.iterdir()}
    ran = bendtrack("track", trained_project.root, pattern, videos / "a.mp4")
    assert ran.out.count(": up to date") == 2
    assert {path.name: path.stat().st_mtime_ns for path in results.iterdir()} == before

    # An overlay that is asked for later is drawn from the table that is there.
    ran = bendtrack("track", trained_project.root, videos / "a.mp4", "--overlay")
    assert "up to date" in ran.out
    assert (results / "a.overlay.mp4").is_file()
    assert (results / "a.csv").stat().st_mtime_ns == before["a.csv"]

    # Damage is seen, and so is a setting that changed.
    (results / "b.csv").write_text("frame\n")
    assert bendtrack("track", trained_project.root, pattern).out.count(": up to date") == 1
    toml = trained_project.root / "bendtrack.toml"
    toml.write_text(toml.read_text().replace("# min_likelihood = 0.6 ", "min_likelihood = 0.3 "))
    ran = bendtrack("track", trained_project.root, pattern, "--overlay")
    assert ": up to date" not in ran.out
    assert ran.out.count("overlay ->") == 2  # the old one showed the old table
    assert ": up to date" not in bendtrack("track", trained_project.root, pattern, "--force").out


def test_each_video_ends_with_range_sd_and_flags(bendtrack, trained_project: Project, videos: Path) -> None:
    ran = bendtrack("track", trained_project.root, videos / "a.mp4")
    table = read_results(trained_project.results_dir / "a.h5")
    last = ran.out.splitlines()[-1]
    assert f"angle {np.nanmin(table.angle_deg):.1f} to {np.nanmax(table.angle_deg):.1f}°" in last
    assert f"sd {np.nanmedian(table.angle_sd_deg):.2f}° (median)" in last
    kinds, counts = np.unique(table.flag[table.flag != ""], return_counts=True)
    assert f"{counts.sum()} of 12 rows flagged" in last
    for kind, count in zip(kinds, counts, strict=True):
        assert f"{count} {kind}" in last
    assert bendtrack("track", trained_project.root, videos / "a.mp4").out.splitlines()[-1] == last


def test_an_overlay_with_the_name_it_had_before_is_still_ours(
    bendtrack, trained_project: Project, videos: Path
) -> None:
    results = trained_project.results_dir
    assert bendtrack("track", trained_project.root, videos / "a.mp4", "--overlay").status == 0
    (results / "a.overlay.mp4").rename(results / "a.mp4")
    ran = bendtrack("track", trained_project.root, videos / "a.mp4", "--overlay")
    assert "overlay ->" not in ran.out  # it shows the table as it is
    ran = bendtrack("track", trained_project.root, results)
    assert ran.status == 2
    assert "got a folder without any" in ran.err  # and is no video to track


def test_what_an_engine_changes_is_for_debugging(bendtrack, trained_project: Project, videos: Path) -> None:
    record = trained_project.models_dir / "model" / "engine" / "engine.json"
    record.unlink()
    ran = bendtrack("track", trained_project.root, videos / "a.mp4")
    assert "Compiling 'model' for the CPU (once)" in ran.out
    assert "from float32" not in ran.out + ran.err
    record.unlink()
    ran = bendtrack("track", trained_project.root, videos / "a.mp4", "--debug")
    assert "openvino: 0.000 px" in ran.out


def test_another_network_makes_new_tables(bendtrack, trained_project: Project, videos: Path) -> None:
    assert bendtrack("track", trained_project.root, videos / "a.mp4").status == 0
    assert bendtrack("train", trained_project.root, "--seed", 8).status == 0
    ran = bendtrack("track", trained_project.root, videos / "a.mp4")
    assert "Network: model-2" in ran.out
    assert "12 frames" in ran.out
    ran = bendtrack("track", trained_project.root, videos / "a.mp4", "--model", "model")
    assert "Network: model " in ran.out
    assert "12 frames" in ran.out


def test_videos_of_one_name_keep_their_own_results(
    bendtrack, trained_project: Project, videos: Path, write_arm_video
) -> None:
    (videos / "more").mkdir()
    other = write_arm_video(videos / "more" / "a.mp4", 9)
    ran = bendtrack("track", trained_project.root, videos / "a.mp4", other)
    assert ran.status == 0
    assert "belong to another video" in ran.err
    tables = sorted(trained_project.results_dir.glob("a*.csv"))
    assert sorted(len(read_results(path)) for path in tables) == [9, 12]


def test_results_beside_the_videos_leave_the_videos_alone(
    bendtrack, trained_project: Project, videos: Path
) -> None:
    before = {path.name: path.read_bytes() for path in videos.iterdir()}
    for _ in range(2):
        ran = bendtrack("track", trained_project.root, videos, "--out", videos, "--overlay")
        assert ran.status == 0
    assert {name: (videos / name).read_bytes() for name in before} == before
    assert {"a.overlay.mp4", "a.angle.png", "a.csv"} <= set(names(videos))
    assert ran.out.count(": up to date") == 2  # an overlay is not tracked as a video


def test_a_file_that_is_not_ours_is_not_overwritten(
    bendtrack, trained_project: Project, videos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.mp4").write_bytes(b"the only copy of something")
    assert bendtrack("track", trained_project.root, videos / "a.mp4", "--out", out, "--overlay").status == 0
    assert (out / "a.mp4").read_bytes() == b"the only copy of something"
    assert (out / "a.overlay.mp4").is_file()


def test_a_figure_that_cannot_be_drawn_is_told_and_the_table_is_there(
    bendtrack, trained_project: Project, videos: Path, tmp_path: Path
) -> None:
    """Figures are drawn beside the tracking of the next video: what goes wrong there must not be lost."""
    out = tmp_path / "out"
    for name in ("a.png", "a.angle.png"):
        (out / name).mkdir(parents=True)
    ran = bendtrack("track", trained_project.root, videos, "--out", out)
    assert ran.status == 2
    assert "a.angle.png: cannot be written" in ran.err
    assert len(read_results(out / "a.csv")) == 12
    assert len(read_results(out / "b.csv")) == 7


def test_the_angle_is_the_one_the_network_was_trained_for(
    bendtrack, trained_project: Project, videos: Path
) -> None:
    toml = trained_project.root / "bendtrack.toml"
    toml.write_text(toml.read_text().replace('definition = "two-vector"', 'definition = "arc-fit"'))
    ran = bendtrack("track", trained_project.root, videos / "a.mp4")
    assert ran.status == 0
    assert "bendtrack.toml names another angle" in ran.err
    assert read_results(trained_project.results_dir / "a.h5").definition.name == "two-vector"


def test_a_moved_project_works(bendtrack, trained_project: Project, videos: Path, tmp_path: Path) -> None:
    assert bendtrack("track", trained_project.root, videos / "a.mp4").status == 0
    moved = shutil.move(trained_project.root, tmp_path / "elsewhere and spaces é")
    ran = bendtrack("track", moved, videos / "a.mp4")
    assert (ran.status, ran.err) == (0, "")
    assert "up to date" in ran.out


def has_open(process: subprocess.Popen[str], file: Path) -> bool:
    """Whether a process has a file open at this moment."""
    links = Path(f"/proc/{process.pid}/fd").iterdir()
    with suppress(OSError):  # closed while we look
        return any(os.readlink(link) == str(file) for link in links)
    return False


def test_a_kill_leaves_whole_files_and_the_next_run_finishes(
    bendtrack, trained_project: Project, videos: Path, write_arm_video
) -> None:
    write_arm_video(videos / "c.mp4", 600)
    results = trained_project.results_dir
    process = subprocess.Popen(
        [bendtrack.command, "track", trained_project.root, videos], stdout=subprocess.PIPE, text=True
    )
    end = time.monotonic() + 200
    while not ((results / "b.png").exists() and has_open(process, videos / "c.mp4")):  # in the middle of c
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not any(name.startswith("c.") for name in names(results))
    (results / ".c.0123456789ab.tmp.h5").write_bytes(b"half")  # what a kill while writing leaves
    write_arm_video(videos / "c.mp4", 5)
    ran = bendtrack("track", trained_project.root, videos)
    assert ran.status == 0
    assert ran.out.count(": up to date") >= 1
    assert "c.mp4: 5 frames" in ran.out
    assert names(results) == [f"{stem}.{kind}" for stem in "abc" for kind in ("csv", "h5", "json", "png")]


def test_videos_in_sub_folders_are_named_by_a_pattern(
    bendtrack, trained_project: Project, write_arm_video, tmp_path: Path
) -> None:
    (tmp_path / "films" / "day 1").mkdir(parents=True)
    write_arm_video(tmp_path / "films" / "day 1" / "a.mp4", 3)
    ran = bendtrack("track", trained_project.root, tmp_path / "films")
    assert ran.status == 2
    assert f"Videos lie in its sub-folders: write '{tmp_path}/films/*/*.mp4', quotes included" in ran.err
    assert ran.err.count("\n") == 1
    (tmp_path / "empty").mkdir()
    assert "sub-folders" not in bendtrack("track", trained_project.root, tmp_path / "empty").err


def test_what_is_no_video_is_said_before_a_network_is_loaded(
    bendtrack, trained_project: Project, tmp_path: Path
) -> None:
    (tmp_path / "notes.mp4").write_text("no film")
    for words in (("track", trained_project.root), ("angle", "--out", tmp_path / "out")):
        ran = bendtrack(*words, tmp_path / "notes.mp4")
        assert ran.status == 1
        assert "Network:" not in ran.out
        assert ran.err.startswith(f"error: {tmp_path / 'notes.mp4'}: not a video")
