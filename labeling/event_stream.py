"""Server-sent events: open pages are notified of changes by this server, another one, or another program.

What the events mean is in page/API.md.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import suppress
from typing import Any

from starlette.concurrency import run_in_threadpool

from ..tracker.errors import LabelError
from .annotations import Annotations

# Short enough to seem immediate; one poll costs a stat of every file.
_POLL_INTERVAL_S = 1.0
# Proxies and sleeping laptops drop connections without traffic.
_HEARTBEAT_INTERVAL_S = 15.0
_MAX_QUEUED_EVENTS = 1000
# Tabs that listen. A hidden tab does not, so a person has a handful; beyond it the oldest stream ends.
MAX_STREAMS = 32


class EventBroadcaster:
    """Broadcasts events to all connected pages, and polls the label files for changes by others.

    Parameters
    ----------
    annotations : Annotations
        The label files, polled while a page is connected.
    stopping : callable
        Returns True when the server is about to stop.
    """

    def __init__(self, annotations: Annotations, stopping: Callable[[], bool]) -> None:
        self._annotations = annotations
        self._stopping = stopping
        self._pages: dict[asyncio.Queue[Mapping[str, Any]], None] = {}  # the oldest first
        self._seen: dict[str, int] | None = None  # None: not polled yet; {}: no frames
        self._loop: asyncio.AbstractEventLoop | None = None

    def broadcast(self, event: Mapping[str, Any]) -> None:
        """Send an event to every page. Call it from the event loop."""
        for page in self._pages:
            with suppress(asyncio.QueueFull):  # a page that has stopped reading
                page.put_nowait(event)

    def broadcast_from_thread(self, event: Mapping[str, Any]) -> None:
        """Send an event to every page, from any thread."""
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self.broadcast, event)

    def frame_changed(self, frame: str, revision: int, client_id: str, edit_id: str) -> None:
        """Broadcast that this server has changed a frame.

        Parameters
        ----------
        frame : str
            Its id, "<video>/<image>".
        revision : int
            Its new revision.
        client_id : str
            Undo history that the edit belongs to.
        edit_id : str
            The edit.
        """
        if self._seen is not None and frame in self._seen:
            self._seen[frame] = revision
        self.broadcast(
            {"type": "changed", "id": frame, "revision": revision, "client_id": client_id, "edit_id": edit_id}
        )

    async def run(self) -> None:
        """Poll the label files until cancelled."""
        self._loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(_POLL_INTERVAL_S)
            if not self._pages:
                self._seen = None
                continue
            # Files that are being replaced or are malformed: the next request reports them.
            with suppress(LabelError, OSError):
                self._compare(await run_in_threadpool(self._revisions))

    async def events(self, hello: Mapping[str, Any]) -> AsyncIterator[str]:
        """Yield the events of one page as text/event-stream.

        Parameters
        ----------
        hello : mapping of str to Any
            The first event.

        Yields
        ------
        str
            One event, or a comment that keeps the connection open.
        """
        queue: asyncio.Queue[Mapping[str, Any]] = asyncio.Queue(_MAX_QUEUED_EVENTS)
        self._pages[queue] = None
        if len(self._pages) > MAX_STREAMS:
            self._pages.pop(next(iter(self._pages)))
        try:
            if self._seen is None:  # a page that fetches the frame list after the hello misses no change
                with suppress(LabelError, OSError):
                    self._seen = await run_in_threadpool(self._revisions)
            yield _line(hello)
            silent_s = 0.0
            while queue in self._pages and not self._stopping():
                try:
                    yield _line(await asyncio.wait_for(queue.get(), 0.5))
                    silent_s = 0.0
                except TimeoutError:
                    silent_s += 0.5
                    if silent_s >= _HEARTBEAT_INTERVAL_S:
                        silent_s = 0.0
                        yield ": still here\n\n"
        finally:
            self._pages.pop(queue, None)

    def _revisions(self) -> dict[str, int]:
        return {
            f"{folder.video}/{image}": state.revision
            for folder in self._annotations.folders()
            for image, state in folder.states.items()
        }

    def _compare(self, now: dict[str, int]) -> None:
        seen = now if self._seen is None else self._seen
        if now.keys() != seen.keys():
            self.broadcast({"type": "frames"})
        for frame, revision in now.items():
            if seen.get(frame, revision) != revision:
                self.broadcast(
                    {"type": "changed", "id": frame, "revision": revision, "client_id": None, "edit_id": None}
                )
        self._seen = now


def _line(event: Mapping[str, Any]) -> str:
    return f"data: {json.dumps(event)}\n\n"
