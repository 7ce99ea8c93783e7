"""The labelling server's answers: each address, what it gives and what it changes. The contract is page/API.md.

Who is let in is decided in `door.py`; what pages are told comes from `page_facts.py`; what an edit does is in
`edits.py`, listening and starting in `serving.py`.
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
from .annotations import Annotations, Picture
from .bodies import EditBody, RepeatBody, StepBody, points_of
from .edits import Change, Edited, Editor
from .frame_state import FrameState
from .label_table import Point
from .page_facts import NoFrameError, PageFacts
from .pictures import picture_for_browser, picture_size_wh, thumbnail
from .repeats import Repeat, project_spread, spread_of
from .watching import Watch

_PAGE_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".woff2": "font/woff2",
}
_FOR_GOOD = "private, max-age=31536000, immutable"

_Body = TypeVar("_Body", bound=BaseModel)


class LabellingServer:
    """Everything behind the door.

    Parameters
    ----------
    annotations, editor : the project's frames
    repeat_share : share of the labelled frames that comes back blind
    stopping : whether the server is about to end

    Attributes
    ----------
    facts : what pages are told
    """

    def __init__(
        self,
        annotations: Annotations,
        editor: Editor,
        *,
        repeat_share: float,
        stopping: Callable[[], bool] = lambda: False,
    ) -> None:
        self._annotations = annotations
        self._editor = editor
        self._server_id = secrets.token_hex(8)
        self._page = Path(str(files("bendtrack.labeling"))) / "page"
        # A filmstrip asks for dozens of thumbnails at once; a click in between must not wait for a core.
        self._one_at_a_time = asyncio.Semaphore(1)
        self.watch = Watch(annotations, stopping)
        self.facts = PageFacts(annotations, editor, repeat_share)

    def app(self) -> Starlette:
        """The ASGI application."""

        def get(path: str, answer: Callable[[Request], Any]) -> Route:
            return Route(path, answer, methods=["GET"])

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
                get("/api/events", self._events),
                get("/api/summary", self._summary),
                get("/api/repeats/next", self._next_repeat),
                Route("/api/repeats/{video}/{image}", self._repeat, methods=["PUT"]),
            ],
            exception_handlers={
                HTTPException: _refused,
                NoFrameError: _not_there,
                LabelError: self._trouble,
                OSError: self._trouble,
            },
            lifespan=self._lifespan,
        )

    def predicted(self, frame: tuple[str, str] | None) -> None:
        """Told by the network's thread what it has done."""
        assert self.facts.predictions is not None
        if frame is not None:
            self.watch.tell_from_thread({"type": "predicted", "id": "/".join(frame)})
        else:
            self.watch.tell_from_thread({"type": "model", **self.facts.model_state()})

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(self.watch.run())
        if self.facts.predictions is not None:
            self.facts.predictions.start()
        yield
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching
        if self.facts.predictions is not None:
            self.facts.predictions.stop()

    # The page itself

    async def _index(self, request: Request) -> Response:
        return self._page_answer("index.html")

    async def _page_file(self, request: Request) -> Response:
        return self._page_answer(request.path_params["name"])

    def _page_answer(self, name: str) -> Response:
        # A name is looked up among those there are; it never becomes a path.
        for path in self._page.iterdir():
            if path.name == name and path.suffix in _PAGE_TYPES and path.is_file():
                return Response(path.read_bytes(), headers={"content-type": _PAGE_TYPES[path.suffix]})
        raise HTTPException(404)

    # Reading

    async def _project(self, request: Request) -> Response:
        facts = await run_in_threadpool(self.facts.project)
        return JSONResponse({**facts, "server_id": self._server_id})

    async def _frames(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self.facts.frame_list, request.query_params.get("after")))

    async def _frame(self, request: Request) -> Response:
        if request.method == "PUT":
            return await self._edit(request)
        return JSONResponse(await run_in_threadpool(self.facts.frame, *_named(request)))

    async def _image(self, request: Request) -> Response:
        _, picture = await run_in_threadpool(self.facts.picture, *_named(request))
        tag = f'"{picture.stamp}"'
        headers = {"etag": tag, "cache-control": _FOR_GOOD}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        data, media_type = await run_in_threadpool(picture_for_browser, picture)
        return Response(data, media_type=media_type, headers=headers)

    async def _thumb(self, request: Request) -> Response:
        _, picture = await run_in_threadpool(self.facts.picture, *_named(request))
        async with self._one_at_a_time:
            data = await run_in_threadpool(thumbnail, picture)
        return Response(data, media_type="image/jpeg", headers={"cache-control": _FOR_GOOD})

    async def _summary(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self.facts.summary))

    async def _events(self, request: Request) -> Response:
        hello = {"type": "hello", "server_id": self._server_id}
        return StreamingResponse(self.watch.events(hello), media_type="text/event-stream")

    # Changing

    async def _edit(self, request: Request) -> Response:
        video, image = _named(request)
        body = await _body(request, EditBody)
        edited = await run_in_threadpool(self._carry_out, video, image, body)
        return await self._answer(edited, body, wrapped=edited.conflict)

    def _carry_out(self, video: str, image: str, body: EditBody) -> Edited:
        folder, picture = self.facts.picture(video, image)
        points = points_of(body.points)
        self._check_points(points, folder.states[image], picture)
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
        return self._editor.edit(
            video,
            image,
            change,
            base_revision=body.base_revision,
            edit_id=str(body.edit_id),
            client_id=body.client_id,
        )

    async def _undo(self, request: Request) -> Response:
        return await self._step(request, self._editor.undo)

    async def _redo(self, request: Request) -> Response:
        return await self._step(request, self._editor.redo)

    async def _step(self, request: Request, step: Callable[..., Edited | None]) -> Response:
        body = await _body(request, StepBody)
        edited = await run_in_threadpool(step, edit_id=str(body.edit_id), client_id=body.client_id)
        if edited is None:
            return Response(status_code=204)
        return await self._answer(edited, body, wrapped=True)

    async def _answer(self, edited: Edited, body: StepBody | EditBody, *, wrapped: bool) -> Response:
        try:
            facts = await run_in_threadpool(self.facts.frame, edited.video, edited.image)
        except NoFrameError:  # its picture has gone since
            return Response(status_code=204 if wrapped else 404)
        if edited.changed:
            self.watch.changed(facts["id"], facts["revision"], body.client_id, str(body.edit_id))
        return JSONResponse({"frame": facts} if wrapped else facts, 409 if edited.conflict else 200)

    # Repeat labels

    async def _next_repeat(self, request: Request) -> Response:
        facts = await run_in_threadpool(self.facts.next_repeat)
        return Response(status_code=204) if facts is None else JSONResponse(facts)

    async def _repeat(self, request: Request) -> Response:
        body = await _body(request, RepeatBody)
        return JSONResponse(await run_in_threadpool(self._keep_repeat, *_named(request), body))

    def _keep_repeat(self, video: str, image: str, body: RepeatBody) -> dict[str, Any]:
        folder, picture = self.facts.picture(video, image)
        project = self._annotations.project
        edit_id = str(body.edit_id)
        again = self._editor.was_done(edit_id)
        if (
            not again
            and (video, image) not in self.facts.plan_of_repeats(self._annotations.folders()).waiting
        ):
            raise HTTPException(404)
        points = points_of(body.points)
        self._check_points(points, FrameState(), picture)
        if not again:
            placed = {name: point for name, point in points.items() if point is not None}
            repeat = Repeat(placed, folder.states[image].points)
            self._editor.repeat(video, image, repeat.to_json(), edit_id=edit_id, client_id=body.client_id)
            folder, _ = self.facts.picture(video, image)
        kept = Repeat.from_json(folder.repeats.get(image, {}))
        definition = self.facts.definition(self._annotations.folders())
        own = None if kept is None else spread_of([kept], project.keypoints, definition)
        spread = project_spread(self._annotations)
        # Of one frame, the difference itself: spread_of gives the standard deviation of one label of the two.
        return {
            "id": f"{video}/{image}",
            "px": None if own is None else round(2 * own.px, 3),
            "angle_deg": None if own is None or own.deg is None else round(2**0.5 * own.deg, 3),
            "spread": None if spread is None else spread.to_json(),
        }

    # What they share

    def _check_names(self, names: Sequence[str]) -> None:
        if not set(names) <= set(self._annotations.project.keypoints):
            raise HTTPException(422)

    def _check_points(self, points: Mapping[str, Point | None], state: FrameState, picture: Picture) -> None:
        """Refuse (422) keypoints that the project has not, and new positions outside the picture."""
        self._check_names(list(points))
        size_wh = picture_size_wh(picture)
        for name, point in points.items():
            if point is None or state.points.get(name) == point:
                continue
            if size_wh is None or not all(-0.5 <= c <= n - 0.5 for c, n in zip(point, size_wh, strict=True)):
                raise HTTPException(422)

    async def _trouble(self, request: Request, error: Exception) -> Response:
        """The files are not as they should be, or the disk is full: the page says so and tries again."""
        root = str(self._annotations.project.root)
        reason = " ".join(str(error).split()).replace(root + "/", "")
        return JSONResponse({"reason": reason[:500]}, 503)


def _named(request: Request) -> tuple[str, str]:
    return request.path_params["video"], request.path_params["image"]


async def _body(request: Request, kind: type[_Body]) -> _Body:
    try:
        return kind.model_validate_json(await request.body())
    except ValidationError:
        raise HTTPException(400) from None


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return Response(status_code=error.status_code, headers=error.headers)


async def _not_there(request: Request, error: Exception) -> Response:
    return Response(status_code=404)
