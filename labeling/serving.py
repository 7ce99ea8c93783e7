"""Starting the labelling server: its port, the address with the token, and running it until it is stopped.

Its routes are in `server.py`.
"""

from __future__ import annotations

import os
import shlex
import socket
from collections.abc import Callable

import uvicorn

from ..tracker.errors import LabelError
from ..tracker.project import Project
from .annotations import Annotations, ImageFile
from .auth import AuthMiddleware
from .connections import BACKLOG, LimitedProtocol
from .edits import Editor
from .predictions import Network, Predictions
from .private_folder import PrivateFolder
from .repeatability import REPEAT_SHARE
from .server import LabellingServer
from .session_key import SessionKey

_HOST = "127.0.0.1"


def serve_labelling(
    project: Project,
    *,
    port: int | None = None,
    network: Network | None = None,
    repeat_share: float = REPEAT_SHARE,
    ready: Callable[[Callable[[], str]], None],
    until_finished: bool = False,
) -> None:
    """Serve the labelling page of a project on this machine until interrupted.

    Parameters
    ----------
    project : Project
        The project to label.
    port : int or None, optional
        Port to listen on. None takes one that this project was served on before if it is free, else any.
    network : Network or None, optional
        Network whose predictions are suggested.
    repeat_share : float, optional
        Share in [0, 1] of the labelled frames that is shown again for a blind repeat label; 0 for none.
    ready : callable
        Called once with a function that returns a new address at every call; each opens the page in one browser.
    until_finished : bool, optional
        Whether the page has a button that ends the server, once every keypoint is placed in some frame.

    Raises
    ------
    LabelError
        There are no frames, labels cannot be read, or the port is taken.
    """
    private = PrivateFolder(project.root)
    annotations = Annotations(project, private.lock, private.check_reachable)
    editor = Editor(annotations, private)
    if not any(folder.states for folder in annotations.folders()):
        raise LabelError(
            f"expected images to label in {project.labels_dir}, got none:"
            f" `bendtrack frames {shlex.quote(str(project.root))} VIDEO...` chooses some"
        )
    key = SessionKey()
    listening = _listen(private, port)
    port = listening.getsockname()[1]
    private.remember_port(port)

    server = LabellingServer(
        annotations,
        editor,
        repeat_share=repeat_share,
        sign_address=key.sign_address,
        stopping=lambda: running.should_exit,
        finish=(lambda: setattr(running, "should_exit", True)) if until_finished else None,
    )
    if network is not None:
        server.view_models.predictions = Predictions(
            network, private.path, lambda: _all_images(annotations), server.predicted
        )
    auth = AuthMiddleware(server.app(), port, key)
    running = uvicorn.Server(
        uvicorn.Config(
            auth,
            http=LimitedProtocol,
            backlog=BACKLOG,
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
    # Connections wait in the socket's queue until the server accepts them, so the address is valid already.
    ready(lambda: f"http://{_HOST}:{port}{auth.new_login()}")
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
    # IPPROTO_TCP: only then asyncio sets TCP_NODELAY, without which an answer's body comes 40 ms after its head.
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


def _all_images(annotations: Annotations) -> list[ImageFile]:
    try:
        return [image_file for folder in annotations.folders() for image_file in folder.images.values()]
    except (LabelError, OSError):
        return []  # malformed at the moment: the page's own requests report it
