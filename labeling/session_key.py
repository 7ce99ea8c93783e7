"""The key of one start of the server, with which page and server prove themselves to each other.

The key never goes over a connection in a request. The page signs its requests with it, the server signs its answers,
and both check. So a program that listens on the port after the server has died learns nothing, and is not trusted.
Who gets the key is in `auth.py`; the page's half is page/session.js.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import re
import secrets

# The page draws 16 bytes at random.
_CREDENTIAL = re.compile(r"([A-Za-z0-9_-]{16,64})\.([A-Za-z0-9_-]{43})")
_SIGNATURE = re.compile(r"(.+)[?&]sig=([A-Za-z0-9_-]{43})")


class SessionKey:
    """A key, and what is computed from it.

    Parameters
    ----------
    text : str or None, optional
        The key; None draws a new one at random.

    Attributes
    ----------
    text : str
        The key, 256 bits in base64url.
    """

    def __init__(self, text: str | None = None) -> None:
        self.text = text or secrets.token_urlsafe(32)

    def __repr__(self) -> str:
        return "SessionKey(...)"

    def nonce_of(self, credential: str, method: str, address: str) -> str | None:
        """Check what a page sends along with a request.

        Parameters
        ----------
        credential : str
            "<nonce>.<signature>", where the signature is that of "page", nonce, method and address.
        method : str
            Method of the request.
        address : str
            Path and query of the request, as sent.

        Returns
        -------
        str or None
            The page's nonce, None where the credential is not of this key.
        """
        parts = _CREDENTIAL.fullmatch(credential)
        if parts is None or not _same(parts[2], self._signature("page", parts[1], method, address)):
            return None
        return parts[1]

    def proof(self, nonce: str, status: int) -> str:
        """Return the signature by which a page recognises an answer: of "server", the request's nonce and the status.

        Parameters
        ----------
        nonce : str
            The request's nonce.
        status : int
            Status of the answer.
        """
        return self._signature("server", nonce, str(status))

    def sign_address(self, address: str) -> str:
        """Return an address that can be fetched without a header, as <img> and EventSource do.

        Parameters
        ----------
        address : str
            Path and query.
        """
        separator = "&" if "?" in address else "?"
        return f"{address}{separator}sig={self._signature('address', address)}"

    def signed(self, address: str) -> bool:
        """Return whether an address is one that `sign_address` returns."""
        parts = _SIGNATURE.fullmatch(address)
        return parts is not None and _same(parts[2], self._signature("address", parts[1]))

    def _signature(self, *parts: str) -> str:
        digest = hmac.digest(self.text.encode(), "\n".join(parts).encode(), hashlib.sha256)
        return base64.urlsafe_b64encode(digest).decode().rstrip("=")


def _same(first: str, second: str) -> bool:
    return hmac.compare_digest(first.encode(), second.encode())
