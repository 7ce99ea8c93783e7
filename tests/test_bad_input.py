"""What goes wrong at people's desks: for each case the message and the exit status, and that nothing else is lost.

Status 1: some inputs failed, the others are done. Status 2: wrong use, or an input that cannot be used.
A message is one line without a traceback.
"""

from __future__ import annotations

import shutil
import wave
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from bendtrack.models.networks.initialisation import imagenet_file
from bendtrack.tracker.project import Project
from bendtrack.tracker.results import read_results

# --- videos ----------------------------------------------------------------------------------------------


def sound_only(path: Path, good: Path) -> None:
    with wave.open(str(path.with_suffix(".wav")), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(np.zeros(8000, np.int16).tobytes())
    path.with_suffix(".wav").rename(path)


def cut_in_half(path: Path, good: Path) -> None:
    data = good.read_bytes()  # its index is in front
    path.write_bytes(data[: len(data) // 2])


def cut_before_the_index(path: Path, good: Path) -> None:
    with av.open(str(good)) as source, av.open(str(path), "w", format="mp4") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                target.mux(packet)
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"moov")])


def hole_in_the_middle(path: Path, good: Path) -> None:
    with av.open(str(good)) as container:
        places = [(packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    data = bytearray(good.read_bytes())
    start, size = places[len(places) // 2]
    data[start : start + size] = bytes(size)
    path.write_bytes(data)


VIDEOS: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "empty": (lambda path, good: path.touch(), "expected a video, got an empty file"),
    "noise": (lambda path, good: path.write_bytes(np.random.default_rng(0).bytes(5000)), "not a video"),
    "text": (lambda path, good: path.write_text("frame,angle\n" * 100), "not a video"),
    "sound": (sound_only, "expected a video stream, found only audio"),
    "no-index": (cut_before_the_index, "cut off before its index was written"),
}
DAMAGED: dict[str, tuple[Callable[[Path, Path], object], str]] = {
    "truncated": (cut_in_half, "of the 40 frames of its header"),
    "hole": (hole_in_the_middle, "could not be decoded"),
}


@pytest.fixture
def good(tmp_path: Path, write_arm_video) -> Path:
    return write_arm_video(tmp_path / "good.mp4", 40)


@pytest.mark.parametrize("kind", VIDEOS)
def test_a_file_that_is_no_video(bendtrack, trained_project: Project, good: Path, kind: str) -> None:
    make, message = VIDEOS[kind]
    bad = good.with_name("bad.mp4")
    make(bad, good)
    ran = bendtrack("track", trained_project.root, bad)
    assert ran.status == 1
    assert ran.err.count("\n") == 1
    assert ran.err.startswith(f"error: {bad}: ")
    assert message in ran.err
    assert not list(trained_project.results_dir.iterdir())


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_video_is_tracked_as_far_as_it_goes(
    bendtrack, trained_project: Project, good: Path, kind: str
) -> None:
    make, message = DAMAGED[kind]
    bad = good.with_name("bad.mp4")
    make(bad, good)
    for _ in range(2):  # up to date or not, it stays damaged
        ran = bendtrack("track", trained_project.root, bad)
        assert ran.status == 1
        assert ran.err.startswith(f"error: {bad}: damaged, tracked as far as it goes: ")
        assert message in ran.err
    table = read_results(trained_project.results_dir / "bad.h5")
    assert 1 < len(table) <= 40
    assert np.isfinite(table.xy).any()
    assert set(table.flag[np.isnan(table.xy).all(axis=(1, 2))]) <= {"undecodable"}


def test_the_good_ones_are_done_and_the_bad_ones_listed_last(
    bendtrack, trained_project: Project, good: Path
) -> None:
    folder = good.parent / "videos"
    folder.mkdir()
    for name, (make, _) in {**VIDEOS, **DAMAGED}.items():
        make(folder / f"{name}.mp4", good)
    shutil.copy(good, folder / "a.mp4")
    shutil.copy(good, folder / "z.mp4")
    ran = bendtrack("track", trained_project.root, folder, "--overlay")
    assert ran.status == 1
    assert ran.err.startswith("error: 7 of 9 videos failed or are damaged, the others are done:\n")
    assert [Path(line.split(": ")[1]).stem for line in ran.err.splitlines()[1:]] == sorted(
        {**VIDEOS, **DAMAGED}
    )
    done = {path.stem for path in trained_project.results_dir.glob("*.csv")}
    assert done == {"a", "z", *DAMAGED}


def test_a_video_that_may_not_be_read_does_not_end_the_run(
    bendtrack, trained_project: Project, good: Path
) -> None:
    locked = shutil.copy(good, good.parent / "locked.mp4")
    locked.chmod(0)
    ran = bendtrack.installed("track", trained_project.root, locked, good, obey_modes=True)
    assert ran.status == 1, ran.err
    assert f"{locked}: expected a video, got a file that cannot be read (Permission denied)" in ran.err
    assert [path.stem for path in trained_project.results_dir.glob("*.csv")] == [good.stem]


def test_places_where_no_video_is(bendtrack, trained_project: Project, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    for name, message in {
        "missing.mp4": "expected a video, got no such file or folder: ",
        "*.avi": "expected videos, got no file that fits the pattern ",
        "folder": "got a folder without any",
    }.items():
        ran = bendtrack("track", trained_project.root, tmp_path / name)
        assert (ran.status, ran.out) == (2, "")
        assert message in ran.err


# --- projects and labels ---------------------------------------------------------------------------------


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def settings(old: str, new: str) -> Callable[[Project], None]:
    return lambda project: edit(project.root / "bendtrack.toml", old, new)


def label_file(project: Project) -> Path:
    return project.labels_dir / "arm" / "CollectedData_bendtrack.csv"


def without_tip_2(project: Project) -> None:
    lines = label_file(project).read_text().splitlines()
    rows = [",".join([*line.split(",")[:-2], "", ""]) for line in lines[3:]]
    label_file(project).write_text("\n".join([*lines[:3], *rows]) + "\n")


PROJECTS: dict[str, tuple[Callable[[Project], object], str]] = {
    "no project": (
        lambda p: (p.root / "bendtrack.toml").unlink(),
        "expected a project folder with bendtrack.toml",
    ),
    "not TOML": (settings('definition = "', "definition = "), "expected TOML, got a mistake"),
    "unknown key": (settings("steps =", "step ="), "unknown key 'training.step' (did you mean 'steps'?)"),
    "wrong value": (
        settings("steps = 2", "steps = 0.5"),
        "training.steps: expected a valid integer, got 0.5",
    ),
    "no labels": (lambda p: shutil.rmtree(p.labels_dir), "expected labelled frames in"),
    "picture missing": (
        lambda p: (p.labels_dir / "arm" / "img00004.png").unlink(),
        "line 8: expected the image",
    ),
    "picture damaged": (
        lambda p: (p.labels_dir / "arm" / "img00004.png").write_bytes(b"no picture"),
        "expected an image at",
    ),
    "a word for a number": (
        lambda p: edit(label_file(p), "12.0,22.0", "left,22.0"),
        "column base_1 x: expected a number of px, got 'left'",
    ),
    "x without y": (
        lambda p: edit(label_file(p), "12.0,22.0", "12.0,"),
        "expected x and y, got x without y",
    ),
    "keypoint never labelled": (
        without_tip_2,
        "expected a labelled frame with all of base_1, base_2, tip_1, tip_2, got none",
    ),
    "other keypoints": (
        settings('"tip_1", "tip_2"', '"top_1", "top_2"'),
        "got none",
    ),
}


@pytest.mark.parametrize("case", PROJECTS)
def test_a_project_that_cannot_be_trained(bendtrack, project: Project, case: str) -> None:
    spoil, message = PROJECTS[case]
    spoil(project)
    ran = bendtrack("train", project.root)
    assert ran.status == 2
    assert ran.err.count("\n") == 1
    assert message in ran.err
    # No empty network is left behind.
    assert not project.models_dir.exists() or not list(project.models_dir.iterdir())


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("--backbone", "vgg16", "backbone: expected one of resnet18, resnet34, resnet50, got 'vgg16'"),
        ("--max-minutes", "0", "max_minutes: expected "),
        ("--held-out", "1", "held_out: expected a share"),
        (
            "--init",
            "nowhere.pth",
            "--init: expected auto, actuator, imagenet, random or a weights file, got nowhere.pth",
        ),
        ("--model", "../up", "--model: expected letters"),
    ],
)
def test_a_training_option_that_cannot_be(
    bendtrack, project: Project, option: str, value: str, message: str
) -> None:
    ran = bendtrack("train", project.root, option, value)
    assert ran.status == 2
    assert message in ran.err
    assert not project.models_dir.exists() or not list(project.models_dir.iterdir())


def test_weights_that_are_none(bendtrack, project: Project, tmp_path: Path) -> None:
    path = tmp_path / "weights.pth"
    path.write_bytes(b"PK\x03\x04 and then nothing of use")
    ran = bendtrack("train", project.root, "--init", path)
    assert ran.status == 2
    assert f"{path}: expected a weights file, got one that cannot be read" in ran.err


def test_imagenet_weights_without_a_network(bendtrack, project: Project, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    for name in ("http_proxy", "https_proxy", "HTTPS_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")  # where nobody answers
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    ran = bendtrack("train", project.root, "--init", "imagenet")
    path = imagenet_file("resnet18")
    assert ran.status == 2
    assert f"expected {path.name} in {path.parent}, and its download failed" in ran.err
    assert "put it there, or use --init random" in ran.err
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"half of it")
    assert "the file is damaged" in bendtrack("train", project.root, "--init", "imagenet").err


def test_a_source_of_labels_that_is_none(bendtrack, project: Project, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "table.csv").write_text("time,angle\n0,1\n")
    renamed = shutil.copytree(project.labels_dir, tmp_path / "renamed" / "labeled-data")
    csv = renamed / "arm" / "CollectedData_bendtrack.csv"
    csv.write_text(csv.read_text().replace("base_", "root_").replace("tip_", "top_"))
    for source, message in {
        "missing": "got no such file or folder",
        "empty": "expected",
        "table.csv": "expected a label file whose first rows begin with scorer, bodyparts, coords",
        "renamed": "expected labels of the project's keypoints base_1, base_2, tip_1, tip_2, got root_1",
    }.items():
        ran = bendtrack("import", project.root, tmp_path / source)
        assert ran.status == 2, source
        assert ran.err.splitlines()[-1].startswith("error: ")
        assert message in ran.err, source
        assert "Traceback" not in ran.err


def test_an_export_that_has_no_place_or_nothing_to_say(bendtrack, project: Project, tmp_path: Path) -> None:
    ran = bendtrack("export", project.root, project.root)
    assert ran.status == 2
    assert "expected a new or an empty folder to export to" in ran.err
    shutil.rmtree(project.labels_dir)
    ran = bendtrack("export", project.root, tmp_path / "out")
    assert ran.status == 2
    assert "expected labelled frames to export, got none" in ran.err


def test_a_network_that_is_missing_or_damaged(bendtrack, trained_project: Project, good: Path) -> None:
    weights = trained_project.models_dir / "model" / "weights.safetensors"
    whole = weights.read_bytes()
    weights.write_bytes(whole[: len(whole) // 2])
    ran = bendtrack("track", trained_project.root, good)
    assert (ran.status, ran.out) == (2, "")
    assert f"{weights}: expected a bendtrack checkpoint, got a damaged file" in ran.err
    weights.unlink()
    ran = bendtrack("track", trained_project.root, good)
    assert ran.status == 2
    assert "expected a trained network in" in ran.err
    assert "got none: " in ran.err
    assert "`bendtrack train " in ran.err


def test_a_network_for_other_keypoints(bendtrack, trained_project: Project) -> None:
    edit(trained_project.root / "bendtrack.toml", '"tip_1", "tip_2"', '"top_1", "top_2"')
    ran = bendtrack("evaluate", trained_project.root)
    assert ran.status == 2
    assert "expected a network that finds base_1, base_2, top_1, top_2, got one that finds" in ran.err


# --- disks -----------------------------------------------------------------------------------------------


def everything_under(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("command", ["new", "import", "export", "train", "track", "render", "demo"])
def test_a_folder_that_cannot_be_written(
    bendtrack, trained_project: Project, good: Path, tmp_path: Path, command: str
) -> None:
    shelf = tmp_path / "shelf"
    shelf.mkdir()
    args = {
        "new": [shelf / "p"],
        "import": [shelf / "p", trained_project.root],
        "export": [trained_project.root, shelf / "dlc"],
        "train": [trained_project.root],
        "track": [trained_project.root, good, "--out", shelf / "results"],
        "render": [shelf / "trial", "--cycles", 1, "--frequency-hz", 4],
        "demo": ["--out", shelf / "demo"],
    }[command]
    locked = trained_project.models_dir if command == "train" else shelf
    before = everything_under(tmp_path)
    locked.chmod(0o555)
    try:
        ran = bendtrack.installed(command, *args, obey_modes=True)
    finally:
        locked.chmod(0o755)
    assert ran.status == 2, ran.err
    assert ran.err.splitlines()[-1].startswith("error: ")
    assert "Permission denied" in ran.err
    assert "Traceback" not in ran.err
    assert everything_under(tmp_path) == before


@pytest.mark.parametrize("command", ["import", "export", "train", "track", "render"])
def test_a_disk_that_fills_up(
    bendtrack, trained_project: Project, good: Path, tmp_path: Path, command: str
) -> None:
    args, room = {
        "import": ([tmp_path / "p", trained_project.root], 300),
        "export": ([trained_project.root, tmp_path / "dlc"], 300),
        "train": ([trained_project.root], 3_000_000),
        "track": ([trained_project.root, good], 3000),
        "render": ([tmp_path / "trial", "--cycles", 1, "--frequency-hz", 4], 3000),
    }[command]
    before = everything_under(tmp_path)
    ran = bendtrack.installed(command, *args, file_size=room)
    assert ran.status == 2, ran.err
    assert ran.err.splitlines()[-1].startswith("error: ")
    assert "too large" in ran.err.lower()
    assert "Traceback" not in ran.err
    after = everything_under(tmp_path)
    assert {name: after[name] for name in before} == before
    assert not [name for name in after if ".tmp" in name]
    # What is new is whole: small files that had room, such as bendtrack.toml.
    assert all(len(after[name]) <= room for name in after.keys() - before.keys())
