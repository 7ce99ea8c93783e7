"""Limits on connections: the time for a request's head, how many there are, and which goes when there are too many.

uvicorn waits for ever for the first bytes of a connection, so silent ones would fill the process's file descriptors.
What a request may ask is in `auth.py`.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

try:
    import resource
except ImportError:  # Windows, where sockets are not counted among the descriptors
    resource = None  # type: ignore[assignment]

HEAD_TIMEOUT_S = 10.0
"""Time for a request to arrive up to its body, from when the connection or the request began."""

# A browser opens six for each profile.
_MAX_CONNECTIONS = 256
# Connections that are accepted at once, before any of them can be counted.
BACKLOG = 64


def max_connections() -> int:
    """Return the largest number of connections: 256, or half of the file descriptors where these are few (macOS)."""
    if resource is None:
        return _MAX_CONNECTIONS
    descriptors = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return _MAX_CONNECTIONS if descriptors < 0 else min(_MAX_CONNECTIONS, descriptors // 2)


class LimitedProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 connection with a time for the head of a request and a limit on the number of connections.

    Where there are too many, the one that has waited longest without a request goes: a page that has something to ask
    gets in, whatever else is connected.
    """

    _head_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._begun_s = self.loop.time()
        self._start_head_timer()
        if len(self.connections) > max_connections():
            idle = [
                c for c in self.connections if isinstance(c, LimitedProtocol) and c.is_idle and c is not self
            ]
            (min(idle, key=lambda c: c._begun_s) if idle else self)._abort()

    def data_received(self, data: bytes) -> None:
        if self._head_timer is None and self.is_idle:
            self._start_head_timer()
        super().data_received(data)
        if not self.is_idle:
            self._stop_head_timer()

    def on_response_complete(self) -> None:
        self._begun_s = self.loop.time()
        super().on_response_complete()
        if not self.is_idle:  # a request that came behind the one before
            self._stop_head_timer()
        elif self.conn.trailing_data[0]:  # the beginning of one
            self._start_head_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        self._stop_head_timer()
        super().connection_lost(exc)

    @property
    def is_idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def _start_head_timer(self) -> None:
        self._stop_head_timer()
        self._head_timer = self.loop.call_later(HEAD_TIMEOUT_S, self._abort)

    def _stop_head_timer(self) -> None:
        if self._head_timer is not None:
            self._head_timer.cancel()
            self._head_timer = None

    def _abort(self) -> None:
        self._stop_head_timer()
        self.connections.discard(self)  # counted no more, though it is closed a moment later
        self.transport.abort()
