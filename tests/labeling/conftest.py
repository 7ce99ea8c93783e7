"""What tests of the labelling server share: a project of empty frames, servers in processes of their own, a client."""

from __future__ import annotations

import hashlib
import http.client
import json
import multiprocessing
import os
import signal
import socket
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from page_client import AddressSender, credential, log_in

from bendtrack.labeling.serving import serve_labelling
from bendtrack.labeling.store import LabelStore, image_name
from bendtrack.tracker.project import Project

KEYPOINTS = ("base_1", "base_2", "tip_1", "tip_2")
SIZE_WH = (96, 72)
VIDEO = "slow bend #1 50%"
"""A name that an address has to code."""

# Processes are forked from one that has imported the server already: a restart takes no second.
_FORKS = multiprocessing.get_context("forkserver")
_FORKS.set_forkserver_preload(["bendtrack.labeling.serving"])


@dataclass(frozen=True)
class Study:
    """A project with images of one video, none labelled, and what its frames are called."""

    project: Project
    keypoints = KEYPOINTS
    size_wh = SIZE_WH
    video = VIDEO

    @classmethod
    def create(cls, root: Path, frames: int = 12) -> Study:
        study = cls(Project.create(root, keypoints=KEYPOINTS))
        study.folder.mkdir(parents=True)
        for index in range(frames):
            image = np.full((SIZE_WH[1], SIZE_WH[0], 3), 20 + 5 * index, np.uint8)
            assert cv2.imwrite(str(study.folder / study.image(index)), image)
        return study

    @property
    def root(self) -> Path:
        return self.project.root

    @property
    def folder(self) -> Path:
        return self.root / "labeled-data" / VIDEO

    @property
    def csv(self) -> Path:
        return self.folder / "CollectedData_bendtrack.csv"

    @staticmethod
    def image(index: int) -> str:
        """File name of a frame."""
        return image_name(10 * index)

    @classmethod
    def id(cls, index: int) -> str:
        """What the server calls it."""
        return f"{VIDEO}/{cls.image(index)}"

    @classmethod
    def address(cls, index: int) -> str:
        """Where the server has it."""
        return f"/api/frames/slow%20bend%20%231%2050%25/{cls.image(index)}"

    def saved(self) -> dict[str, dict[str, list[float]]]:
        """Image name -> keypoint -> position, read from the label files without the server."""
        return {
            labelled.image_path.name: {
                name: [float(x), float(y)]
                for name, (x, y) in zip(KEYPOINTS, labelled.xy, strict=True)
                if not np.isnan(x)
            }
            for labelled in LabelStore.of(self.project).read()
        }

    def notes(self) -> dict[str, Any]:
        """Image name -> its entry in the notes."""
        path = self.folder / "bendtrack-notes.json"
        return json.loads(path.read_text())["images"] if path.is_file() else {}

    def fingerprint(self) -> dict[str, str]:
        """Every file and the hash of what is in it, without what is the server's own."""
        return {
            path.relative_to(self.root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(self.root.rglob("*"))
            if path.is_file() and ".bendtrack" not in path.parts
        }


@pytest.fixture
def study(tmp_path: Path) -> Study:
    return Study.create(tmp_path / "study")


@pytest.fixture(scope="module")
def make_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[[], Study]:
    return lambda: Study.create(tmp_path_factory.mktemp("module") / "study")


@dataclass(frozen=True)
class Answer:
    """What came back."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def json(self) -> Any:
        return json.loads(self.body)


@dataclass
class Page:
    """Sends what the labelling page sends, over real sockets."""

    port: int
    cookie: str
    client_id: str = "anna"
    key: str = ""
    _connection: http.client.HTTPConnection | None = field(default=None, repr=False)

    def __call__(self, method: str, path: str, body: object = None, **headers: str | None) -> Answer:
        """One request; a header that is None is left out. Raises OSError or HTTPException when no answer comes."""
        sent: dict[str, str | None] = {
            "Cookie": self.cookie,
            "X-Bendtrack-Auth": credential(self.key, method, path),
        }
        data = None
        if body is not None:
            data = body if isinstance(body, bytes) else json.dumps(body).encode()
            sent |= {
                "Origin": f"http://127.0.0.1:{self.port}",
                "X-Bendtrack": "1",
                "Content-Type": "application/json",
            }
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        if self._connection is None:
            self._connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            self._connection.request(
                method, path, data, {name: value for name, value in sent.items() if value is not None}
            )
            reply = self._connection.getresponse()
            return Answer(reply.status, {k.lower(): v for k, v in reply.getheaders()}, reply.read())
        except (OSError, http.client.HTTPException):
            self.hang_up()
            raise

    def hang_up(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def get(self, path: str) -> Any:
        answer = self("GET", path)
        assert answer.status == 200, (path, answer)
        return answer.json

    def put(self, index: int, *, edit_id: str | None = None, **fields: object) -> Answer:
        """Change a frame from the state that it has now, unless `base_revision` is given."""
        if "base_revision" not in fields:
            fields["base_revision"] = self.get(Study.address(index))["revision"]
        body = {"edit_id": edit_id or str(uuid.uuid4()), "client_id": self.client_id, "points": {}, **fields}
        return self("PUT", Study.address(index), body)

    def step(self, what: str, edit_id: str | None = None) -> Answer:
        """Undo or redo."""
        return self(
            "POST", f"/api/{what}", {"edit_id": edit_id or str(uuid.uuid4()), "client_id": self.client_id}
        )


@dataclass
class Served:
    """A server in a process of its own."""

    study: Study
    port: int
    process: Any = None
    pages: list[Page] = field(default_factory=list)
    addresses: list[str] = field(default_factory=list)

    def start(self) -> None:
        here, there = _FORKS.Pipe(duplex=False)
        self.process = _FORKS.Process(
            target=serve_labelling,
            args=(self.study.project,),
            kwargs={"port": self.port, "ready": AddressSender(there)},
            daemon=True,
        )
        self.process.start()
        there.close()
        deadline = time.monotonic() + 60
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=5).close()
                break
            except OSError:
                assert time.monotonic() < deadline, "the server does not listen"
                assert self.process.is_alive(), "the server has ended"
                time.sleep(0.02)
        self.addresses = here.recv()
        for page in self.pages:  # each start has a key of its own
            self._let_in(page)

    def _let_in(self, page: Page) -> None:
        session = log_in(self.addresses.pop())
        page.cookie, page.key = session.cookie, session.key

    def kill(self) -> None:
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.join()

    def stop(self) -> None:
        for page in self.pages:
            page.hang_up()
        with suppress(ProcessLookupError):
            self.process.terminate()
        self.process.join(20)
        if self.process.is_alive():
            self.kill()

    def page(self, client_id: str = "anna") -> Page:
        self.pages.append(Page(self.port, "", client_id))
        self._let_in(self.pages[-1])
        return self.pages[-1]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


Serve = Callable[[Study], Served]


def _serving() -> Iterator[Serve]:
    """Start a server on a study; all are stopped in the end."""
    started: list[Served] = []

    def start(study: Study) -> Served:
        served = Served(study, free_port())
        started.append(served)
        served.start()
        return served

    yield start
    for served in started:
        served.stop()


serve = pytest.fixture(_serving)
serve_for_module = pytest.fixture(scope="module")(_serving)


@pytest.fixture
def page(study: Study, serve: Serve) -> Page:
    """A page on a server of its own, on `study`."""
    return serve(study).page()
