"""The network's suggestions: computed behind the page's back, wanted frames first, kept for the next time."""

from __future__ import annotations

import http.client
import json
import subprocess
import threading
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from page_client import log_in

from bendtrack.labeling.annotations import Annotations
from bendtrack.labeling.frame_state import FrameState
from bendtrack.labeling.predictions import Network, Predictions
from bendtrack.models.detector import NetworkDetector
from bendtrack.tracker.types import Detections

KEYPOINTS = ("base_1", "tip_1")


class Oracle:
    """Puts every point where the image's brightness says."""

    keypoints = KEYPOINTS
    batch_size = 4
    provenance = {"made": "by hand"}  # noqa: RUF012

    def __init__(self) -> None:
        self.seen: list[float] = []

    def detect(self, frames: np.ndarray) -> Detections:
        assert frames.shape == (1, 72, 96, 3)
        level = float(frames.mean())
        self.seen.append(level)
        xy = np.array([[[level, 10.0], [level, 20.0]]])
        covariance = np.broadcast_to(np.diag([0.09, 0.25]), (1, 2, 2, 2))
        return Detections(xy, np.array([[0.9, 0.4]]), covariance)


def until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def worker(study, load, told=None, key: str = "abc") -> Predictions:
    annotations = Annotations(study.project)
    folder = study.root / ".bendtrack"
    folder.mkdir(exist_ok=True)
    return Predictions(
        Network("model", key, load),
        folder,
        lambda: [p for f in annotations.folders() for p in f.images.values()],
        (told if told is not None else []).append,
    )


def images(study):
    return list(Annotations(study.project).folder(study.video).images.values())


def test_every_frame_is_looked_at_once_and_told(study) -> None:
    oracle, told = Oracle(), []
    predictions = worker(study, lambda: oracle, told)
    predictions.start()
    until(lambda: predictions.state == "ready")
    predictions.stop()
    assert oracle.seen == [20 + 5 * n for n in range(12)]
    assert [frame for frame in told if frame is not None] == [
        (study.video, study.image(n)) for n in range(12)
    ]
    assert (predictions.done, predictions.total) == (12, 12)
    found = predictions.get(images(study)[3])
    assert found is not None
    assert found.points == {"base_1": (35, 10), "tip_1": (35, 20)}
    assert found.sd_px["tip_1"] == pytest.approx(np.sqrt((0.09 + 0.25) / 2), abs=1e-4)
    assert found.likelihood == {"base_1": 0.9, "tip_1": 0.4}
    assert found.farthest(FrameState({"base_1": (35, 10), "tip_1": (38, 24)})) == ("tip_1", 5.0)
    assert found.farthest(FrameState()) is None


def test_what_the_page_shows_comes_first(study) -> None:
    oracle, go = Oracle(), threading.Event()

    def load() -> Oracle:
        go.wait(60)
        return oracle

    predictions = worker(study, load)
    predictions.start()
    predictions.prioritise(images(study)[8:10])
    go.set()
    until(lambda: len(oracle.seen) >= 4)
    predictions.stop()
    # One may have been chosen before the page asked.
    assert [60.0, 65.0] in (oracle.seen[:2], oracle.seen[1:3])


def test_the_next_time_nothing_is_computed_or_loaded(study) -> None:
    first = worker(study, Oracle)
    first.start()
    until(lambda: first.state == "ready")
    first.stop()
    path = study.root / ".bendtrack" / "predictions-abc.jsonl"
    path.write_text(path.read_text() + '{"picture": "cut sh')

    def never() -> Oracle:
        raise AssertionError("loaded")

    again = worker(study, never)
    again.start()
    until(lambda: again.state == "ready")
    again.stop()
    assert again.get(images(study)[3]) == first.get(images(study)[3])
    # Another network knows nothing of that.
    other = worker(study, Oracle, key="def")
    assert other.get(images(study)[3]) is None


def test_an_image_that_cannot_be_read_is_skipped(study) -> None:
    (study.folder / study.image(2)).write_bytes(b"no image")
    predictions = worker(study, Oracle)
    predictions.start()
    until(lambda: predictions.state == "ready")
    predictions.stop()
    assert [predictions.get(p) is None for p in images(study)] == [n == 2 for n in range(12)]


def test_a_network_that_fails_is_said(study) -> None:
    def load() -> Oracle:
        raise RuntimeError("expected weights,\ngot none")

    predictions = worker(study, load)
    predictions.start()
    until(lambda: predictions.state == "failed")
    assert predictions.reason == "expected weights, got none"


def test_the_command_shows_a_trained_networks_suggestions(trained_project, bendtrack) -> None:
    # The labelled positions are 'arm's; a network of two steps is far from them, which is said as well.
    process = subprocess.Popen(
        [bendtrack.command, "label", trained_project.root, "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        connection = http.client.HTTPConnection(address.split("/")[2], timeout=60)
        session = log_in(address)

        def get(path: str) -> http.client.HTTPResponse:
            connection.request("GET", path, headers=session.headers("GET", path))
            return connection.getresponse()

        def listed() -> dict[str, object]:
            return json.loads(get("/api/frames").read())

        until(lambda: listed()["model"]["state"] == "ready")
        assert listed()["model"] == {"name": "model", "state": "ready", "reason": "", "done": 10, "total": 10}
        found = json.loads(get("/api/frames/arm/img00000.png").read())
        connection.close()
    finally:
        process.kill()
        process.communicate()
    assert found["suggestion_source"] == "model"
    # This network has learnt next to nothing: what it finds outside of the image is no suggestion.
    image = cv2.imread(str(trained_project.labels_dir / "arm" / "img00000.png"))[..., ::-1]
    xy = NetworkDetector.load(trained_project.models_dir / "model").detect(image[None]).xy[0]
    inside = ((xy >= -0.5) & (xy <= np.array(image.shape[1::-1]) - 0.5)).all(axis=1)
    assert inside.any()
    assert set(found["suggestions"]) == {
        name for name, is_inside in zip(trained_project.keypoints, inside, strict=True) if is_inside
    }
    distance = {
        name: np.hypot(*np.subtract(found["points"][name], suggestion["xy"]))
        for name, suggestion in found["suggestions"].items()
    }
    assert found["model_px"] == pytest.approx(max(distance.values()), abs=0.01)
    assert distance[found["model_worst"]] == max(distance.values())
    assert 0 <= found["likelihood"] <= 1
