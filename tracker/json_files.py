"""Reading JSON of any origin: size, depth and characters are checked, and every mistake is one user's error.

What the values mean is up to the caller.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, NoReturn

from .errors import BendtrackError, reason

# Bytes of a file; read, its values take up to thirty times as much memory.
MAX_BYTES = 2**28

_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")


def read_json(path: Path, error: type[BendtrackError], *, finite: bool = True) -> Any:
    """Read a JSON file in UTF-8, with or without a byte order mark.

    Parameters
    ----------
    path : Path
        The file.
    error : type of BendtrackError
        Class of the error to raise.
    finite : bool, optional
        Refuse NaN and infinite numbers, which are no JSON, but which many programs write.

    Returns
    -------
    Any
        Its value: dict, list, str, int, float, bool or None.

    Raises
    ------
    error
        The file is too large, not UTF-8 or not JSON.
    OSError
        The file cannot be read.
    """
    try:
        return load_json(path, finite=finite)
    except ValueError as mistake:
        raise error(f"{path}: expected JSON, got a mistake ({reason(mistake)})") from mistake


def load_json(path: Path, *, finite: bool = True) -> Any:
    """Read a JSON file, for callers that have their own words for a mistake in it.

    Parameters
    ----------
    path : Path
        The file.
    finite : bool, optional
        Refuse NaN and infinite numbers.

    Returns
    -------
    Any
        Its value.

    Raises
    ------
    ValueError
        The file is too large, not UTF-8 or not JSON.
    OSError
        The file cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ValueError(f"expected at most {MAX_BYTES / 1e6:.0f} MB, got {size / 1e6:.0f} MB")
    return parse_json(path.read_bytes(), finite=finite)


def parse_json(data: bytes | str, *, finite: bool = True) -> Any:
    """Parse JSON whose texts can be written as UTF-8.

    Parameters
    ----------
    data : bytes or str
        The text, as bytes in UTF-8.
    finite : bool, optional
        Refuse NaN and infinite numbers.

    Returns
    -------
    Any
        Its value.

    Raises
    ------
    ValueError
        It is no such JSON, or nested too deep.
    """
    text = data.decode("utf-8-sig") if isinstance(data, bytes) else data
    try:
        value = (
            json.loads(text, parse_constant=_no_number, parse_float=_finite) if finite else json.loads(text)
        )
        if _SURROGATE.search(text):  # half a character, which no file can hold
            json.dumps(value, ensure_ascii=False).encode()
    except RecursionError as error:
        raise ValueError("nested too deep") from error
    return value


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON number")


def _finite(text: str) -> float:
    value = float(text)
    return value if math.isfinite(value) else _no_number(text[:20])
