"""The labelling page as users have it: served by the installed command, in a browser, with mouse and keyboard."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from page_driver import BROWSERS, KEYPOINTS, Labeller, PageSession, Server, browser_path
from playwright.sync_api import Browser, sync_playwright

from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.project import Project
from bendtrack.tracker.video import Video

SAMPLE = Path(__file__).parents[2] / "data_samples"
FRAMES = (86, 98, 111, 136, 149, 178, 260, 300, 358, 400)


@pytest.fixture(scope="session")
def browser_file() -> str:
    found = browser_path()
    if found is None:
        reason = f"the page is not tested: expected a browser, one of {', '.join(BROWSERS)}, got none"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    return found


@pytest.fixture(scope="session")
def chromium(browser_file: str) -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=browser_file, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def sample_truth() -> dict[str, np.ndarray]:
    """Exact positions (4, 2) px in some frames of the sample trial, by image name."""
    with (SAMPLE / "truth.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {
        image_name(frame): np.array([[float(rows[frame][f"{k}_{axis}"]) for axis in "xy"] for k in KEYPOINTS])
        for frame in FRAMES
    }


@pytest.fixture(scope="session")
def sample_images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with those frames, nothing labelled."""
    root = tmp_path_factory.mktemp("sample") / "study"
    store = LabelStore.of(Project.create(root, keypoints=KEYPOINTS))
    for frame in Video(SAMPLE / "video.mp4"):
        if frame.index in FRAMES and frame.image is not None:
            store.add_image("video", image_name(frame.index), frame.image)
        if frame.index == FRAMES[-1]:
            break
    return root


@pytest.fixture
def sample_project(sample_images: Path, tmp_path: Path) -> Project:
    """A copy of it for one test."""
    return Project.open(shutil.copytree(sample_images, tmp_path / "study"))


@pytest.fixture(scope="module")
def make_session(chromium: Browser, bendtrack) -> Iterator[Callable[[Path], PageSession]]:
    """Serves a project; afterwards nothing may have been complained of, or asked of another server."""
    sessions: list[PageSession] = []

    def make(root: Path) -> PageSession:
        sessions.append(PageSession(Server(bendtrack.command, root), chromium))
        return sessions[-1]

    yield make
    for session in sessions:
        session.close()
    assert [problem for session in sessions for problem in session.problems] == []


@pytest.fixture(scope="module")
def session(
    make_session: Callable[[Path], PageSession], sample_images: Path, tmp_path_factory: pytest.TempPathFactory
) -> PageSession:
    """One server for the tests of a file; each labels frames of its own."""
    return make_session(shutil.copytree(sample_images, tmp_path_factory.mktemp("session") / "study"))


@pytest.fixture
def labeller(session: PageSession) -> Iterator[Labeller]:
    labeller = session.page()
    yield labeller
    labeller.page.close()


@pytest.fixture
def discs_project(tmp_path: Path) -> tuple[Project, np.ndarray]:
    """Two images of four white discs, and where their centres are (4, 2) px."""
    xy = np.array([[100.25, 80.5], [300.75, 90.125], [420.5, 300.0], [37.0, 401.875]])
    image = np.zeros((480, 640, 3), np.uint8)
    for centre in xy:
        # Drawn by the area of each pixel that a disc covers, on a grid eight times as fine.
        fine = np.zeros((480 * 8, 640 * 8), np.uint8)
        cv2.circle(fine, tuple(int(c) for c in (centre + 0.5) * 8), 5 * 8, 255, -1)
        image = np.maximum(image, fine.reshape(480, 8, 640, 8).mean(axis=(1, 3)).astype(np.uint8)[..., None])
    project = Project.create(tmp_path / "discs", keypoints=KEYPOINTS)
    for frame in range(2):
        LabelStore.of(project).add_image("video", image_name(frame), image)
    return project, xy
