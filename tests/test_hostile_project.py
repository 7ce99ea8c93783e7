"""A project of somebody else's, with links in the place of what bendtrack writes: no file outside of it changes."""

from __future__ import annotations

import ast
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bendtrack.labeling.annotations import Annotations
from bendtrack.labeling.edits import Change, Editor
from bendtrack.labeling.predictions import Network, Predictions
from bendtrack.labeling.private_folder import PrivateFolder
from bendtrack.labeling.store import LabelStore
from bendtrack.tracker.errors import LabelError
from bendtrack.tracker.links import LinkError
from bendtrack.tracker.project import Project

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs symbolic links")

ROOT = Path(__file__).parents[1]
SHELL = "# a shell's start file\n"
KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with two images, nothing labelled."""
    root = tmp_path_factory.mktemp("template") / "study"
    store = LabelStore.of(Project.create(root, keypoints=KEYPOINTS))
    for index in range(2):
        store.add_image("film", f"img{index:05d}.png", np.zeros((48, 64, 3), np.uint8))
    return root


@pytest.fixture
def project(template: Path, tmp_path: Path) -> Project:
    return Project.open(shutil.copytree(template, tmp_path / "study"))


@pytest.fixture
def home(tmp_path: Path) -> Path:
    """A folder of the user's, and afterwards the same."""
    folder = tmp_path / "home"
    (folder / "sub").mkdir(parents=True)
    (folder / "rc").write_text(SHELL)
    yield folder
    assert sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*")) == ["rc", "sub"]
    assert (folder / "rc").read_text() == SHELL
    assert (folder / "rc").stat().st_nlink == 1


def label(project: Project) -> None:
    """What the labelling page does with an edit of labels and notes."""
    private = PrivateFolder(project.root)
    annotations = Annotations(project, private.lock, private.check_reachable)
    private.remember_port(8765)
    change = Change({"tip_1": (1.0, 2.0)}, note="n")
    folder = annotations.folder("film")
    assert folder is not None
    Editor(annotations, private).edit(
        "film",
        "img00000.png",
        change,
        base_revision=folder.states["img00000.png"].revision,
        edit_id="e",
        client_id="c",
    )


def predict(project: Project) -> None:
    """What a network's suggestions leave behind."""
    from bendtrack.tracker.types import Detections

    class Oracle:
        keypoints = KEYPOINTS

        def detect(self, images: np.ndarray) -> Detections:
            n, k = len(images), len(KEYPOINTS)
            return Detections(
                xy=np.ones((n, k, 2)),
                covariance=np.tile(np.eye(2), (n, k, 1, 1)),
                likelihood=np.ones((n, k)),
            )

    private = PrivateFolder(project.root)
    annotations = Annotations(project)
    images = list(annotations.folders()[0].images.values())
    predictions = Predictions(Network("n", "key", Oracle), private.path, lambda: images, lambda frame: None)
    predictions.start()
    predictions._thread.join(0.2)
    predictions.stop()
    predictions._thread.join(10)
    if predictions.state == "failed":
        raise RuntimeError(predictions.reason)


def results(project: Project) -> None:
    from bendtrack.tracker.angle import AngleDefinition
    from bendtrack.tracker.results import AngleTable, write_results

    n = 3
    table = AngleTable(
        time_s=np.arange(n) / 30,
        angle_deg=np.zeros(n),
        angle_sd_deg=np.ones(n),
        flag=np.full(n, "", dtype=object),
        keypoints=KEYPOINTS,
        xy=np.zeros((n, 4, 2)),
        likelihood=np.ones((n, 4)),
        covariance=np.tile(np.eye(2), (n, 4, 1, 1)),
        definition=AngleDefinition("two-vector", KEYPOINTS),
        provenance={},
    )
    write_results(table, project.results_dir, "film")


def overlay(project: Project) -> None:
    from bendtrack.tracker.links import make_folder
    from bendtrack.tracker.video_writer import VideoWriter

    make_folder(project.results_dir)
    with VideoWriter(project.results_dir / "film.overlay.mp4", (64, 48), 30.0) as writer:
        writer.write(np.zeros((48, 64, 3), np.uint8))


def network(project: Project) -> None:
    """Files of a training: weights and state, training.csv, evaluation and figures use the same two writers."""
    import torch

    from bendtrack.models.networks.tensor_files import write_tensors
    from bendtrack.models.training.state import write_rows
    from bendtrack.tracker.links import make_folder

    folder = project.models_dir / "model"
    make_folder(folder)
    write_tensors(folder / "weights.safetensors", {"a": torch.zeros(2)}, {})
    write_rows(folder, [{"step": 1.0}])


def export(project: Project) -> None:
    from bendtrack.labeling.interop.exporting import new_folder

    with new_folder(project.root / "exported") as staging:
        (staging / "a.txt").write_text("x")


# What is written, by whom: every name that a command gives to a file of a project.
WRITTEN: dict[str, Callable[[Project], None]] = {
    "bendtrack.toml": lambda project: project.assign_actuator("arm", ["film"]),
    "labeled-data": lambda project: LabelStore.of(project).add_image("film", "img00002.png", image()),
    "labeled-data/new": lambda project: LabelStore.of(project).add_image("new", "img00002.png", image()),
    "labeled-data/film/img00002.png": lambda project: LabelStore.of(project).add_image(
        "film", "img00002.png", image()
    ),
    "labeled-data/film/CollectedData_bendtrack.csv": lambda project: LabelStore.of(project).write(
        "film", {"img00000.png": np.ones((4, 2))}
    ),
    "labeled-data/film/bendtrack-notes.json": label,
    ".bendtrack": label,
    ".bendtrack/journal.jsonl": label,
    ".bendtrack/lock": label,
    ".bendtrack/ports.json": label,
    ".bendtrack/project-id": label,
    ".bendtrack/predictions-key.jsonl": predict,
    "results": results,
    "results/film.csv": results,
    "results/film.h5": results,
    "results/film.json": results,
    "results/film.overlay.mp4": overlay,
    "models": network,
    "models/model": network,
    "models/model/weights.safetensors": network,
    "models/model/training.csv": network,
    "exported": export,
}


def image() -> np.ndarray:
    return np.zeros((48, 64, 3), np.uint8)


@pytest.mark.parametrize("kind", ["link", "dangling"])
@pytest.mark.parametrize("name", WRITTEN)
def test_nothing_is_written_through_a_link(project, home, name, kind) -> None:
    place = project.root / name
    if name == "labeled-data" or place.is_file():
        place.rename(home.parent / "moved")
    place.parent.mkdir(parents=True, exist_ok=True)
    is_folder = place.name in ("labeled-data", "new", ".bendtrack", "results", "models", "model", "exported")
    target = home / ("nowhere" if kind == "dangling" else "sub" if is_folder else "rc")
    if name == "bendtrack.toml" and kind == "link":
        (home / "rc").write_text((home.parent / "moved").read_text())
    place.symlink_to(target)
    # What is read first may be refused for its contents.
    reason = {"bendtrack.toml": "link|No such file", "CollectedData_bendtrack.csv": "link|label file"}
    with pytest.raises(Exception, match=reason.get(place.name, "link")) as caught:
        WRITTEN[name](project)
    assert "\n" not in str(caught.value)
    if name == "bendtrack.toml" and kind == "link":
        assert (home / "rc").read_text() == (home.parent / "moved").read_text()
        (home / "rc").write_text(SHELL)


@pytest.mark.parametrize(
    "name", [".bendtrack/journal.jsonl", ".bendtrack/predictions-key.jsonl", ".bendtrack/lock"]
)
def test_nothing_is_appended_to_a_hard_link(project, home, name) -> None:
    (project.root / ".bendtrack").mkdir()
    os.link(home / "rc", project.root / name)
    with pytest.raises((LinkError, RuntimeError), match="hard link"):
        WRITTEN[name](project)
    (project.root / name).unlink()


def test_a_link_that_is_not_needed_stays_as_it_is(project, home) -> None:
    (project.root / ".bendtrack").mkdir()
    (project.root / ".bendtrack" / ".gitignore").symlink_to(home / "nowhere")
    label(project)


@pytest.mark.parametrize("name", ["journal.jsonl", "lock", "project-id", "ports.json"])
def test_a_named_pipe_is_not_waited_for(project, name) -> None:
    (project.root / ".bendtrack").mkdir()
    os.mkfifo(project.root / ".bendtrack" / name)
    if name == "ports.json":  # not needed: replaced
        label(project)
    else:
        with pytest.raises((OSError, LabelError), match="plain file"):
            label(project)


def test_a_link_to_the_whole_project_is_followed(project, tmp_path) -> None:
    (tmp_path / "short").symlink_to(project.root)
    linked = Project.open(tmp_path / "short")
    for write in dict.fromkeys(WRITTEN.values()):
        write(linked)
    assert (project.root / "models" / "model" / "training.csv").is_file()
    assert (project.root / "labeled-data" / "film" / "CollectedData_bendtrack.csv").is_file()


def test_the_commands_say_it_in_one_line(project, home, bendtrack) -> None:
    (project.root / "results").symlink_to(home / "sub")
    (project.root / ".bendtrack").mkdir()
    (project.root / ".bendtrack" / "journal.jsonl").symlink_to(home / "rc")
    video = ROOT / "data_samples" / "video.mp4"
    for arguments, target in (
        (("angle", video, "--out", project.root / "results"), home / "sub"),
        (("label", project.root, "--no-browser"), home / "rc"),
    ):
        ran = bendtrack(*arguments)
        assert ran.status == 2, ran
        assert len(ran.err.splitlines()) == 1, ran.err
        assert f"got a link to {target}" in ran.err


# Calls that write without the rule of tracker/links.py, and why each may.
OTHER_WRITERS = {
    ("tracker/atomic.py", "os.open"): "the rule's user: a new file, or a lock",
    ("tracker/atomic.py", "os.replace"): "the rule's user",
    ("tracker/atomic.py", "write_text"): "into a temporary file of its own",
    ("tracker/atomic.py", "write_bytes"): "into a temporary file of its own",
    ("tracker/links.py", "os.open"): "the rule",
    ("tracker/links.py", "mkdir"): "the rule",
    ("tracker/video_writer.py", "touch"): "a temporary file of atomic_path",
    ("tracker/batch.py", "write_bytes"): "a new name at random, behind make_folder",
    ("tracker/video_writer.py", "open"): "a temporary file of atomic_path",
    ("tracker/cli/live_command.py", "os.open"): "the null device",
    ("labeling/journal.py", "os.open"): "a folder, to flush it",
    ("labeling/private_folder.py", "mkdir"): "refuses a link first",
    ("labeling/private_folder.py", "chmod"): "refuses a link first",
    ("labeling/interop/exporting.py", "mkdir"): "a new folder at random, behind refuse_links",
    ("labeling/interop/exporting.py", "os.replace"): "behind refuse_links",
    ("labeling/interop/exporting.py", "shutil.copyfile"): "into the new folder",
    ("labeling/interop/dlc_export.py", "mkdir"): "into the new folder",
    ("labeling/interop/dlc_export.py", "write_text"): "into the new folder",
    ("labeling/interop/lightning_pose.py", "mkdir"): "into the new folder",
    ("labeling/interop/lightning_pose.py", "write_text"): "into the new folder",
    ("labeling/interop/coco.py", "mkdir"): "into the new folder",
    ("labeling/interop/coco.py", "write_text"): "into the new folder",
    ("tracker/synthetic/study.py", "mkdir"): "a folder that the user names, in no project",
    ("tracker/synthetic/trial.py", "mkdir"): "a folder that the user names, in no project",
    ("models/networks/shipped.py", "mkdir"): "the user's cache",
    ("models/networks/shipped.py", "shutil.copyfile"): "into a temporary file of atomic_path",
    ("models/pretraining/pretrainer.py", "mkdir"): "a folder that the user names, in no project",
}
WRITERS = {
    "write_text", "write_bytes", "mkdir", "makedirs", "touch", "chmod", "symlink_to", "os.open", "os.replace",
    "os.rename", "shutil.copyfile", "shutil.copy", "shutil.copytree", "shutil.move", "imwrite",
}  # fmt: skip


def test_every_writer_keeps_to_the_rule() -> None:
    """A new call that writes goes through tracker/atomic.py or tracker/links.py, or is listed above with its reason."""
    found = set()
    for room in ("bendtrack", "tracker", "labeling", "models"):
        for file in sorted((ROOT / room).rglob("*.py")):
            for call in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
                    whole = ast.unparse(call.func)
                    name = whole if whole in WRITERS else call.func.attr
                    opens = name == "open" and any(
                        isinstance(a, ast.Constant)
                        and a.value in ("w", "a", "x", "wb", "ab", "xb", "r+b", "w+b")
                        for a in call.args
                    )
                    if name in WRITERS or opens:
                        found.add((file.relative_to(ROOT).as_posix(), name))
    assert found - OTHER_WRITERS.keys() == set()
