"""Authentication: the checks that every request passes before any of the project is read.

The server listens on this machine only. But any page in the user's browser can send requests to it (CSRF), and a
foreign domain name can be made to resolve to it (DNS rebinding). So four things are checked: the Host, the Origin, a
session cookie, and for changes a header that a foreign page cannot send. A refusal is a status without content.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send

BODY_LIMIT = 64 * 1024
_BODY_TIMEOUT_S = 20.0
# A session outlives a browser that is closed and opened again.
_COOKIE_AGE_S = 7 * 24 * 3600

_CONTENT_POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; object-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
_SECURITY_HEADERS = {
    "content-security-policy": _CONTENT_POLICY,
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}


class AuthMiddleware:
    """ASGI middleware that accepts requests only from the page that this server has sent.

    Parameters
    ----------
    app : ASGIApp
        The protected application.
    port : int
        Port on which the server listens.
    secret : str
        Secret of the session. A request that carries it in the cookie is authenticated.
    """

    def __init__(self, app: ASGIApp, port: int, secret: str) -> None:
        self._app = app
        self._secret = secret
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        # Browsers share cookies between all ports of a host: each server's has its own name.
        self._cookie = f"bendtrack-{port}"
        self._tokens: set[str] = set()

    def new_token(self) -> str:
        """Return a one-time login token."""
        token = secrets.token_urlsafe(24)
        self._tokens.add(token)
        return token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] != "http":
            return  # the server takes a websocket that is not accepted as refused
        headers: dict[str, list[str]] = {}
        for name, value in scope["headers"]:
            headers.setdefault(name.decode("latin-1").lower(), []).append(value.decode("latin-1"))
        refusal = self._refusal(scope, headers)
        if refusal is not None:
            await _send_status(send, refusal)
            return
        if scope["path"] == "/" and b"token=" in scope["query_string"]:
            await self._log_in(scope, headers, send)
            return
        if not self._has_cookie(headers):
            await _send_status(send, 401)
            return
        if scope["method"] in ("PUT", "POST"):
            body = await _read_body(headers, receive)
            if isinstance(body, int):
                await _send_status(send, body)
                return
            receive = _BufferedReceive(body, receive)
        await self._app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope, headers: Mapping[str, list[str]]) -> int | None:
        """Return the status that refuses a request from elsewhere, None for one of this server's own page."""
        hosts, origins = headers.get("host", []), headers.get("origin", [])
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return 403
        if origins not in ([], [f"http://{hosts[0].lower()}"]):
            return 403
        site = headers.get("sec-fetch-site", ["none"])
        # A link from elsewhere may open the page itself, and see nothing of it.
        opens_page = scope["method"] == "GET" and headers.get("sec-fetch-mode") == ["navigate"]
        if site not in (["same-origin"], ["none"]) and not (scope["path"] == "/" and opens_page):
            return 403
        if scope["method"] in ("GET", "HEAD"):
            return None
        if scope["method"] not in ("PUT", "POST"):
            return 405
        if not origins or headers.get("x-bendtrack") != ["1"]:
            return 403
        kinds = headers.get("content-type", [])
        if len(kinds) != 1 or kinds[0].partition(";")[0].strip().lower() != "application/json":
            return 415
        return None

    async def _log_in(self, scope: Scope, headers: Mapping[str, list[str]], send: Send) -> None:
        given = parse_qs(scope["query_string"].decode("latin-1"), max_num_fields=10).get("token", [])
        known = next((t for t in self._tokens if len(given) == 1 and _constant_time_equal(t, given[0])), None)
        if scope["method"] != "GET" or (known is None and not self._has_cookie(headers)):
            await _send_status(send, 403)
            return
        answer = {"location": "/", "cache-control": "no-store"}
        if known is not None:
            self._tokens.discard(known)
            answer["set-cookie"] = (
                f"{self._cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/; Max-Age={_COOKIE_AGE_S}"
            )
        await _send_status(send, 303, answer)

    def _has_cookie(self, headers: Mapping[str, list[str]]) -> bool:
        try:
            cookies = SimpleCookie("; ".join(headers.get("cookie", [])))
        except CookieError:
            return False
        return self._cookie in cookies and _constant_time_equal(cookies[self._cookie].value, self._secret)


class _BufferedReceive:
    """ASGI `receive` that gives a body read in advance, then the connection's messages."""

    def __init__(self, body: bytes, receive: Receive) -> None:
        self._message: Message | None = {"type": "http.request", "body": body, "more_body": False}
        self._receive = receive

    async def __call__(self) -> Message:
        message, self._message = self._message, None
        return message if message is not None else await self._receive()


async def _read_body(headers: Mapping[str, list[str]], receive: Receive) -> bytes | int:
    """Return the whole body, or the status that refuses it."""
    length = headers.get("content-length", ["0"])[0]
    if not length.isdigit() or len(length) > 9:
        return 400
    if int(length) > BODY_LIMIT:
        return 413
    body = b""
    try:
        async with asyncio.timeout(_BODY_TIMEOUT_S):
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    return 400
                body += message.get("body", b"")
                if len(body) > BODY_LIMIT:
                    return 413
                if not message.get("more_body", False):
                    return body
    except TimeoutError:
        return 408


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message.get("headers", [])}
            added = {"cache-control": "no-store", **_SECURITY_HEADERS}
            message["headers"] = [
                *message.get("headers", []),
                *((k.encode(), v.encode()) for k, v in added.items() if k.encode() not in present),
            ]
        await send(message)

    return sending


async def _send_status(send: Send, status: int, headers: Mapping[str, str] | None = None) -> None:
    """Send a status without content."""
    fields = {**_SECURITY_HEADERS, "content-length": "0", **(headers or {})}
    if status >= 400:
        fields["connection"] = "close"  # the rest of the request is not read
    await send(
        {
            "type": "http.response.start",
            "status": status,
            "headers": [(name.encode(), value.encode("latin-1")) for name, value in fields.items()],
        }
    )
    await send({"type": "http.response.body", "body": b""})


def _constant_time_equal(first: str, second: str) -> bool:
    return hmac.compare_digest(first.encode("utf-8", "replace"), second.encode("utf-8", "replace"))
