"""A network's predictions of all frames, computed in a background thread and cached on disk.

Any `Detector` will do; its training and loading are not known here. It is loaded only when a frame is not in the
cache. The cache file is named after the network's hash.
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
from ..tracker.json_files import parse_json
from ..tracker.links import open_own_file
from ..tracker.measuring import is_outside
from ..tracker.types import Detector
from .annotations import ImageFile
from .frame_state import FrameState
from .images import decode_image
from .label_table import Point

# Unix niceness of the thread: requests of pages come first.
_NICENESS = 10
# Interval at which the worker looks for new images when all are done.
_POLL_INTERVAL_S = 5.0


@dataclass(frozen=True)
class Network:
    """A trained network that has not been loaded yet.

    Attributes
    ----------
    name : str
        Name to show.
    key : str
        Of its weights and whatever else decides what it finds, such as a hash.
    load : callable
        Makes the detector; may take seconds.
    """

    name: str
    key: str
    load: Callable[[], Detector]


@dataclass(frozen=True)
class Prediction:
    """A network's prediction of one frame.

    Attributes
    ----------
    points : dict of str to Point
        Keypoint -> (x, y) px.
    sd_px : dict of str to float or None
        keypoint -> standard deviation of a coordinate, None where the network does not say.
    likelihood : dict of str to float
        keypoint -> in [0, 1].
    """

    points: dict[str, Point]
    sd_px: dict[str, float | None]
    likelihood: dict[str, float]

    def farthest(self, state: FrameState) -> tuple[str, float] | None:
        """Return the keypoint whose label lies farthest from the prediction, and that distance in px.

        Parameters
        ----------
        state : FrameState
            The frame's labels.

        Returns
        -------
        tuple of str and float or None
            None where no predicted keypoint is labelled.
        """
        distances = {
            name: float(np.hypot(*np.subtract(point, self.points[name])))
            for name, point in state.points.items()
            if name in self.points
        }
        return max(distances.items(), key=lambda item: item[1]) if distances else None


class Predictions:
    """A thread that runs a network over all images, prioritised ones first.

    Parameters
    ----------
    network : Network
        The network to run.
    folder : Path
        Folder of the cache.
    images : callable
        Returns all images of the project.
    notify : callable
        Called from the thread with every (video, image) that is done, and with None when the state changes.

    Attributes
    ----------
    name : str
        The network's name.
    state : str
        "loading", "working", "ready" or "failed".
    reason : str
        Why it failed; empty otherwise.
    total : int
        Number of images of the project.
    """

    def __init__(
        self,
        network: Network,
        folder: Path,
        images: Callable[[], Sequence[ImageFile]],
        notify: Callable[[tuple[str, str] | None], None],
    ) -> None:
        self.name = network.name
        self.state, self.reason = "loading", ""
        self.total = 0
        self._network = network
        self._path = folder / f"predictions-{network.key[:32]}.jsonl"
        self._pictures = images
        self._notify = notify
        self._found: dict[str, Prediction] = {}
        self._unreadable: set[str] = set()
        self._prioritised: list[ImageFile] = []
        self._wake = threading.Condition()
        self._stopped = False
        self._thread = threading.Thread(target=self._run, name="predictions", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop after the current frame, without waiting for it."""
        with self._wake:
            self._stopped = True
            self._wake.notify()

    def get(self, image_file: ImageFile) -> Prediction | None:
        """Return the prediction of an image, None while there is none."""
        return self._found.get(_key(image_file))

    def prioritise(self, images: Iterable[ImageFile]) -> None:
        """Predict these images before all others."""
        with self._wake:
            self._prioritised = list(images)
            self._wake.notify()

    @property
    def done(self) -> int:
        """Number of images that have a prediction."""
        return min(len(self._found), self.total)

    def _run(self) -> None:
        if sys.platform == "linux":  # here a thread has a priority of its own
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICENESS)
        try:
            self._read_cache()
            detector: Detector | None = None
            while not self._stopped:
                image_file = self._next()
                if image_file is None:
                    self._set_state("ready")
                    with self._wake:
                        if not self._stopped:
                            self._wake.wait(_POLL_INTERVAL_S)
                    continue
                if detector is None:
                    self._set_state("loading")
                    detector = self._network.load()
                self._set_state("working")
                self._predict(image_file, detector)
        except Exception as error:  # a network that does not run must not stop the labelling
            self.reason = " ".join(str(error).split()) or type(error).__name__
            self._set_state("failed")

    def _next(self) -> ImageFile | None:
        images = self._pictures()
        self.total = len(images)
        with self._wake:
            wanted = self._prioritised
        for image_file in (*wanted, *images):
            if _key(image_file) not in self._found and _key(image_file) not in self._unreadable:
                return image_file
        return None

    def _predict(self, image_file: ImageFile, detector: Detector) -> None:
        try:
            image = cv2.cvtColor(decode_image(image_file), cv2.COLOR_BGR2RGB)
        except (OSError, LabelError):
            self._unreadable.add(_key(image_file))
            return
        detections = detector.detect(np.asarray(image, np.uint8)[None])
        variance = np.trace(detections.covariance[0], axis1=1, axis2=2) / 2
        # A position outside of the image can be no label: it is no suggestion either.
        outside = is_outside(detections.xy[0], (image.shape[1], image.shape[0]))
        xy = np.where(outside[:, None], np.nan, detections.xy[0])
        record = {
            "picture": _key(image_file),
            "found": {
                name: [*map(_number, xy[k]), _number(np.sqrt(variance[k])),
                       _number(detections.likelihood[0, k])]
                for k, name in enumerate(detector.keypoints)
            },
        }  # fmt: skip
        self._add_record(record)
        descriptor = open_own_file(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
        with open(descriptor, "a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
        self._notify((image_file.path.parent.name, image_file.name))

    def _read_cache(self) -> None:
        try:
            lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        except FileNotFoundError:
            return
        for line in lines:
            # A line may be truncated where a server was killed.
            with suppress(ValueError, KeyError, TypeError, AttributeError, OverflowError):
                self._add_record(parse_json(line))

    def _add_record(self, record: dict[str, Any]) -> None:
        found = {name: values for name, values in record["found"].items() if None not in values[:2]}
        self._found[str(record["picture"])] = Prediction(
            {name: (float(x), float(y)) for name, (x, y, _, _) in found.items()},
            {name: None if sd is None else float(sd) for name, (_, _, sd, _) in found.items()},
            {name: float(likelihood or 0.0) for name, (_, _, _, likelihood) in record["found"].items()},
        )

    def _set_state(self, state: str) -> None:
        if state != self.state:
            self.state = state
            self._notify(None)


def _key(image_file: ImageFile) -> str:
    return f"{image_file.path.parent.name}/{image_file.name}/{image_file.stamp}"


def _number(value: Any) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None
