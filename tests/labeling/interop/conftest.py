"""What the tests of all foreign forms share: a project that has everything that can get lost on the way."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from bendtrack.labeling.interop.formats import open_labels
from bendtrack.labeling.interop.importing import ImportReport, import_source, project_of
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.project import Project

WH = (96, 72)


def _save(path: Path, seed: int, size_wh: tuple[int, int] = WH) -> Path:
    image = np.random.default_rng(seed).integers(0, 255, (size_wh[1], size_wh[0], 3), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())
    return path


@pytest.fixture(scope="session")
def save_image() -> Callable[..., Path]:
    """(path, seed, size) -> the path, with noise of 96 x 72 px in it; no two seeds are alike."""
    return _save


@pytest.fixture
def rich(tmp_path: Path) -> Project:
    """Two actuators, three videos (one name is not ASCII and has a dot), missing points, unlabelled images."""
    project = Project.create(tmp_path / "study", keypoints=("Basis_ä", "base 2", "tip_1", "先端"))
    store = LabelStore.of(project)
    for number, video in enumerate(("arm", "arm again", "größe 1.5Hz")):
        labels = {}
        for frame in (3, 14, 15):
            seed = 100 * number + frame
            _save(project.labels_dir / video / image_name(frame), seed)
            # All the digits that a float64 has.
            labels[image_name(frame)] = np.random.default_rng(seed).random((4, 2)) * [WH[0] - 1, WH[1] - 1]
        labels[image_name(14)][2] = np.nan
        labels[image_name(15)][[0, 1, 3]] = np.nan
        labels[image_name(3)][0] = [-0.5, WH[1] - 0.5]  # as far out as a point can be
        _save(project.labels_dir / video / image_name(926), 900 + number)
        store.write(video, labels)
    project.assign_actuator("original", ["arm", "arm again"])
    project.assign_actuator("Größer", ["größe 1.5Hz"])
    return project


Taken = tuple[Project, ImportReport]


@pytest.fixture
def take(tmp_path: Path) -> Callable[..., Taken]:
    """Import a source into a project of its own, made for it: (source, form, images, videos) -> project, report."""

    def taken(
        source: Path, form: str | None = None, images: Path | None = None, videos: tuple[Path, ...] = ()
    ) -> Taken:
        found = open_labels(source, form, images)
        project = project_of(tmp_path / f"of {source.name}", found)
        return project, import_source(found, project, videos=videos)

    return taken


@pytest.fixture(scope="session")
def contents() -> Callable[[Project], list[tuple[str, str, bytes, bytes]]]:
    """Project -> video, image, points and pixels of every labelled frame, to the last bit, as they lie on disk."""

    def read(project: Project) -> list[tuple[str, str, bytes, bytes]]:
        frames = LabelStore.of(Project.open(project.root)).read()
        return [
            (f.video, f.image_path.name, f.xy.tobytes(), cv2.imread(str(f.image_path)).tobytes())
            for f in frames
        ]

    return read


@pytest.fixture(scope="session")
def actuators() -> Callable[[Project], dict[str, str]]:
    """Project -> which actuator each video shows, as it stands on disk."""

    def read(project: Project) -> dict[str, str]:
        opened = Project.open(project.root)
        return {video: opened.actuator_of(video) for video in LabelStore.of(opened).videos()}

    return read
