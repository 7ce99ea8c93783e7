"""Connections that ask nothing, or slowly: they end, they are few, and they keep no page out."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn
from starlette.responses import PlainTextResponse

from bendtrack.labeling import connections
from bendtrack.labeling.connections import LimitedProtocol

SOON_S = 0.3


@pytest.fixture
def port(monkeypatch) -> Iterator[int]:
    """A server with little patience and room for eight connections."""
    monkeypatch.setattr(connections, "HEAD_TIMEOUT_S", SOON_S)
    monkeypatch.setattr(connections, "max_connections", lambda: 8)
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    config = uvicorn.Config(PlainTextResponse("here"), http=LimitedProtocol, ws="none", log_level="error")
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
    thread.start()
    while not server.started:
        time.sleep(0.01)
    yield listening.getsockname()[1]
    server.should_exit = server.force_exit = True
    thread.join(10)
    listening.close()


def connect(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=5)


def ended(connection: socket.socket) -> bool:
    """Wait until the server has ended a connection without an answer."""
    try:
        return connection.recv(1000) == b""
    except ConnectionResetError:
        return True


def ask(connection: socket.socket) -> bytes:
    connection.sendall(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
    return answer(connection)


def answer(connection: socket.socket, count: int = 1) -> bytes:
    """Whatever comes until the body of an answer, or of several, has come."""
    reply = b""
    while reply.count(b"here") < count and (data := connection.recv(1000)):
        reply += data
    return reply


def drip(connection: socket.socket) -> None:
    """A header a moment, without an end."""
    begun = time.monotonic()
    try:
        while time.monotonic() - begun < 10 * SOON_S:
            connection.sendall(b"X-A: b\r\n")
            time.sleep(SOON_S / 5)
    except OSError:
        return
    raise AssertionError("the server is still listening")


def test_silence_ends(port) -> None:
    with connect(port) as silent:
        assert ended(silent)


def test_a_head_that_comes_slowly_ends(port) -> None:
    with connect(port) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\n")
        drip(slow)


def test_a_second_head_that_comes_slowly_ends_too(port) -> None:
    for begin in (b"GET / HT", b"\r\n"):
        with connect(port) as slow:
            assert b"here" in ask(slow)
            slow.sendall(begin)
            drip(slow)


def test_one_that_comes_half_behind_the_first_ends_too(port) -> None:
    with connect(port) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\nHost: a\r\n\r\nGET / HT")
        assert b"here" in answer(slow)
        assert ended(slow)


def test_a_page_may_pause_between_requests(port) -> None:
    with connect(port) as page:
        for _ in range(2):
            assert b"here" in ask(page)
            time.sleep(2 * SOON_S)


def test_pipelined_requests_are_answered(port) -> None:
    with connect(port) as page:
        page.sendall(3 * b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
        assert answer(page, 3).count(b"here") == 3


def test_a_half_closed_connection_ends(port) -> None:
    with connect(port) as half:
        half.shutdown(socket.SHUT_WR)
        assert ended(half)


def test_the_longest_silent_one_makes_room(port) -> None:
    page = connect(port)
    assert b"here" in ask(page)
    silent = [connect(port) for _ in range(40)]
    newest = connect(port)
    assert b"here" in ask(newest)
    assert all(ended(connection) for connection in silent[:30])
    for connection in (page, newest, *silent):
        connection.close()
