"""TOML files written by users: read whatever editor wrote them, each mistake reported in one line.

The keys of each file are defined by the pydantic models of `project_settings.py` and `study/study_file.py`.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from .errors import BendtrackError, reason

# TOML names of what pydantic calls by its Python name.
_IN_TOML = {"dict_type": "a [section]", "model_type": "a [section]", "tuple_type": "a list"}

# A study of a thousand trials has 0.3 MB.
MAX_BYTES = 2**24


class Section(BaseModel):
    """A section of a file: unknown keys are refused, and no value is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


def toml_text(path: Path, error: type[BendtrackError]) -> str:
    """Text of a TOML file that is known to parse. Windows editors may have put a byte order mark in front.

    Parameters
    ----------
    path : Path
        The file.
    error : type[BendtrackError]
        Class of the error to raise.

    Returns
    -------
    str
        The text, with Unix newlines.

    Raises
    ------
    error
        Not UTF-8, not TOML (with the line), or too large.
    OSError
        The file cannot be read.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise error(f"{path}: expected settings of at most {MAX_BYTES / 1e6:.0f} MB, got {size / 1e6:.1f} MB")
    try:
        text = path.read_bytes().decode("utf-8-sig").replace("\r\n", "\n")
        value = tomllib.loads(text)
    except UnicodeDecodeError as mistake:
        raise error(f"{path}: expected UTF-8 text, got a byte that is not at {mistake.start}") from mistake
    except RecursionError as mistake:
        raise error(f"{path}: expected TOML, got one nested too deep") from mistake
    except ValueError as mistake:  # TOMLDecodeError, and what int() and datetime() say of their texts
        raise error(f"{path}: expected TOML, got a mistake: {reason(mistake)}") from mistake
    if "\\u0000" in text.lower() and _holds_nul(value):
        raise error(f"{path}: expected text, got a character of value 0 in it")
    return text


def _holds_nul(value: Any) -> bool:
    """Whether a text in nested sections and lists holds the character that no file name can hold."""
    if isinstance(value, dict):
        return any(_holds_nul(item) for pair in value.items() for item in pair)
    if isinstance(value, list):
        return any(map(_holds_nul, value))
    return isinstance(value, str) and "\0" in value


def validation_message(error: ValidationError, model: type[BaseModel]) -> str:
    """The first mistake in a file of this model (key, what was expected, what was found), and the number of others.

    Parameters
    ----------
    error : ValidationError
        What pydantic raised.
    model : type[BaseModel]
        The model that the file was validated against.

    Returns
    -------
    str
        One line.
    """
    # A key that is not known first: it may be what another, missing, was meant to be.
    mistakes = sorted(error.errors(), key=lambda mistake: mistake["type"] != "extra_forbidden")
    more = f" (and {len(mistakes) - 1} more)" if len(mistakes) > 1 else ""
    return f"{_message(mistakes[0], model)}{more}"


def _message(mistake: ErrorDetails, model: type[BaseModel]) -> str:
    key = _key(mistake["loc"])
    if mistake["type"] == "extra_forbidden":
        allowed = _keys_of(model, mistake["loc"][:-1])
        close = difflib.get_close_matches(str(mistake["loc"][-1]), allowed, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        return f"unknown key '{key}'{hint}; expected one of {', '.join(allowed)}"
    if mistake["type"] == "missing":
        return f"expected the key '{key}', got none"
    message = mistake["msg"].replace("Input should be", "expected")
    if mistake["type"] in _IN_TOML:
        message = f"expected {_IN_TOML[mistake['type']]}"
    if "url" not in mistake:  # messages of our own validators are complete
        return f"{key}: {message}" if key else message
    return f"{key}: {message}, got {mistake['input']!r}"


def _key(location: tuple[int | str, ...]) -> str:
    """Where a mistake is, as in the file; entries of a list are counted from 1.

    >>> _key(("trials", 2, "kind"))
    'trials[3].kind'
    """
    parts = [f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in location]
    return "".join(parts).removeprefix(".")


def _keys_of(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys that the section at a location may have."""
    section: Any = model
    for part in location:
        if _is_model(section):
            section = section.model_fields[part].annotation
            choices = get_args(section)
            if type(None) in choices:  # an optional section is that section
                section = choices[0]
        else:  # an entry of a list or of a table of sections
            section = next(one for one in get_args(section) if _is_model(one))
    return list(section.model_fields)


def _is_model(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)
