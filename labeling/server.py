"""The labelling server's answers: each address, what it gives and what it changes. The contract is page/API.md.

Who is let in is decided in `door.py`; what an edit does in `edits.py`; listening and starting in `serving.py`.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

import numpy as np
from pydantic import BaseModel, ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from ..tracker.angle import AngleDefinition
from ..tracker.errors import AngleError, LabelError
from .annotations import Annotations, Picture, VideoFolder
from .bodies import EditBody, RepeatBody, StepBody, points_of
from .edits import Change, Edited, Editor
from .frame_state import FrameState, Progress
from .ghosts import neighbour_points
from .label_table import Point
from .pictures import picture_for_browser, picture_size_wh, thumbnail
from .predictions import Prediction, Predictions
from .repeats import REMEMBERED, Repeat, RepeatPlan, project_spread, repeat_plan, spread_of
from .summary import labels_summary
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
_PREFETCHED = 3

_Body = TypeVar("_Body", bound=BaseModel)


class LabellingServer:
    """Everything behind the door.

    Parameters
    ----------
    annotations, editor : the project's frames
    repeat_share : share of the labelled frames that comes back blind
    stopping : whether the server is about to end
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
        self._repeat_share = repeat_share
        self._server_id = secrets.token_hex(8)
        self._page = Path(str(files("bendtrack.labeling"))) / "page"
        # A filmstrip asks for dozens of thumbnails at once; a click in between must not wait for a core.
        self._one_at_a_time = asyncio.Semaphore(1)
        self.watch = Watch(annotations, stopping)
        self.predictions: Predictions | None = None

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
            exception_handlers={HTTPException: _refused, LabelError: self._trouble, OSError: self._trouble},
            lifespan=self._lifespan,
        )

    def predicted(self, frame: tuple[str, str] | None) -> None:
        """Told by the network's thread what it has done."""
        assert self.predictions is not None
        if frame is not None:
            self.watch.tell_from_thread({"type": "predicted", "id": "/".join(frame)})
        else:
            self.watch.tell_from_thread({"type": "model", **self._model_state()})

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        watching = asyncio.create_task(self.watch.run())
        if self.predictions is not None:
            self.predictions.start()
        yield
        watching.cancel()
        with suppress(asyncio.CancelledError):
            await watching
        if self.predictions is not None:
            self.predictions.stop()

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
        return JSONResponse(await run_in_threadpool(self._project_facts))

    def _project_facts(self) -> dict[str, Any]:
        self._annotations.refresh()
        project = self._annotations.project
        folders = self._annotations.folders()
        definition = self._definition(folders)
        chain = [project.keypoints.index(name) for name in definition.points]
        return {
            "name": self._annotations.project.root.resolve().name,
            "scorer": project.settings.scorer,
            "keypoints": list(project.keypoints),
            "definition": {
                "name": definition.name,
                "points": list(definition.points),
                "sign": definition.sign,
            },
            "skeleton": [list(pair) for pair in pairwise(chain)],
            "actuators": sorted({project.actuator_of(folder.video) for folder in folders}),
            "model": None if self.predictions is None else self.predictions.name,
            "repeat_share": self._repeat_share,
            "server_id": self._server_id,
            "version": version("bendtrack"),
        }

    async def _frames(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self._frame_list, request.query_params.get("after")))

    def _frame_list(self, after: str | None) -> dict[str, Any]:
        self._annotations.refresh()
        folders = self._annotations.folders()
        frames = [self._line(folder, image) for folder in folders for image in folder.states]
        states = [frame["state"] for frame in frames]
        plan = self._repeat_plan(folders)
        return {
            "frames": frames,
            "progress": {
                **{kind.value: states.count(kind) for kind in Progress if kind is not Progress.UNLABELLED},
                "total": len(frames),
            },
            "next": _next_frame([(f["id"], f["state"]) for f in frames], after),
            "repeats": {"due": plan.due, "done": plan.done, "target": plan.target},
            "model": None if self.predictions is None else self._model_state(),
        }

    def _line(self, folder: VideoFolder, image: str) -> dict[str, Any]:
        """One frame as the list has it."""
        picture, state = folder.pictures[image], folder.states[image]
        keypoints = self._annotations.project.keypoints
        prediction = self._prediction(picture)
        farthest = None if prediction is None else prediction.farthest(state)
        size_wh = picture_size_wh(picture)
        return {
            "id": f"{folder.video}/{image}",
            **_addresses(folder.video, picture),
            "video": folder.video,
            "image": image,
            "frame": picture.frame,
            "time_s": None,
            "actuator": self._annotations.project.actuator_of(folder.video),
            "state": state.progress(keypoints).value,
            "n_placed": len(state.points),
            "n_not_visible": len(state.not_visible),
            "flagged": state.flagged,
            "note": state.note,
            "revision": state.revision,
            "size_wh": None if size_wh is None else list(size_wh),
            "model_px": None if farthest is None else round(farthest[1], 2),
            "model_worst": None if farthest is None else farthest[0],
            "likelihood": min(prediction.likelihood.values())
            if prediction and prediction.likelihood
            else None,
            "repeat": False,
        }

    async def _frame(self, request: Request) -> Response:
        if request.method == "PUT":
            return await self._edit(request)
        return JSONResponse(await run_in_threadpool(self._frame_facts, *_named(request)))

    def _frame_facts(self, video: str, image: str) -> dict[str, Any]:
        folder, picture = self._picture(video, image)
        state = folder.states[image]
        keypoints = self._annotations.project.keypoints
        names = list(folder.pictures)
        here = names.index(image)
        soon = [folder.pictures[name] for name in names[here + 1 : here + 1 + _PREFETCHED]]
        soon += [folder.pictures[name] for name in names[max(0, here - 1) : here]]
        if self.predictions is not None:
            self.predictions.want([picture, *soon])
        before = next((name for name in reversed(names[:here]) if folder.states[name].points), None)
        prediction = self._prediction(picture)
        ghosts: dict[str, Any]
        if prediction is not None:
            source: str | None = "model"
            ghosts = {
                name: {"xy": list(point), "sd_px": prediction.sd_px[name]}
                for name, point in prediction.points.items()
                if name in keypoints
            }
        else:
            neighbours = neighbour_points(folder, image, keypoints)
            source = "neighbours" if neighbours else None
            ghosts = {name: {"xy": list(point), "sd_px": None} for name, point in neighbours.items()}
        return {
            **self._line(folder, image),
            "points": _points(state, keypoints),
            "not_visible": list(state.not_visible),
            "skipped": state.skipped,
            "ghosts": ghosts,
            "ghost_source": source,
            "previous": None
            if before is None
            else {"id": f"{video}/{before}", "points": _points(folder.states[before], keypoints)},
            "prefetch": [_addresses(video, other)["image_url"] for other in soon],
        }

    async def _image(self, request: Request) -> Response:
        _, picture = await run_in_threadpool(self._picture, *_named(request))
        tag = f'"{picture.stamp}"'
        headers = {"etag": tag, "cache-control": _FOR_GOOD}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        data, media_type = await run_in_threadpool(picture_for_browser, picture)
        return Response(data, media_type=media_type, headers=headers)

    async def _thumb(self, request: Request) -> Response:
        _, picture = await run_in_threadpool(self._picture, *_named(request))
        async with self._one_at_a_time:
            data = await run_in_threadpool(thumbnail, picture)
        return Response(data, media_type="image/jpeg", headers={"cache-control": _FOR_GOOD})

    async def _summary(self, request: Request) -> Response:
        return JSONResponse(await run_in_threadpool(self._summary_figures))

    def _summary_figures(self) -> dict[str, Any]:
        folders = self._annotations.folders()
        spread = project_spread(self._annotations)
        return labels_summary(self._annotations.project, folders, self._definition(folders), spread)

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
        folder, picture = self._picture(video, image)
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
            facts = await run_in_threadpool(self._frame_facts, edited.video, edited.image)
        except HTTPException:  # its picture has gone since
            return Response(status_code=204 if wrapped else 404)
        if edited.changed:
            self.watch.changed(facts["id"], facts["revision"], body.client_id, str(body.edit_id))
        return JSONResponse({"frame": facts} if wrapped else facts, 409 if edited.conflict else 200)

    # Repeat labels

    async def _next_repeat(self, request: Request) -> Response:
        facts = await run_in_threadpool(self._repeat_facts)
        return Response(status_code=204) if facts is None else JSONResponse(facts)

    def _repeat_facts(self) -> dict[str, Any] | None:
        plan = self._repeat_plan(self._annotations.folders())
        for video, image in plan.waiting if plan.due else ():
            folder, picture = self._picture(video, image)
            size_wh = picture_size_wh(picture)
            if size_wh is None:
                continue
            addresses = _addresses(video, picture)
            return {
                "id": f"{video}/{image}",
                **addresses,
                "put_url": addresses["url"].replace("/api/frames/", "/api/repeats/", 1),
                "video": video,
                "image": image,
                "frame": picture.frame,
                "actuator": self._annotations.project.actuator_of(video),
                "size_wh": list(size_wh),
                "repeat": True,
                "keypoints": [
                    name
                    for name in self._annotations.project.keypoints
                    if name in folder.states[image].points
                ],
            }
        return None

    async def _repeat(self, request: Request) -> Response:
        body = await _body(request, RepeatBody)
        return JSONResponse(await run_in_threadpool(self._keep_repeat, *_named(request), body))

    def _keep_repeat(self, video: str, image: str, body: RepeatBody) -> dict[str, Any]:
        folder, picture = self._picture(video, image)
        project = self._annotations.project
        edit_id = str(body.edit_id)
        again = self._editor.was_done(edit_id)
        if not again and (video, image) not in self._repeat_plan(self._annotations.folders()).waiting:
            raise HTTPException(404)
        points = points_of(body.points)
        self._check_points(points, FrameState(), picture)
        if not again:
            placed = {name: point for name, point in points.items() if point is not None}
            repeat = Repeat(placed, folder.states[image].points)
            self._editor.repeat(video, image, repeat.to_json(), edit_id=edit_id, client_id=body.client_id)
            folder, _ = self._picture(video, image)
        kept = Repeat.from_json(folder.repeats.get(image, {}))
        definition = self._definition(self._annotations.folders())
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

    def _picture(self, video: str, image: str) -> tuple[VideoFolder, Picture]:
        folder = self._annotations.folder(video)
        if folder is None or image not in folder.pictures:
            raise HTTPException(404)
        return folder, folder.pictures[image]

    def _prediction(self, picture: Picture) -> Prediction | None:
        return None if self.predictions is None else self.predictions.of(picture)

    def _model_state(self) -> dict[str, Any]:
        predictions = self.predictions
        assert predictions is not None
        return {
            "name": predictions.name,
            "state": predictions.state,
            "reason": predictions.reason,
            "done": predictions.done,
            "total": predictions.total,
        }

    def _repeat_plan(self, folders: Sequence[VideoFolder]) -> RepeatPlan:
        lately = self._editor.lately_edited(REMEMBERED)
        return repeat_plan(folders, self._annotations.project.keypoints, lately, self._repeat_share)

    def _definition(self, folders: Sequence[VideoFolder]) -> AngleDefinition:
        """The project's angle, with the sign that the labels so far give it."""
        project = self._annotations.project
        rows = [
            [state.points.get(name, (np.nan, np.nan)) for name in project.keypoints]
            for folder in folders
            for state in folder.states.values()
            if state.points
        ]
        with suppress(AngleError):  # no frame has all points of the angle yet
            if rows:
                return project.angle_definition(np.array(rows, dtype=float))
        return project.angle_definition(None)

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


def _next_frame(frames: Sequence[tuple[str, str]], after: str | None) -> str | None:
    """The first frame that is not done, looking from the one named onwards and then from the start."""
    names = [name for name, _ in frames]
    start = names.index(after) + 1 if after in names else 0
    open_states = (Progress.UNLABELLED, Progress.PARTIAL)
    for name, state in (*frames[start:], *frames[:start]):
        if state in open_states and name != after:
            return name
    return None


def _addresses(video: str, picture: Picture) -> dict[str, str]:
    url = f"/api/frames/{quote(video, safe='')}/{quote(picture.name, safe='')}"
    return {
        "url": url,
        "image_url": f"{url}/image?v={picture.stamp}",
        "thumb_url": f"{url}/thumb?v={picture.stamp}",
    }


def _points(state: FrameState, keypoints: Sequence[str]) -> dict[str, list[float] | None]:
    return {name: list(state.points[name]) if name in state.points else None for name in keypoints}


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
