"""The labelling page as users have it: served by the installed command, in a browser, with mouse and keyboard."""

from __future__ import annotations

import csv
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.project import Project
from bendtrack.tracker.video import Video

SAMPLE = Path(__file__).parents[2] / "data_samples"
KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
FRAMES = (86, 98, 111, 136, 149, 178, 260, 300, 358, 400)
WINDOW = {"width": 1280, "height": 720}


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    names = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
    found = next((path for name in names if (path := shutil.which(name))), None)
    if found is None:
        reason = f"the page is not tested: expected a browser, one of {', '.join(names)}, got none"
        if os.environ.get("CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
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
def sample_pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
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
def sample_project(sample_pictures: Path, tmp_path: Path) -> Project:
    """A copy of it for one test."""
    return Project.open(shutil.copytree(sample_pictures, tmp_path / "study"))


class Server:
    """`bendtrack label` on a project, in a process of its own."""

    def __init__(self, command: Path, root: Path) -> None:
        self._command, self.root = command, root
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> str:
        """The address that it prints."""
        self._process = subprocess.Popen(
            [self._command, "label", self.root, "--no-browser"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        assert self._process.stdout is not None
        said = ""
        while line := self._process.stdout.readline():
            said += line
            if found := re.search(r"http://\S+", line):
                return found[0]
        raise AssertionError(f"expected an address, got: {said}")

    def kill(self) -> None:
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()
            assert self._process.stdout is not None
            self._process.stdout.close()
            self._process = None


class Labeller:
    """Someone at the page, who sees where things are on the screen."""

    def __init__(self, page: Page, root: Path) -> None:
        self.page, self._root = page, root

    def screen(self, xy: np.ndarray) -> tuple[float, float]:
        """Where a position of the picture is in the window; (0, 0) is the centre of the top-left pixel."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        scale, left, top = self.view()
        return box["x"] + left + (xy[0] + 0.5) * scale, box["y"] + top + (xy[1] + 0.5) * scale

    def view(self) -> tuple[float, float, float]:
        """Scale, left and top of the picture on the stage, once drawn."""
        self.page.evaluate(
            "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        data = self.page.locator("#stage").evaluate("stage => ({...stage.dataset})")
        return float(data["scale"]), float(data["left"]), float(data["top"])

    def picture(self, at: tuple[float, float]) -> np.ndarray:
        """The position of the picture under a place in the window."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        scale, left, top = self.view()
        return np.array([(at[0] - box["x"] - left) / scale - 0.5, (at[1] - box["y"] - top) / scale - 0.5])

    def click(self, xy: np.ndarray) -> np.ndarray:
        """Click the whole screen pixel nearest to a position; the position that was really clicked."""
        at = tuple(round(c) for c in self.screen(xy))
        self.page.mouse.click(*at)
        return self.picture(at)

    def zoom_to(self, scale: float, xy: np.ndarray) -> None:
        """Turn the wheel over a position until the picture is that large."""
        for _ in range(30):
            now = self.view()[0]
            if abs(now / scale - 1) < 1e-3:
                return
            # The page zooms by exp(-0.0016 px of the wheel); at most 300 px a turn.
            turn = float(np.clip(np.log(now / scale) / 0.0016, -300, 300))
            self.page.mouse.move(*self.screen(xy))
            self.page.mouse.wheel(0, turn)
        raise AssertionError(f"expected scale {scale}, got {self.view()[0]}")

    def pan_to_middle(self, xy: np.ndarray) -> None:
        """Drag the picture with the middle button until a position is in the middle of the stage."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        at = self.screen(xy)
        self.page.mouse.move(*middle)
        self.page.mouse.down(button="middle")
        self.page.mouse.move(2 * middle[0] - at[0], 2 * middle[1] - at[1])
        self.page.mouse.up(button="middle")

    def open(self, image: str, video: str = "video") -> None:
        self.page.locator(f'[data-id="{video}/{image}"]').click()
        self.opened(image, video)

    def state(self, image: str) -> str | None:
        """As the film strip shows it."""
        return self.page.locator(f'[data-id="video/{image}"]').get_attribute("data-state")

    def opened(self, image: str, video: str = "video") -> None:
        self.page.wait_for_selector(f'#stage[data-frame="{video}/{image}"]')

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def saved(self) -> None:
        self.page.wait_for_selector('#saving[data-state="saved"]', timeout=20_000)

    def angle_deg(self) -> float | None:
        words = self.page.locator("#angle").inner_text().rstrip("°").replace("\N{MINUS SIGN}", "-")
        return None if words == "–" else float(words)

    def on_disk(self, image: str, video: str = "video") -> dict[str, tuple[float, float] | None]:
        """Points of an image in the label file, read by hand."""
        path = self._root / "labeled-data" / video / "CollectedData_bendtrack.csv"
        rows = list(csv.reader(path.read_text().splitlines())) if path.exists() else []
        for row in rows[3:]:
            if row[2] == image:
                columns = zip(rows[1][3::2], row[3::2], row[4::2], strict=True)
                return {name: (float(x), float(y)) if x and y else None for name, x, y in columns}
        return {}

    def xy_on_disk(self, image: str, video: str = "video") -> np.ndarray:
        """(K, 2) px, NaN where a point is missing."""
        points = self.on_disk(image, video)
        return np.array([points.get(name) or (np.nan, np.nan) for name in KEYPOINTS])


class Desk:
    """A server on a project and a browser with nothing in it yet."""

    def __init__(self, server: Server, browser: Browser) -> None:
        self.server, self._browser = server, browser
        self._contexts: dict[float, BrowserContext] = {}
        self._address = server.start()
        self.problems: list[str] = []
        self.on_request: Callable[[str], object] = lambda url: None
        # What a killed server and a conflict look like in the browser's log.
        self._expected = re.compile(
            "ERR_(FAILED|EMPTY_RESPONSE|INCOMPLETE_CHUNKED_ENCODING|CONNECTION_(REFUSED|RESET))|409"
        )

    def page(self, *, pixel_ratio: float = 1) -> Labeller:
        """A new tab on the project, in the browser with a screen of that kind."""
        if pixel_ratio not in self._contexts:
            context = self._browser.new_context(viewport=WINDOW, device_scale_factor=pixel_ratio)
            context.set_default_timeout(20_000)
            # The address lets in one browser, once.
            context.add_cookies([cookie for other in self._contexts.values() for cookie in other.cookies()])
            self._contexts[pixel_ratio] = context
        page = self._contexts[pixel_ratio].new_page()
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("console", lambda said: self._heard(said.type, said.text))
        page.on("request", lambda request: self._asked(request.url))
        page.goto(self._address)
        page.wait_for_selector("#stage[data-frame]")
        self._address = self._address.partition("?")[0]
        return Labeller(page, self.server.root)

    def _heard(self, kind: str, text: str) -> None:
        if kind in ("error", "warning") and not self._expected.search(text):
            self.problems.append(text)

    def _asked(self, url: str) -> None:
        self.on_request(url)
        if not url.startswith((self._address.partition("?")[0], "blob:", "data:")):
            self.problems.append(f"asked for {url}")

    def close(self) -> None:
        for context in self._contexts.values():
            context.close()
        self.server.kill()


@pytest.fixture(scope="module")
def make_desk(chromium: Browser, bendtrack) -> Iterator[Callable[[Path], Desk]]:
    """Serves a project; afterwards nothing may have been complained of, or asked of another server."""
    desks: list[Desk] = []

    def make(root: Path) -> Desk:
        desks.append(Desk(Server(bendtrack.command, root), chromium))
        return desks[-1]

    yield make
    for desk in desks:
        desk.close()
    assert [problem for desk in desks for problem in desk.problems] == []


@pytest.fixture(scope="module")
def desk(
    make_desk: Callable[[Path], Desk], sample_pictures: Path, tmp_path_factory: pytest.TempPathFactory
) -> Desk:
    """One server for the tests of a file; each labels frames of its own."""
    return make_desk(shutil.copytree(sample_pictures, tmp_path_factory.mktemp("desk") / "study"))


@pytest.fixture
def labeller(desk: Desk) -> Iterator[Labeller]:
    labeller = desk.page()
    yield labeller
    labeller.page.close()


@pytest.fixture
def discs_project(tmp_path: Path) -> tuple[Project, np.ndarray]:
    """Two pictures of four white discs, and where their centres are (4, 2) px."""
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
