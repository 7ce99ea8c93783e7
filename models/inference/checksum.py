"""The SHA-256 that a checkpoint or a training state carries in its own header. Imports no torch.

A changed bit in any weight, name or setting is found before the file computes. It guards against damage, not against
somebody who can write the file: that person can write the checksum too.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from ...tracker.errors import CheckpointError, reason
from ...tracker.hashing import file_sha256

HEADER = "bendtrack"
"""Key in safetensors' metadata under which a file's own header lies, as JSON."""

_KEY = "sha256"
_OLD_FIRST_KEY = "format"
"""Files from before the checksum begin with it. A header that begins with neither key is damaged."""

_LENGTH_BYTES = 8
_LONGEST_HEADER = 100_000_000
"""Bytes; safetensors' own limit."""


class DamagedFileError(CheckpointError):
    """A file's bytes are not those that were written."""


def with_place_for_checksum(header: dict[str, Any]) -> str:
    """The header as JSON, with zeros in place of the checksum; `with_checksum` fills it in."""
    return json.dumps({_KEY: "0" * 64, **header})


def with_checksum(data: bytes) -> bytes:
    """Fill in the checksum of a whole safetensors file, whose header `with_place_for_checksum` made.

    Parameters
    ----------
    data : bytes
        The file.

    Returns
    -------
    bytes
        The same, with the SHA-256 of the file as it was given.
    """
    digest = hashlib.sha256(data).hexdigest().encode()
    start = data.index(b"0" * 64)  # the first entry of the header, so the first such place
    return b"".join((data[:start], digest, data[start + 64 :]))


def check_checksum(path: Path) -> bool:
    """Check that a file holds what was written.

    Parameters
    ----------
    path : Path
        A checkpoint or a training state.

    Returns
    -------
    bool
        False for a file that carries no checksum, as those from before there was one: nothing is known about it. A
        shipped network has its checksum in a file next to it, as `sha256sum` writes them.

    Raises
    ------
    DamagedFileError
        The file is not what was written.
    OSError
        The file cannot be read.
    """
    with open(path, "rb") as file:
        start = file.read(_LENGTH_BYTES)
        length = int.from_bytes(start, "little")
        if len(start) < _LENGTH_BYTES or length > _LONGEST_HEADER:
            raise DamagedFileError(
                f"{path}: expected a safetensors file, got a damaged one (its first bytes)"
            )
        start += file.read(length)
        recorded = _recorded(path, start[_LENGTH_BYTES:])
        if recorded is None:
            return _matches_neighbour(path)
        place = start.find(recorded.encode())
        digest = hashlib.sha256(start[:place] + b"0" * 64 + start[place + 64 :])
        while block := file.read(1 << 20):
            digest.update(block)
    if digest.hexdigest() != recorded:
        raise DamagedFileError(
            f"{path}: expected the file that was written, got a damaged one (its SHA-256 differs)"
        )
    return True


def _recorded(path: Path, header: bytes) -> str | None:
    """The checksum that a safetensors header carries; None for a header from before there was one."""
    try:
        own = json.loads(json.loads(header)["__metadata__"][HEADER])
        first = next(iter(own))
        if first == _OLD_FIRST_KEY:
            return None
        recorded = own[_KEY]
        if first == _KEY and isinstance(recorded, str) and len(recorded) == 64 and recorded.isascii():
            return recorded
        why = "its checksum"
    except (KeyError, TypeError):
        why = "no header of bendtrack's"
    except (ValueError, StopIteration, RecursionError):
        why = "its header"
    raise DamagedFileError(
        f"{path}: expected a file written by bendtrack, got a damaged or foreign one ({why})"
    )


def _matches_neighbour(path: Path) -> bool:
    """Check a file without a checksum of its own against the one next to it; False where there is none."""
    neighbour = path.with_name(f"{path.name}.sha256")
    try:
        expected = neighbour.read_text(encoding="ascii").split()[0]
    except FileNotFoundError:
        return False
    except (OSError, ValueError, IndexError) as error:
        raise DamagedFileError(
            f"{neighbour}: expected a SHA-256, got a damaged file ({reason(error)})"
        ) from error
    if file_sha256(path) != expected:
        raise DamagedFileError(
            f"{path}: expected the SHA-256 in {neighbour.name}, got another: the file is damaged"
        )
    return True
