"""Routes of the labelling server: what each one answers and changes. The contract is page/API.md.

Authentication is in `auth.py`, the answers' contents in `view_models.py`, the effect of an edit in `edits.py`.
Starting the server is in `serving.py`.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ..tracker.errors import LabelError
from .annotations import Annotations, ImageFile
from .edits import Change, Edited, Editor
from .event_stream import EventBroadcaster
from .frame_state import FrameState
from .images import header_size_wh, image_for_browser, thumbnail
from .label_table import Point
from .repeatability import RepeatLabel, project_repeatability, repeatability_of
from .schemas import EditRequest, RepeatRequest, StepRequest, points_from_request
from .view_models import FrameNotFoundError, ViewModels

_PAGE_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".woff2": "font/woff2",
}
_CACHE_FOREVER = "private, max-age=31536000, immutable"

_RequestModel = TypeVar("_RequestModel", bound=BaseModel)


class LabellingServer:
    """The labelling server's application, without authentication.

    Parameters
    ----------
    annotations : Annotations
        The project's frames.
    editor : Editor
        Writes changes of the frames.
    repeat_share : float
        Share in [0, 1] of the labelled frames that is shown again for a blind repeat label.
    sign_address : callable, optional
        Takes the address of an image and returns one that can be fetched without a header.
    stopping : callable, optional
        Returns True when the server is about to stop.
    finish : callable, optional
        Called when the user says that the labels are done, which the page then offers.

    Attributes
    ----------
    view_models : ViewModels
        Contents of the answers.
    broadcaster : EventBroadcaster
        Events to the connected pages.
    """

    def __init__(
        self,
        annotations: Annotations,
        editor: Editor,
        *,
        repeat_share: float,
        sign_address: Callable[[str], str] = str,
        stopping: Callable[[], bool] = lambda: False,
        finish: Callable[[], None] | None = None,
    ) -> None:
        self._annotations = annotations
        self._editor = editor
        self._finish = finish
        self._server_id = secrets.token_hex(8)
        self._page = Path(str(files("bendtrack.labeling"))) / "page"
        # A filmstrip requests dozens of thumbnails at once; a click in between must not wait for a core.
        self._thumbnail_slot = asyncio.Semaphore(1)
        self.broadcaster = EventBroadcaster(annotations, stopping)
        self.view_models = ViewModels(annotations, editor, repeat_share, sign_address)

    def app(self) -> Starlette:
        """Return the ASGI application."""

        def get(path: str, endpoint: Callable[[Request], Any]) -> Route:
            return Route(path, endpoint, methods=["GET"])

        frame = "/api/frames/{video}/{image}"
        return Starlette(
            routes=[
                get("/", self._index),
                get("/page/{name}", self._page_file),
                get("/api/project", self._project),
                get("/api/frames", self._frames),
                get(f"{frame}/image", self._image),
                get(f"{frame}/thumb", self._thumb),
                Route(frame, self._frame, methods=["GET", "PUT"]),
                Route("/api/undo", self._undo, methods=["POST"]),
                Route("/api/redo", self._redo, methods=["POST"]),
                Route("/api/finish", self._finished, methods=["POST"]),
                get("/api/events", self._events),
                get("/api/summary", self._summary),
                get("/api/repeats/next", self._next_repeat),
                Route("/api/repeats/{video}/{image}", self._repeat, methods=["PUT"]),
            ],
            exception_handlers={
                HTTPException: _empty_response,
                FrameNotFoundError: _not_found,
                LabelError: self._service_unavailable,
                OSError: self._service_unavailable,
            },
            lifespan=self._lifespan,
        )

    def predicted(self, frame: tuple[str, str] | None) -> None:
        """Broadcast the network's progress; called from its thread.

        Parameters
        ----------
        frame : tuple of str or None
            (video, image) of a frame that has a prediction now; None when the network's state has changed.
        """
        assert self.view_models.predictions is not None
        if frame is not None:
            self.broadcaster.broadcast_from_thread({"type": "predicted", "id": "/".join(frame)})
        else:
            self.broadcaster.broadcast_from_thread({"type": "model", **self.view_models.model_state()})

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        polling = asyncio.create_task(self.broadcaster.run())
        if self.view_models.predictions is not None:
            self.view_models.predictions.start()
        yield
        polling.cancel()
        with suppress(asyncio.CancelledError):
            await polling
        if self.view_models.predictions is not None:
            self.view_models.predictions.stop()

    # The page itself

    async def _index(self, request: Request) -> Response:
        return self._page_response("index.html")

    async def _page_file(self, request: Request) -> Response:
        return self._page_response(request.path_params["name"])

    def _page_response(self, name: str) -> Response:
        # A name is compared with the files of the folder; it never becomes a path.
        for path in self._page.iterdir():
            if path.name == name and path.suffix in _PAGE_TYPES and path.is_file():
                return Response(path.read_bytes(), headers={"content-type": _PAGE_TYPES[path.suffix]})
        raise HTTPException(404)

    # Reading

    async def _project(self, request: Request) -> Response:
        project = await run_in_threadpool(self.view_models.project)
        return JSONResponse({**project, "server_id": self._server_id, "can_finish": self._finish is not None})

    async def _frames(self, request: Request) -> Response:
        return JSONResponse(
            await run_in_threadpool(self.view_models.frame_list, request.query_params.get("after"))
        )

    async def _frame(self, request: Request) -> Response:
        if request.method == "PUT":
            return await self._edit(request)
        return JSONResponse(await run_in_threadpool(self.view_models.frame, *_frame_of(request)))

    async def _image(self, request: Request) -> Response:
        _, image_file = await run_in_threadpool(self.view_models.image_file, *_frame_of(request))
        tag = f'"{image_file.stamp}"'
        headers = {"etag": tag, "cache-control": _CACHE_FOREVER}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        data, media_type = await run_in_threadpool(image_for_browser, image_file)
        return Response(data, media_type=media_type, headers=headers)

    async def _thumb(self, request: Request) -> Response:
        _, image_file = await run_in_threadpool(self.view_models.image_file, *_frame_of(request))
        async with self._thumbnail_slot:
            data = await run_in_threadpool(thumbnail, image_file)
        return Response(data, media_type="image/jpeg", headers={"cache-control": _CACHE_FOREVER})

    async def _summary(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self.view_models.summary))

    async def _events(self, request: Request) -> Response:
        hello = {"type": "hello", "server_id": self._server_id}
        return StreamingResponse(self.broadcaster.events(hello), media_type="text/event-stream")

    # Changing

    async def _edit(self, request: Request) -> Response:
        video, image = _frame_of(request)
        body = await _body(request, EditRequest)
        edited = await run_in_threadpool(self._apply_edit, video, image, body)
        return await self._edit_response(edited, body, wrapped=edited.conflict)

    def _apply_edit(self, video: str, image: str, body: EditRequest) -> Edited:
        folder, image_file = self.view_models.image_file(video, image)
        points = points_from_request(body.points)
        self._check_points(points, folder.states[image], image_file)
        hidden = body.not_visible
        if hidden is not None:
            self._check_names(hidden)
            if any(points.get(name) is not None for name in hidden):
                raise HTTPException(422)
        change = Change(
            points,
            None if hidden is None else tuple(k for k in self._annotations.project.keypoints if k in hidden),
            body.note,
            body.flagged,
            body.skipped,
        )
        try:
            return self._editor.edit(
                video,
                image,
                change,
                base_revision=body.base_revision,
                edit_id=str(body.edit_id),
                client_id=body.client_id,
            )
        except KeyError as error:  # its image has gone meanwhile
            raise FrameNotFoundError(f"{video}/{image}") from error

    async def _undo(self, request: Request) -> Response:
        return await self._step(request, self._editor.undo)

    async def _redo(self, request: Request) -> Response:
        return await self._step(request, self._editor.redo)

    async def _step(self, request: Request, step: Callable[..., Edited | None]) -> Response:
        body = await _body(request, StepRequest)
        edited = await run_in_threadpool(step, edit_id=str(body.edit_id), client_id=body.client_id)
        if edited is None:
            return Response(status_code=204)
        return await self._edit_response(edited, body, wrapped=True)

    async def _edit_response(
        self, edited: Edited, body: StepRequest | EditRequest, *, wrapped: bool
    ) -> Response:
        try:
            frame = await run_in_threadpool(self.view_models.frame, edited.video, edited.image)
        except FrameNotFoundError:  # its image has been removed since
            return Response(status_code=204 if wrapped else 404)
        if edited.changed:
            self.broadcaster.frame_changed(frame["id"], frame["revision"], body.client_id, str(body.edit_id))
        return JSONResponse({"frame": frame} if wrapped else frame, 409 if edited.conflict else 200)

    async def _finished(self, request: Request) -> Response:
        await _body(request, StepRequest)
        if self._finish is None:
            raise HTTPException(404)
        if not await run_in_threadpool(self.view_models.has_whole_frame):
            raise HTTPException(422)
        self._finish()
        return Response(status_code=204)

    # Repeat labels

    async def _next_repeat(self, request: Request) -> Response:
        frame = await run_in_threadpool(self.view_models.next_repeat)
        return Response(status_code=204) if frame is None else JSONResponse(frame)

    async def _repeat(self, request: Request) -> Response:
        body = await _body(request, RepeatRequest)
        return JSONResponse(await run_in_threadpool(self._store_repeat, *_frame_of(request), body))

    def _store_repeat(self, video: str, image: str, body: RepeatRequest) -> dict[str, Any]:
        folder, image_file = self.view_models.image_file(video, image)
        project = self._annotations.project
        edit_id = str(body.edit_id)
        was_done = self._editor.was_done(edit_id)
        plan = self.view_models.current_repeat_plan(self._annotations.folders())
        if not was_done and (video, image) not in plan.waiting:
            raise HTTPException(404)
        points = points_from_request(body.points)
        self._check_points(points, FrameState(), image_file)
        if not was_done:
            placed = {name: point for name, point in points.items() if point is not None}
            repeat = RepeatLabel(placed, folder.states[image].points)
            try:
                self._editor.repeat(video, image, repeat.to_json(), edit_id=edit_id, client_id=body.client_id)
            except KeyError as error:
                raise FrameNotFoundError(f"{video}/{image}") from error
            folder, _ = self.view_models.image_file(video, image)
        stored = RepeatLabel.from_json(folder.repeats.get(image, {}))
        definition = self.view_models.definition(self._annotations.folders())
        own = None if stored is None else repeatability_of([stored], project.keypoints, definition)
        repeatability = project_repeatability(self._annotations)
        # For one frame the difference itself; `repeatability_of` gives the standard deviation of one of two labels.
        return {
            "id": f"{video}/{image}",
            "px": None if own is None else round(2 * own.px, 3),
            "angle_deg": None if own is None or own.deg is None else round(2**0.5 * own.deg, 3),
            "spread": None if repeatability is None else repeatability.to_json(),
        }

    # Checks and errors
    def _check_names(self, names: Sequence[str]) -> None:
        if not set(names) <= set(self._annotations.project.keypoints):
            raise HTTPException(422)

    def _check_points(
        self, points: Mapping[str, Point | None], state: FrameState, image_file: ImageFile
    ) -> None:
        """Refuse (422) keypoints that the project does not have, and new positions outside the image."""
        self._check_names(list(points))
        size_wh = header_size_wh(image_file)
        for name, point in points.items():
            if point is None or state.points.get(name) == point:
                continue
            if size_wh is None or not all(-0.5 <= c <= n - 0.5 for c, n in zip(point, size_wh, strict=True)):
                raise HTTPException(422)

    async def _service_unavailable(self, request: Request, error: Exception) -> Response:
        """Answer 503 where files are malformed or the disk is full: the page shows the reason and tries again."""
        root = str(self._annotations.project.root)
        reason = " ".join(str(error).split()).replace(root + "/", "")
        return JSONResponse({"reason": reason[:500]}, 503)


def _frame_of(request: Request) -> tuple[str, str]:
    return request.path_params["video"], request.path_params["image"]


async def _body(request: Request, kind: type[_RequestModel]) -> _RequestModel:
    try:
        return kind.model_validate_json(await request.body())
    except ValidationError:
        raise HTTPException(400) from None


async def _empty_response(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return Response(status_code=error.status_code, headers=error.headers)


async def _not_found(request: Request, error: Exception) -> Response:
    return Response(status_code=404)
