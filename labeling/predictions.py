"""What the network makes of every frame, computed behind the page's back and kept for the next time.

Any `Detector` will do; who trained it and how it is loaded is not known here. It is loaded only when a frame is
not in the cache, which is named after the network's hash.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..tracker.errors import LabelError
from ..tracker.types import Detector
from .annotations import Picture
from .frame_state import FrameState
from .label_table import Point
from .pictures import decoded_picture

# Above the pages' requests in number, so below them in rank.
_NICENESS = 10
# How long the worker sleeps before it looks for pictures that came meanwhile.
_PAUSE_S = 5.0


@dataclass(frozen=True)
class Network:
    """A trained network that has not been loaded yet.

    Attributes
    ----------
    name : for people
    key : of its weights and whatever else decides what it finds, such as a hash
    load : makes the detector; may take seconds
    """

    name: str
    key: str
    load: Callable[[], Detector]


@dataclass(frozen=True)
class Prediction:
    """What a network found in one frame.

    Attributes
    ----------
    points : keypoint -> (x, y) px
    sd_px : keypoint -> standard deviation of a coordinate, None where the network does not say
    likelihood : keypoint -> in [0, 1]
    """

    points: dict[str, Point]
    sd_px: dict[str, float | None]
    likelihood: dict[str, float]

    def farthest(self, state: FrameState) -> tuple[str, float] | None:
        """The keypoint whose label lies farthest from the prediction, and the distance px; None without labels."""
        distances = {
            name: float(np.hypot(*np.subtract(point, self.points[name])))
            for name, point in state.points.items()
            if name in self.points
        }
        return max(distances.items(), key=lambda item: item[1]) if distances else None


class Predictions:
    """A thread that runs a network over pictures, those that are wanted first.

    Parameters
    ----------
    network : what to run
    folder : where the cache lies
    pictures : gives all pictures there are
    notify : is told, from the thread, of every (video, image) that is done; and None when the state changes

    Attributes
    ----------
    state : "loading", "working", "ready" or "failed"
    reason : why it failed
    """

    def __init__(
        self,
        network: Network,
        folder: Path,
        pictures: Callable[[], Sequence[Picture]],
        notify: Callable[[tuple[str, str] | None], None],
    ) -> None:
        self.name = network.name
        self.state, self.reason = "loading", ""
        self.total = 0
        self._network = network
        self._path = folder / f"predictions-{network.key[:32]}.jsonl"
        self._pictures = pictures
        self._notify = notify
        self._found: dict[str, Prediction] = {}
        self._unreadable: set[str] = set()
        self._wanted: list[Picture] = []
        self._wake = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="predictions", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End after the frame at hand, without waiting for it."""
        with self._wake:
            self._stopped = True
            self._wake.notify()

    def of(self, picture: Picture) -> Prediction | None:
        """What was found in a picture; None while it is not known."""
        return self._found.get(_key(picture))

    def want(self, pictures: Iterable[Picture]) -> None:
        """Look at these before all others."""
        with self._wake:
            self._wanted = list(pictures)
            self._wake.notify()

    @property
    def done(self) -> int:
        """How many of the pictures are known."""
        return min(len(self._found), self.total)

    def _run(self) -> None:
        if sys.platform == "linux":  # where a thread has a priority of its own
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        try:
            self._read_cache()
            detector: Detector | None = None
            while not self._stopped:
                picture = self._next()
                if picture is None:
                    self._become("ready")
                    with self._wake:
                        if not self._stopped:
                            self._wake.wait(_PAUSE_S)
                    continue
                if detector is None:
                    self._become("loading")
                    detector = self._network.load()
                self._become("working")
                self._look_at(picture, detector)
        except Exception as error:  # a network that does not run must not end the labelling
            self.reason = " ".join(str(error).split()) or type(error).__name__
            self._become("failed")

    def _next(self) -> Picture | None:
        pictures = self._pictures()
        self.total = len(pictures)
        with self._wake:
            wanted = self._wanted
        for picture in (*wanted, *pictures):
            if _key(picture) not in self._found and _key(picture) not in self._unreadable:
                return picture
        return None

    def _look_at(self, picture: Picture, detector: Detector) -> None:
        try:
            image = cv2.cvtColor(decoded_picture(picture), cv2.COLOR_BGR2RGB)
        except (OSError, LabelError):
            self._unreadable.add(_key(picture))
            return
        detections = detector.detect(np.asarray(image, np.uint8)[None])
        variance = np.trace(detections.covariance[0], axis1=1, axis2=2) / 2
        record = {
            "picture": _key(picture),
            "found": {
                name: [*map(_number, detections.xy[0, k]), _number(np.sqrt(variance[k])),
                       _number(detections.likelihood[0, k])]
                for k, name in enumerate(detector.keypoints)
            },
        }  # fmt: skip
        self._take(record)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        self._notify((picture.path.parent.name, picture.name))

    def _read_cache(self) -> None:
        try:
            lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        except FileNotFoundError:
            return
        for line in lines:
            with suppress(
                ValueError, KeyError, TypeError, AttributeError
            ):  # cut short when a server was killed
                self._take(json.loads(line))

    def _take(self, record: dict[str, Any]) -> None:
        found = {name: values for name, values in record["found"].items() if None not in values[:2]}
        self._found[str(record["picture"])] = Prediction(
            {name: (float(x), float(y)) for name, (x, y, _, _) in found.items()},
            {name: None if sd is None else float(sd) for name, (_, _, sd, _) in found.items()},
            {name: float(likelihood or 0.0) for name, (_, _, _, likelihood) in record["found"].items()},
        )

    def _become(self, state: str) -> None:
        if state != self.state:
            self.state = state
            self._notify(None)


def _key(picture: Picture) -> str:
    return f"{picture.path.parent.name}/{picture.name}/{picture.stamp}"


def _number(value: Any) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None
