"""Telling open pages what has changed: by this server, by another one, or by another program that wrote the files."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from typing import Any

from starlette.concurrency import run_in_threadpool

from ..tracker.errors import LabelError
from .annotations import Annotations

# Often enough to seem at once; a look costs some stats of files.
_LOOK_EVERY_S = 1.0
# Proxies and sleeping laptops lose connections on which nothing comes.
_COMMENT_EVERY_S = 15.0
_EVENTS_WAITING = 1000


class Watch:
    """Pages that listen, and the thread of events that they get.

    Parameters
    ----------
    annotations : what is watched on disk, while anyone listens
    stopping : whether the server is about to end
    """

    def __init__(self, annotations: Annotations, stopping: Callable[[], bool]) -> None:
        self._annotations = annotations
        self._stopping = stopping
        self._pages: set[asyncio.Queue[Mapping[str, Any]]] = set()
        self._seen: dict[str, int] | None = None  # not looked yet; no frames at all is {}
        self._told: dict[str, int] = {}
        self._loop: asyncio.AbstractEventLoop | None = None

    def tell(self, event: Mapping[str, Any]) -> None:
        """Send an event to every page. From the event loop."""
        for page in self._pages:
            with suppress(asyncio.QueueFull):  # a page that reads no more
                page.put_nowait(event)

    def tell_from_thread(self, event: Mapping[str, Any]) -> None:
        """The same, from any thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.tell, event)

    def changed(self, frame: str, revision: int, client_id: str, edit_id: str) -> None:
        """Tell that this server has changed a frame."""
        self._told[frame] = revision
        if self._seen is not None and frame in self._seen:
            self._seen[frame] = revision
        self.tell(
            {"type": "changed", "id": frame, "revision": revision, "client_id": client_id, "edit_id": edit_id}
        )

    async def run(self) -> None:
        """Look at the disk again and again. Runs until cancelled."""
        self._loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_LOOK_EVERY_S)
            if not self._pages:
                self._seen = None
                continue
            with suppress(
                LabelError, OSError
            ):  # half of it is being replaced, or malformed: requests will say so
                self._compare(await run_in_threadpool(self._look))

    async def events(self, hello: Mapping[str, Any]) -> AsyncIterator[str]:
        """The events of one page as text/event-stream."""
        queue: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue(_EVENTS_WAITING)
        self._pages.add(queue)
        try:
            if self._seen is None:  # who fetches the list after the hello misses nothing
                with suppress(LabelError, OSError):
                    self._seen = await run_in_threadpool(self._look)
            yield _line(hello)
            silent_s = 0.0
            while not self._stopping():
                try:
                    yield _line(await asyncio.wait_for(queue.get(), 0.5))
                    silent_s = 0.0
                except TimeoutError:
                    silent_s += 0.5
                    if silent_s >= _COMMENT_EVERY_S:
                        silent_s = 0.0
                        yield ": still here\n\n"
        finally:
            self._pages.discard(queue)

    def _look(self) -> dict[str, int]:
        return {
            f"{folder.video}/{image}": state.revision
            for folder in self._annotations.folders()
            for image, state in folder.states.items()
        }

    def _compare(self, now: dict[str, int]) -> None:
        seen = now if self._seen is None else self._seen
        if now.keys() != seen.keys():
            self.tell({"type": "frames"})
        for frame, revision in now.items():
            if seen.get(frame, revision) != revision:
                self.tell(
                    {"type": "changed", "id": frame, "revision": revision, "client_id": None, "edit_id": None}
                )
        self._seen = now


def _line(event: Mapping[str, Any]) -> str:
    return f"data: {json.dumps(event)}\n\n"
