"""bendtrack frames and labels check, as users run them, on a drawn arm whose angles are known."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.labeling.store import LabelStore, frame_index
from bendtrack.tracker.project import Project
from bendtrack.tracker.video import Video, read_frame
from bendtrack.tracker.video_writer import VideoWriter

FRAMES = 150


@pytest.fixture(scope="session")
def arm_video(tmp_path_factory: pytest.TempPathFactory, write_arm_video) -> Path:
    return write_arm_video(tmp_path_factory.mktemp("videos") / "arm.mp4", FRAMES)


@pytest.fixture
def empty(bendtrack, tmp_path: Path) -> Path:
    root = tmp_path / "study"
    assert bendtrack("new", root).status == 0
    return root


def angles_deg(frames: list[int]) -> np.ndarray:
    """As `arm_video` shows them."""
    return 50 - 50 * np.cos(2 * np.pi * np.array(frames) / (FRAMES - 1))


def saved(root: Path, stem: str = "arm") -> list[int]:
    frames = [frame_index(path.name) for path in LabelStore.of(Project.open(root)).images(stem)]
    assert None not in frames
    return [frame for frame in frames if frame is not None]


def write_log(path: Path, kpa: np.ndarray) -> Path:
    """A log of 100 samples a second over the length of `arm_video`, of pressures that are evenly spread over it."""
    time_s = np.arange(0, FRAMES / 30 + 0.1, 0.01)
    pressure = np.interp(time_s, np.linspace(0, FRAMES / 30, len(kpa)), kpa)
    rows = [f"{t:.2f},{p:.3f}" for t, p in zip(time_s, pressure, strict=True)]
    path.write_text("\n".join(["time_s,pressure_kpa", *rows]) + "\n")
    return path


def test_frames_are_saved_as_they_are_in_the_video_and_the_actuator_is_noted(
    bendtrack, empty: Path, arm_video: Path
) -> None:
    ran = bendtrack("frames", empty, arm_video, "--actuator", "original", "--count", 12)
    assert (ran.status, ran.err) == (0, "")
    assert "original: 12 new pictures to label, 12 in all" in ran.out
    frames = saved(empty)
    assert len(frames) == 12
    reached = np.sort(angles_deg(frames))
    assert np.ptp(reached) >= 95
    assert np.diff(reached).max() <= 2.3 * 100 / 11
    assert Project.open(empty).settings.actuators == {"original": ("arm",)}
    for frame in frames[:3]:
        picture = cv2.imread(str(empty / "labeled-data" / "arm" / f"img{frame:05d}.png"))[..., ::-1]
        np.testing.assert_array_equal(picture, read_frame(arm_video, frame))


def test_asked_again_there_are_more_and_none_twice(bendtrack, empty: Path, arm_video: Path) -> None:
    bendtrack("frames", empty, arm_video, "--count", 6)
    first = {path: path.stat().st_mtime_ns for path in (empty / "labeled-data" / "arm").iterdir()}
    ran = bendtrack("frames", empty, arm_video, "--count", 6)
    assert "default: 6 new pictures to label, 12 in all" in ran.out
    assert len(saved(empty)) == 12
    assert all(path.stat().st_mtime_ns == before for path, before in first.items())
    assert np.diff(np.sort(angles_deg(saved(empty)))).max() <= 2.3 * 100 / 11


def test_by_time_they_are_evenly_spread_over_it(bendtrack, empty: Path, arm_video: Path) -> None:
    assert bendtrack("frames", empty, arm_video, "--count", 10, "--by", "time").status == 0
    frames = saved(empty)
    assert len(frames) == 10
    np.testing.assert_allclose(frames, np.linspace(0, FRAMES - 1, 10), atol=0.75 * FRAMES / 9)


def test_by_pressure_both_ways_of_each_video(bendtrack, empty: Path, arm_video: Path, tmp_path: Path) -> None:
    other = Path(shutil.copy(arm_video, tmp_path / "second.mp4"))
    up_and_down = np.r_[np.linspace(0, 40, 76) ** 2 / 40, np.linspace(40, 0, 75)]
    logs = [write_log(tmp_path / f"{name}.csv", up_and_down) for name in ("arm", "second")]
    ran = bendtrack(
        *("frames", empty, arm_video, other, "--count", 16, "--actuator", "a"),
        *("--pressure", logs[0], "--pressure", logs[1]),
    )
    assert (ran.status, ran.err) == (0, "")
    frames = {stem: np.array(saved(empty, stem)) for stem in ("arm", "second")}
    assert [len(found) for found in frames.values()] == pytest.approx([8, 8], abs=1)
    both = np.concatenate(list(frames.values()))
    kpa = np.sort(np.interp(both, np.linspace(0, FRAMES, len(up_and_down)), up_and_down))
    assert np.ptp(kpa) >= 0.95 * 40
    assert np.diff(kpa).max() <= 2.3 * 40 / 15
    rising = (both < FRAMES / 2).sum()
    assert 5 <= rising <= 11


def test_a_folder_of_logs_goes_by_the_videos_names(
    bendtrack, empty: Path, arm_video: Path, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    write_log(tmp_path / "logs" / "arm.csv", np.array([0.0, 40.0, 0.0]))
    ran = bendtrack("frames", empty, arm_video, "--count", 4, "--pressure", tmp_path / "logs")
    assert (ran.status, ran.err) == (0, "")
    (tmp_path / "logs" / "arm.csv").rename(tmp_path / "logs" / "leg.csv")
    ran = bendtrack("frames", empty, arm_video, "--pressure", tmp_path / "logs")
    assert ran.status == 2
    assert "expected one pressure log named arm, got none" in ran.err


def test_another_video_of_the_same_name_gets_a_folder_of_its_own(
    bendtrack, empty: Path, arm_video: Path, tmp_path: Path
) -> None:
    assert bendtrack("frames", empty, arm_video, "--count", 5).status == 0
    before = saved(empty)
    reversed_arm = tmp_path / "arm.mp4"
    images = [frame.image for frame in Video(arm_video)]
    with VideoWriter(reversed_arm, (96, 72), 30.0) as writer:
        for index, image in enumerate(images):
            writer.write(image[::-1].copy(), index / 30)
    for repeat in (1, 2):
        ran = bendtrack("frames", empty, reversed_arm, "--count", 5)
        assert ran.status == 0
        assert "images named 'arm' belong to another video, so these are named 'arm-" in ran.err
        folders = sorted(folder.name for folder in (empty / "labeled-data").iterdir())
        assert len(folders) == 2
        assert len(saved(empty, folders[1])) == 5 * repeat
    assert saved(empty) == before
    ran = bendtrack("frames", empty, arm_video, "--count", 2)
    assert (ran.status, ran.err) == (0, "")
    assert len(saved(empty)) == 7


def test_one_video_that_cannot_be_read_is_status_1_and_the_others_are_done(
    bendtrack, empty: Path, arm_video: Path, tmp_path: Path
) -> None:
    (tmp_path / "broken.mp4").write_bytes(b"no video at all")
    ran = bendtrack("frames", empty, tmp_path / "broken.mp4", arm_video, "--count", 4, "--actuator", "a")
    assert ran.status == 1
    assert ran.err.splitlines()[-1].startswith(f"error: {tmp_path / 'broken.mp4'}: not a video")
    assert len(saved(empty)) == 4
    assert Project.open(empty).settings.actuators == {"a": ("arm",)}
    assert bendtrack("frames", empty, tmp_path / "broken.mp4").status == 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--count", "0"), "expected at least 1 frame to select, got 0"),
        (("--by", "pressure"), "expected pressure logs, got none"),
        (("--by", "colour"), "--by: expected one of pressure, appearance, time, got 'colour'"),
        (("--pressure", "nowhere.csv"), "nowhere.csv"),
        (
            ("--pressure", "a.csv", "--pressure", "b.csv"),
            "one pressure log for each video, in the same order, got 2 logs",
        ),
        (("--pressure", "a.csv", "--by", "time"), "expected no pressure log with frames by time"),
        (("--actuator", "=x"), "actuator name"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(
    bendtrack, empty: Path, arm_video: Path, options: tuple[str, ...], message: str
) -> None:
    ran = bendtrack("frames", empty, arm_video, *options)
    assert ran.status == 2
    assert message in ran.err
    assert "Traceback" not in ran.err
    assert not (empty / "labeled-data").exists()


def test_a_log_that_ends_before_the_video_begins(
    bendtrack, empty: Path, arm_video: Path, tmp_path: Path
) -> None:
    log = write_log(tmp_path / "log.csv", np.array([0.0, 40.0]))
    rows = [line.split(",") for line in log.read_text().splitlines()]
    log.write_text(
        "\n".join(",".join([f"{float(t) + 1000:.2f}" if i else t, p]) for i, (t, p) in enumerate(rows))
    )
    ran = bendtrack("frames", empty, arm_video, "--pressure", log)
    assert ran.status == 2
    assert "within the times of a log" in ran.err


# --- labels check ----------------------------------------------------------------------------------------


def test_clean_labels_are_status_0(bendtrack, project: Project) -> None:
    ran = bendtrack("labels", "check", project.root)
    assert (ran.status, ran.err) == (0, "")
    assert ran.out == "10 labelled frames with 40 points: nothing to look at\n"


def test_findings_come_with_a_link_and_status_1(bendtrack, project: Project) -> None:
    store = LabelStore.of(project)
    frames = store.read()
    store.write("arm", {"img00004.png": frames[4].xy[[1, 0, 2, 3]]})
    missing = frames[6].xy.copy()
    missing[2] = np.nan
    store.write("arm", {"img00006.png": missing})
    ran = bendtrack("labels", "check", project.root)
    assert ran.status == 1
    lines = ran.out.splitlines()
    folder = project.labels_dir / "arm"
    assert lines[0].startswith(
        f"{folder / 'img00004.png'}: swapped points: base_1 and base_2 seem to be swapped"
    )
    assert lines[0].endswith("#arm/img00004.png")
    assert lines[1].startswith(f"{folder / 'img00006.png'}: missing point: tip_1 not labelled")
    assert lines[-1] == "10 labelled frames with 39 points: 2 to look at"
    # What the #... is for.
    assert lines[-2].startswith(
        f"To open one: start bendtrack label {project.root}, and put what begins with #"
    )


def test_what_cannot_be_checked_is_status_2(bendtrack, empty: Path, tmp_path: Path) -> None:
    assert bendtrack("labels", "check", empty).status == 2
    assert bendtrack("labels", "check", tmp_path / "nowhere").status == 2
    assert bendtrack("labels").status == 2
