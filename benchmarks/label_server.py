"""How long the labelling page waits: a click until it is saved, the next frame, a 4K image, the list of frames.

    python benchmarks/label_server.py                              30 frames of 640 x 480, 4 of 4K, 200 clicks
    python benchmarks/label_server.py --clicks 5 --large 1         a run to see that it runs

Times are of whole requests over a real socket, with every flush to disk in them; a bare file is flushed beside, as the
disk is most of it.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests" / "browser"))
from page_client import log_in

from bendtrack.labeling.store import image_name
from bendtrack.tracker.project import Project

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
BENDTRACK = Path(sys.executable).parent / "bendtrack"


def images(folder: Path, count: int, size_wh: tuple[int, int]) -> None:
    """Frames that compress about as those of a video do: a gradient with some noise."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    ramp = np.linspace(30, 200, size_wh[0])[None, :, None] * np.ones((size_wh[1], 1, 3))
    for index in range(count):
        noisy = (ramp + rng.normal(0, 3, ramp.shape)).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / image_name(index)), noisy)


class Page:
    """A page that has been let in by the address that the command prints."""

    def __init__(self, address: str) -> None:
        self.host = address.split("/")[2]
        self.connection = http.client.HTTPConnection(self.host, timeout=60)
        self.session = log_in(address)

    def __call__(self, method: str, path: str, body: object = None) -> bytes:
        headers = {
            **self.session.headers(method, path),
            "Origin": f"http://{self.host}",
            "X-Bendtrack": "1",
        }
        data = None if body is None else json.dumps(body)
        self.connection.request(method, path, data, {**headers, "Content-Type": "application/json"})
        answer = self.connection.getresponse()
        content = answer.read()
        if answer.status != 200:
            raise SystemExit(f"{method} {path}: expected 200, got {answer.status}")
        return content


def times_ms(work: Callable[[int], object], count: int) -> np.ndarray:
    """How long each of `count` calls took."""
    taken = []
    for index in range(count):
        begun = time.perf_counter()
        work(index)
        taken.append(1e3 * (time.perf_counter() - begun))
    return np.array(taken)


def told(what: str, taken: np.ndarray) -> None:
    """Print a row."""
    low, middle, high, most = np.quantile(taken, [0.05, 0.5, 0.95, 1])
    print(
        f"{what:42} {middle:8.1f} ms   5-95 %: {low:.1f} to {high:.1f}   longest {most:.1f}   n {len(taken)}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--clicks", type=int, default=200)
    parser.add_argument("--large", type=int, default=4, help="images of 3840 x 2160")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bendtrack-label-") as name:
        project = Project.create(Path(name) / "study", keypoints=KEYPOINTS)
        images(project.labels_dir / "small", 30, (640, 480))
        images(project.labels_dir / "large", args.large, (3840, 2160))
        server = subprocess.Popen(
            [BENDTRACK, "label", project.root, "--no-browser"], stdout=subprocess.PIPE, text=True
        )
        try:
            assert server.stdout is not None
            page = Page(server.stdout.readline().split()[-1])
            with closing(page.connection):
                measure(page, Path(name), args.clicks)
        finally:
            server.terminate()
            server.communicate()


def measure(page: Page, folder: Path, clicks: int) -> None:
    """All figures of one server."""
    frames = json.loads(page("GET", "/api/frames"))["frames"]
    small = [frame for frame in frames if frame["video"] == "small"]
    large = [frame for frame in frames if frame["video"] == "large"]
    revisions = {frame["id"]: frame["revision"] for frame in small}

    def click(index: int) -> None:
        frame = small[index // len(KEYPOINTS) % len(small)]
        body = {
            "edit_id": str(uuid.uuid4()),
            "client_id": "benchmark",
            "base_revision": revisions[frame["id"]],
            "points": {KEYPOINTS[index % len(KEYPOINTS)]: [index % 600 + 0.25, index % 400 + 0.5]},
        }
        revisions[frame["id"]] = json.loads(page("PUT", frame["url"], body))["revision"]

    def flush(index: int) -> None:
        with (folder / "bare").open("wb") as file:
            file.write(b"a" * 2000)
            file.flush()
            os.fsync(file.fileno())

    def opened(frame: dict[str, str]) -> None:
        page("GET", frame["url"])
        page("GET", frame["image_url"])

    told("a bare file written and flushed", times_ms(flush, clicks))
    told("a click, saved", times_ms(click, clicks))
    told("a frame of 640 x 480, points and image", times_ms(lambda i: opened(small[i]), len(small)))
    told("a frame of 3840 x 2160, points and image", times_ms(lambda i: opened(large[i]), len(large)))
    told("its thumbnail, first time", times_ms(lambda i: page("GET", large[i]["thumb_url"]), len(large)))
    told("the list of frames", times_ms(lambda i: page("GET", "/api/frames"), min(clicks, 20)))
    size = os.path.getsize(folder / "study" / "labeled-data" / "large" / large[0]["image"]) / 1e6
    print(f"the 4K image has {size:.1f} MB as PNG")


if __name__ == "__main__":
    main()
