"""Authentication: the checks that every request passes before any of the project is read.

The server listens on this machine only. But any page in the user's browser can send requests to it (CSRF), a foreign
domain name can be made to resolve to it (DNS rebinding), and browsers send a cookie to every port of this machine. So
these are checked: the Host, the Origin, a cookie for the page's own files, a signature by the session's key for
everything of the project, and for changes a header that a foreign page cannot send. A refusal is a status without
content; only a browser that opens the page without a session gets a fixed page of words, the same for everyone. Who can
do what to whom is in docs/reference/threat-model.md.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
from collections.abc import Callable, Mapping
from functools import partial
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from .session_key import SessionKey

BODY_LIMIT = 64 * 1024
_BODY_TIMEOUT_S = 20.0
# A session outlives a browser that is closed and opened again, but not the server.
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


_USED_TITLE = "This address was used already"
_NO_SESSION_TITLE = "This page needs a new address"
_WORDS = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>bendtrack: {title}</title>
<h1>{title}.</h1>
<p>Each address of the labelling page opens it once, in one browser.</p>
<p>In the terminal press Ctrl+C, run <code>bendtrack label</code> again, and open the new address.</p>
</html>
"""

_KEY_PATH = "/api/key"
_PROOF_PATH = "/api/proof"
# Status -> signature of the answer; None where the request had no nonce.
_Proof = Callable[[int], str | None]


def _no_proof(status: int) -> None:
    return None


class AuthMiddleware:
    """ASGI middleware that accepts requests only from the page that this server has sent.

    Parameters
    ----------
    app : ASGIApp
        The protected application.
    port : int
        Port on which the server listens.
    key : SessionKey
        Key of this start of the server, which signs requests and answers.
    """

    def __init__(self, app: ASGIApp, port: int, key: SessionKey) -> None:
        self._app = app
        self._key = key
        # Opens the page's own files and nothing of the project: every program on a port of this machine may get it.
        self._secret = secrets.token_urlsafe(32)
        self._hosts = {f"127.0.0.1:{port}", f"localhost:{port}"}
        # Browsers share cookies between all ports of a host: each server's has its own name.
        self._cookie = f"bendtrack-{port}"
        self._tokens: set[str] = set()
        self._claims: dict[str, SessionKey] = {}

    def new_login(self) -> str:
        """Return an address, without the host, that opens the page once.

        Its token gets the cookie. Its fragment, which browsers do not send, gets the page the session's key. Each can
        be used once, as other users of this machine may see the address among the arguments of the browser.
        """
        token, claim = secrets.token_urlsafe(24), secrets.token_urlsafe(24)
        self._tokens.add(token)
        self._claims[claim] = SessionKey(claim)
        return f"/?token={token}#claim={claim}"

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
            words = _WORDS.format(title=_NO_SESSION_TITLE) if scope["path"] == "/" else ""
            await _send_refusal(send, 401, scope, headers, words)
            return
        if scope["path"] == _KEY_PATH:
            await self._give_key(scope, headers, send)
            return
        proof: _Proof = _no_proof
        if scope["path"].startswith("/api/"):
            nonce = _nonce(self._key, scope, headers)
            if nonce is not None:
                proof = partial(self._key.proof, nonce)
            elif scope["method"] != "GET" or not self._key.signed(_address(scope)):
                await _send_status(send, 401)
                return
        if scope["path"] == _PROOF_PATH:
            await _send_status(send, 204, proof=proof)
            return
        if scope["method"] in ("PUT", "POST"):
            body = await _read_body(headers, receive)
            if isinstance(body, int):
                await _send_status(send, body, proof=proof)
                return
            receive = _BufferedReceive(body, receive)
        await self._app(scope, receive, _with_headers(send, proof))

    def _refusal(self, scope: Scope, headers: Mapping[str, list[str]]) -> int | None:
        """Return the status that refuses a request from elsewhere, None for one of this server's own page."""
        lengths, codings = headers.get("content-length", []), headers.get("transfer-encoding", [])
        if len(lengths) + len(codings) > 1:
            return 400  # where a body ends is in doubt: two readers could see two different requests
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
            return 400 if codings or lengths not in ([], ["0"]) else None
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
            await _send_refusal(send, 403, scope, headers, _WORDS.format(title=_USED_TITLE))
            return
        answer = {"location": "/", "cache-control": "no-store"}
        if known is not None:
            self._tokens.discard(known)
            answer["set-cookie"] = (
                f"{self._cookie}={self._secret}; HttpOnly; SameSite=Strict; Path=/; Max-Age={_COOKIE_AGE_S}"
            )
        await _send_status(send, 303, answer)

    async def _give_key(self, scope: Scope, headers: Mapping[str, list[str]], send: Send) -> None:
        """Answer a page that has the fragment of a new address with the session's key, once."""
        for claim, key in self._claims.items():
            nonce = _nonce(key, scope, headers)
            if scope["method"] == "GET" and nonce is not None:
                del self._claims[claim]
                body = json.dumps({"key": self._key.text}).encode()
                await _send_status(
                    send, 200, {"content-type": "application/json"}, partial(key.proof, nonce), body
                )
                return
        await _send_status(send, 401)

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


def _address(scope: Scope) -> str:
    query = scope["query_string"].decode("latin-1")
    return scope["raw_path"].decode("latin-1") + (f"?{query}" if query else "")


def _nonce(key: SessionKey, scope: Scope, headers: Mapping[str, list[str]]) -> str | None:
    credentials = headers.get("x-bendtrack-auth", [])
    return key.nonce_of(credentials[0], scope["method"], _address(scope)) if len(credentials) == 1 else None


def _proof_header(proof: _Proof, status: int) -> dict[str, str]:
    signature = proof(status)
    return {} if signature is None else {"x-bendtrack-proof": signature}


def _with_headers(send: Send, proof: _Proof) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message.get("headers", [])}
            added = {
                "cache-control": "no-store",
                **_SECURITY_HEADERS,
                **_proof_header(proof, message["status"]),
            }
            message["headers"] = [
                *message.get("headers", []),
                *((k.encode(), v.encode()) for k, v in added.items() if k.encode() not in present),
            ]
        await send(message)

    return sending


async def _send_status(
    send: Send,
    status: int,
    headers: Mapping[str, str] | None = None,
    proof: _Proof = _no_proof,
    body: bytes = b"",
) -> None:
    """Send a status, in most cases without content."""
    fields = {
        **_SECURITY_HEADERS,
        "cache-control": "no-store",
        **_proof_header(proof, status),
        **({} if status == 204 else {"content-length": str(len(body))}),
        **(headers or {}),
    }
    if status >= 400:
        fields["connection"] = "close"  # the rest of the request is not read
    await send(
        {
            "type": "http.response.start",
            "status": status,
            "headers": [(name.encode(), value.encode("latin-1")) for name, value in fields.items()],
        }
    )
    await send({"type": "http.response.body", "body": body})


async def _send_refusal(
    send: Send, status: int, scope: Scope, headers: Mapping[str, list[str]], words_html: str
) -> None:
    """Send a status; a browser that opens the page gets `words_html` with it, whatever was wrong with its token."""
    opens_page = scope["method"] == "GET" and any("text/html" in kind for kind in headers.get("accept", []))
    if opens_page and words_html:
        body = words_html.encode()
        await _send_status(send, status, {"content-type": "text/html; charset=utf-8"}, body=body)
    else:
        await _send_status(send, status)


def _constant_time_equal(first: str, second: str) -> bool:
    return hmac.compare_digest(first.encode("utf-8", "replace"), second.encode("utf-8", "replace"))
