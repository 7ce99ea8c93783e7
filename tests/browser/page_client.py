"""The page's half of the protocol without a browser: logging in, signing requests, recognising the server's answers.

Written from page/API.md, not with the server's own code. Tests of the server and benchmarks use it.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import http.client
import json
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit


def signature(key: str, *parts: str) -> str:
    digest = hmac.new(key.encode(), "\n".join(parts).encode("latin-1"), hashlib.sha256).digest()
    return base64.urlsafe_b64encode(digest).decode().rstrip("=")


def credential(key: str, method: str, address: str) -> str:
    """What goes into X-Bendtrack-Auth."""
    nonce = secrets.token_urlsafe(16)
    return f"{nonce}.{signature(key, 'page', nonce, method, address)}"


def signed_address(key: str, address: str) -> str:
    """An address that needs no header."""
    return f"{address}{'&' if '?' in address else '?'}sig={signature(key, 'address', address)}"


def proves(key: str, sent: str, answer: http.client.HTTPResponse) -> bool:
    """Whether an answer to a credential is of the server that has the key."""
    return answer.getheader("X-Bendtrack-Proof") == signature(
        key, "server", sent.partition(".")[0], str(answer.status)
    )


@dataclass(frozen=True)
class Session:
    """What a page has once it is let in."""

    port: int
    cookie: str
    key: str

    def headers(self, method: str, address: str) -> dict[str, str]:
        return {"Cookie": self.cookie, "X-Bendtrack-Auth": credential(self.key, method, address)}


def log_in(address: str) -> Session:
    """Go the way of a browser: the address for the cookie, its fragment for the key."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=60)
    connection.request("GET", f"/?{parts.query}")
    opened = connection.getresponse()
    opened.read()
    assert (opened.status, opened.getheader("Location")) == (303, "/"), opened.status
    cookie = str(opened.getheader("Set-Cookie")).partition(";")[0]
    claim = parts.fragment.removeprefix("claim=")
    sent = credential(claim, "GET", "/api/key")
    connection.request("GET", "/api/key", headers={"Cookie": cookie, "X-Bendtrack-Auth": sent})
    answer = connection.getresponse()
    body = answer.read()
    assert answer.status == 200, answer.status
    assert proves(claim, sent, answer)
    connection.close()
    return Session(int(parts.port or 0), cookie, json.loads(body)["key"])


@dataclass(frozen=True)
class AddressSender:
    """Sends new addresses of a server to the process that has started it."""

    connection: Any
    count: int = 8

    def __call__(self, new_address: Callable[[], str]) -> None:
        self.connection.send([new_address() for _ in range(self.count)])
