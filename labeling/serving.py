"""Starting the labelling server: its port, the address with the token, and running until it is stopped.

What it answers is in `server.py`.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable

import uvicorn

from ..tracker.errors import LabelError
from ..tracker.project import Project
from .annotations import Annotations, Picture
from .door import Door
from .edits import Editor
from .predictions import Network, Predictions
from .private_folder import PrivateFolder
from .repeats import REPEAT_SHARE
from .server import LabellingServer

_HOST = "127.0.0.1"


def serve_labelling(
    project: Project,
    *,
    port: int | None = None,
    network: Network | None = None,
    repeat_share: float = REPEAT_SHARE,
    ready: Callable[[Callable[[], str]], None],
) -> None:
    """Serve the labelling page of a project on this machine until interrupted.

    Parameters
    ----------
    port : where to listen; None takes the port of an earlier time if it is free, else any
    network : whose predictions are shown as ghosts
    repeat_share : share of the labelled frames that comes back blind, 0 for none
    ready : is called once with a function that makes addresses; each opens the page in one browser

    Raises
    ------
    LabelError
        There are no frames, labels cannot be read, or the port is taken.
    """
    private = PrivateFolder(project.root)
    annotations = Annotations(project, private.lock)
    editor = Editor(annotations, private)
    if not any(folder.states for folder in annotations.folders()):
        raise LabelError(
            f"expected pictures to label in {project.labels_dir}, got none: `bendtrack frames` chooses some"
        )
    secret = private.secret()
    listening = _listen(private, port)
    port = listening.getsockname()[1]
    private.remember_port(port)

    server = LabellingServer(
        annotations, editor, repeat_share=repeat_share, stopping=lambda: running.should_exit
    )
    if network is not None:
        server.facts.predictions = Predictions(
            network, private.path, lambda: _all_pictures(annotations), server.predicted
        )
    door = Door(server.app(), port, secret)
    running = uvicorn.Server(
        uvicorn.Config(
            door,
            http="h11",
            ws="none",
            loop="asyncio",
            log_level="error",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_keep_alive=60,
            timeout_graceful_shutdown=3,
        )
    )
    # Connections wait in the socket's queue until the server takes them, so it can be said already.
    ready(lambda: f"http://{_HOST}:{port}/?token={door.new_token()}")
    try:
        running.run(sockets=[listening])
    finally:
        listening.close()


def _listen(private: PrivateFolder, port: int | None) -> socket.socket:
    if port is not None:
        try:
            return _bound(port)
        except (OSError, OverflowError) as error:
            raise LabelError(f"--port: expected a free port, got {port} ({error})") from error
    for earlier in private.ports():
        try:
            return _bound(earlier)
        except (OSError, OverflowError):
            continue
    return _bound(0)


def _bound(port: int) -> socket.socket:
    # Said to be TCP, so that asyncio sends an answer's head and body without waiting 40 ms in between (Nagle).
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":  # elsewhere the option lets another program listen on the same port
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((_HOST, port))
        listening.listen(128)
    except (OSError, OverflowError):
        listening.close()
        raise
    return listening


def _all_pictures(annotations: Annotations) -> list[Picture]:
    try:
        return [picture for folder in annotations.folders() for picture in folder.pictures.values()]
    except (LabelError, OSError):
        return []  # malformed just now: the page is told, and the network has time
