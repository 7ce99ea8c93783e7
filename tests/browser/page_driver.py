"""The labelling page as someone uses it: served by the installed command, in a browser, with mouse and keyboard."""

from __future__ import annotations

import csv
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, BrowserContext, Page

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
WINDOW = {"width": 1280, "height": 720}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def browser_path() -> str | None:
    """A browser of this machine that can be driven."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


class Server:
    """`bendtrack label` on a project, or another command that serves the page, in a process of its own."""

    def __init__(self, command: Path, root: Path, *words: str | Path) -> None:
        self._words, self.root = [command, *(words or ("label", root)), "--no-browser"], root
        self._process: subprocess.Popen[str] | None = None

    def start(self) -> str:
        """The address that it prints."""
        self._process = subprocess.Popen(
            self._words,
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

    def interrupt(self) -> None:
        """Ctrl-C in its terminal."""
        assert self._process is not None
        self._process.send_signal(signal.SIGINT)

    def ended(self) -> tuple[int, str]:
        """Wait for the command to end: its exit status, and what it printed since the address."""
        assert self._process is not None
        printed, _ = self._process.communicate()
        status, self._process = self._process.returncode, None
        return status, printed

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
        """Where a position of the image is in the window; (0, 0) is the centre of the top-left pixel."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        scale, left, top = self.view()
        return box["x"] + left + (xy[0] + 0.5) * scale, box["y"] + top + (xy[1] + 0.5) * scale

    def view(self) -> tuple[float, float, float]:
        """Scale, left and top of the image on the stage, once drawn."""
        self.page.bring_to_front()  # a tab behind another one draws once in a second or two
        self.page.evaluate(
            "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        data = self.page.locator("#stage").evaluate("stage => ({...stage.dataset})")
        return float(data["scale"]), float(data["left"]), float(data["top"])

    def image(self, at: tuple[float, float]) -> np.ndarray:
        """The position of the image under a place in the window."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        scale, left, top = self.view()
        return np.array([(at[0] - box["x"] - left) / scale - 0.5, (at[1] - box["y"] - top) / scale - 0.5])

    def click(self, xy: np.ndarray) -> np.ndarray:
        """Click the whole screen pixel nearest to a position; the position that was really clicked."""
        at = tuple(round(c) for c in self.screen(xy))
        self.page.mouse.click(*at)
        return self.image(at)

    def zoom_to(self, scale: float, xy: np.ndarray) -> None:
        """Turn the wheel over a position until the image is that large."""
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
        """Drag the image with the middle button until a position is in the middle of the stage."""
        box = self.page.locator("#stage").bounding_box()
        assert box is not None
        middle = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        at = self.screen(xy)
        self.page.mouse.move(*middle)
        self.page.mouse.down(button="middle")
        self.page.mouse.move(2 * middle[0] - at[0], 2 * middle[1] - at[1])
        self.page.mouse.up(button="middle")

    def open(self, image: str, video: str = "video") -> None:
        self.page.bring_to_front()
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

    def until(self, condition: Callable[[], bool], timeout_s: float = 20) -> None:
        """Let the browser go on until a condition holds here."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < deadline, "the condition has not come true"
            self.page.wait_for_timeout(10)

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


class PageSession:
    """A server on a project and a browser with nothing in it yet."""

    def __init__(self, server: Server, browser: Browser) -> None:
        self.server, self._browser = server, browser
        self._contexts: dict[float, BrowserContext] = {}
        self._address = server.start()
        self.problems: list[str] = []
        self.on_request: Callable[[str], object] = lambda url: None
        # What a killed server, a conflict, and a new server look like in the browser's log.
        self._expected = re.compile(
            "ERR_(FAILED|EMPTY_RESPONSE|INCOMPLETE_CHUNKED_ENCODING|CONNECTION_(REFUSED|RESET))|409|401"
        )

    def page(self, *, pixel_ratio: float = 1) -> Labeller:
        """A new tab on the project, in the browser with a screen of that kind."""
        if pixel_ratio not in self._contexts:
            # The address lets in one browser, once.
            let_in = next((other.storage_state() for other in self._contexts.values()), None)
            context = self._browser.new_context(
                viewport=WINDOW, device_scale_factor=pixel_ratio, storage_state=let_in
            )
            context.set_default_timeout(20_000)
            self._contexts[pixel_ratio] = context
        page = self._contexts[pixel_ratio].new_page()
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("console", lambda said: self._heard(said.type, said.text))
        page.on("request", lambda request: self._asked(request.url))
        page.goto(self._address)
        page.wait_for_selector("#stage[data-frame]")
        self._address = self._address.partition("?")[0]
        return Labeller(page, self.server.root)

    def expect(self, problems: str) -> None:
        """Take what matches a pattern in the browser's log for expected, too."""
        self._expected = re.compile(f"{self._expected.pattern}|{problems}")

    def start_again(self) -> None:
        """Start the server anew, and open the address that it prints in the browser, as `label` does itself."""
        address = self.server.start()
        for context in self._contexts.values():
            tab = context.new_page()
            tab.goto(address)
            tab.wait_for_selector("#stage[data-frame]")
            tab.close()

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
