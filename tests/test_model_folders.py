"""Which network is the newest: the one trained last by its own record, whatever files' times and clocks say."""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from bendtrack import model_folders
from bendtrack.models.inference.checksum import HEADER, with_checksum, with_place_for_checksum
from bendtrack.models.inference.metadata import later_than
from bendtrack.reporting import SilentReporter
from bendtrack.tracker.errors import BendtrackWarning, CheckpointError, TrainingError
from bendtrack.tracker.folder_lock import folder_lock
from bendtrack.tracker.project import Project

NOON = datetime(2026, 3, 1, 12, tzinfo=UTC)


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return Project.create(tmp_path / "study", keypoints=("base_1", "base_2", "tip_1", "tip_2"))


def put(project: Project, name: str, trained_at: datetime | str | None, file_time_s: float = 1e9) -> Path:
    """A network's folder, as far as choosing one goes."""
    training = {} if trained_at is None else {"trained_at": str(trained_at)}
    folder = project.models_dir / name
    folder.mkdir(parents=True)
    header = with_place_for_checksum({"format": 3, "training": training, "name": name})
    file = folder / "weights.safetensors"
    file.write_bytes(with_checksum(save({"a": np.zeros(3)}, metadata={HEADER: header})))
    os.utime(file, (file_time_s, file_time_s))
    return folder


def test_copies_and_unzipping_do_not_change_the_newest(project: Project) -> None:
    put(project, "first", NOON, file_time_s=2e9)
    put(project, "second", NOON + timedelta(hours=1), file_time_s=1e9)
    put(project, "old-version", None, file_time_s=3e9)
    assert [path.name for path in model_folders.finished(project)] == ["old-version", "first", "second"]
    assert model_folders.chosen(project, None).name == "second"


def test_times_in_other_zones_are_compared_as_moments(project: Project) -> None:
    put(project, "later", "2026-03-01T12:30:00+01:00")
    put(project, "latest", "2026-03-01T12:00:00+00:00")
    put(project, "earlier", "2026-03-01T20:00:00+09:00")
    assert [path.name for path in model_folders.finished(project)] == ["earlier", "later", "latest"]


def test_what_is_trained_after_the_clock_was_set_back_is_still_the_newest(project: Project) -> None:
    ahead = datetime.now(UTC) + timedelta(days=400)
    put(project, "first", ahead)
    second = later_than(model_folders.latest_training(project))
    assert ahead < datetime.fromisoformat(second) < ahead + timedelta(seconds=1)
    put(project, "again", second)
    with pytest.warns(BendtrackWarning, match=r"took 'again', .* later than this machine's clock says"):
        assert model_folders.chosen(project, None).name == "again"


def test_doubt_is_said(project: Project) -> None:
    put(project, "model", None, file_time_s=1e9)
    assert model_folders.chosen(project, None).name == "model"  # no doubt about a single one
    put(project, "other", None, file_time_s=2e9)
    with pytest.warns(
        BendtrackWarning, match=r"took 'other', the newest of 2 networks by the time of its file"
    ):
        assert model_folders.chosen(project, None).name == "other"
    new = put(project, "new", NOON)
    assert model_folders.chosen(project, None).name == "new"
    shutil.copytree(new, project.models_dir / "new copy")
    with pytest.warns(BendtrackWarning, match=r"took 'new copy', .* the same moment as new \(a copy\?\)"):
        assert model_folders.chosen(project, None).name == "new copy"
    assert model_folders.chosen(project, "other").name == "other"  # and nothing is said to those who name one


@pytest.mark.parametrize("damage", [b"", b"hello", b"\xff" * 64])
def test_a_network_that_cannot_be_read_may_be_the_newest(project: Project, damage: bytes) -> None:
    put(project, "good", NOON)
    bad = put(project, "bad", NOON - timedelta(days=1)) / "weights.safetensors"
    bad.write_bytes(damage)
    with pytest.raises(
        CheckpointError, match=r"bad/weights\.safetensors: .*--model names one that can be read"
    ):
        model_folders.chosen(project, None)
    assert model_folders.chosen(project, "good").name == "good"


def test_the_training_to_go_on_with_was_started_last(project: Project) -> None:
    for name, started, file_time_s in (
        ("a", NOON, 2e9),
        ("b", NOON + timedelta(minutes=1), 1e9),
        ("c", None, 3e9),
    ):
        settings = project.models_dir / name / model_folders.SETTINGS_FILE
        settings.parent.mkdir(parents=True)
        settings.write_text(json.dumps({} if started is None else {model_folders.STARTED: str(started)}))
        os.utime(settings, (file_time_s, file_time_s))
    assert model_folders.folder_to_resume(project, None).name == "b"
    assert datetime.fromisoformat(model_folders.start_of_training(project)) > NOON + timedelta(minutes=1)
    for damage in ("", "[]", '{"started_at": 7}', '{"started_at": "soon"}', '{"started_at": "2026-03-01"}'):
        settings.write_text(damage)
        assert [path.name for path in model_folders.unfinished(project)] == ["c", "a", "b"]


def test_new_names_are_taken_at_once(project: Project) -> None:
    first, second = (model_folders.new_folder(project, None, overwrite=False) for _ in range(2))
    assert (first.name, second.name) == ("model", "model-2")


def test_a_trained_network_records_when(trained_project: Project) -> None:
    (folder,) = model_folders.finished(trained_project)
    time = model_folders.latest_training(trained_project)
    assert abs(time.timestamp() - (folder / "weights.safetensors").stat().st_mtime) < 3600


def test_two_trainings_do_not_write_one_folder(bendtrack, trained_project: Project) -> None:
    folder = trained_project.models_dir / "model"
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    with folder_lock(folder, wait=False):
        assert model_folders.in_use(folder)
        ran = bendtrack("train", trained_project.root, "--name", "model", "--overwrite")
        assert ran.status == 2
        assert ran.err == (
            "error: expected a network that is not being trained, got 'model', which another process trains:"
            " wait for it, or train another with --name\n"
        )
    assert not model_folders.in_use(folder)
    assert {path.name: path.stat().st_mtime_ns for path in folder.iterdir()} == before


def test_a_training_that_cannot_begin_leaves_no_folder(bendtrack, project: Project) -> None:
    ran = bendtrack("train", project.root)
    assert (ran.status, ran.err.count("\n")) == (2, 1)
    assert not (project.models_dir / "model").exists()
    with pytest.raises(TrainingError, match="expected an unfinished training"):
        model_folders.folder_to_resume(project, None)


def test_doubt_is_reported(project: Project) -> None:
    said: list[str] = []

    class Listening(SilentReporter):
        def warn(self, text: str) -> None:
            said.append(text)

    for name in ("a", "b"):
        put(project, name, None)
    model_folders.chosen(project, None, Listening())
    assert len(said) == 1
