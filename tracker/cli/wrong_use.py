"""Wrong use of the command line in one line of our own words: what was expected, what came, where help is.

The library that takes arguments apart raises its own errors, in the words of programmers and in several lines.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from typing import Any

import typer

from ..errors import BendtrackError

USAGE_ERROR: Any = typer.BadParameter.__base__
"""Base class of the library's errors about arguments; which module it lives in depends on the library's version."""

_LIKE = 0.5
"""Similarity in [0, 1] from which a name is suggested; --minutes and --max-minutes have 0.78."""

# Words of the library's versions -> ours.
_EXPECTED: tuple[tuple[str, str], ...] = (
    (r"valid number|valid float", "a number"),
    (r"valid integer", "a whole number"),
    (r"valid boolean", "yes or no"),
    (r"less than or equal to (?P<bound>\S+)|in the range \S*<=(?P<most>[\d.]+)", "at most {}"),
    (r"greater than or equal to (?P<bound>\S+)|in the range \S+?>=(?P<least>[\d.]+)", "at least {}"),
)


class WrongUse(BendtrackError):
    """A command was called in a way that it cannot be."""


def is_help(error: Any) -> bool:
    """Whether an error of the library only shows the help, as where nothing was asked for.

    Parameters
    ----------
    error : USAGE_ERROR
        The library's error.
    """
    return type(error).__name__ == "NoArgsIsHelpError"


def in_one_line(error: Any, given: Sequence[str] = (), command: str = "bendtrack") -> str:
    """Put the library's error about arguments into one line.

    Parameters
    ----------
    error : USAGE_ERROR
        The library's error.
    given : sequence of str
        The words behind the command's name, to show what came.
    command : str
        What the command is called, where the error does not know.

    Returns
    -------
    str
        Such as "--max-minutes: expected a number, got 'five' (help: bendtrack train --help)".
    """
    path = error.ctx.command_path if error.ctx is not None else command
    return f"{_problem(error, given, path)} (help: {path} --help)"


@contextmanager
def in_our_words(args: Sequence[str], command: str = "bendtrack") -> Iterator[None]:
    """Turn the library's errors about arguments into `WrongUse`.

    Parameters
    ----------
    args : sequence of str
        The words that are taken apart; the library may empty the list.
    command : str
        As `in_one_line`'s.

    Raises
    ------
    WrongUse
        Some word is not what was expected.
    """
    given = list(args)
    try:
        yield
    except USAGE_ERROR as error:
        if is_help(error):
            raise
        raise WrongUse(in_one_line(error, given, command)) from error


def _problem(error: Any, given: Sequence[str], path: str) -> str:
    message = str(error.message or error.format_message()).strip().rstrip(".")
    kind = type(error).__name__
    if kind == "NoSuchOption":
        name = str(error.option_name)
        options = [option for param in error.ctx.command.params for option in param.opts] if error.ctx else []
        return f"expected an option of {path}, got {name}{_did_you_mean(name, options)}"
    unknown = re.match(r"No such command '([^']*)'", message)
    if unknown is not None:
        names = list(getattr(error.ctx.command, "commands", {})) if error.ctx else []
        return f"expected a command, got '{unknown[1]}'{_did_you_mean(unknown[1], names)}"
    param = getattr(error, "param", None)
    if kind == "MissingParameter" and param is not None:
        return f"expected {_called(param)}, got nothing"
    if param is not None:
        came = _came(param, given)
        got = "" if came is None else f", got '{came}'"
        return f"{_called(param)}: expected {_expected(message)}{got}"
    return message[:1].lower() + message[1:]


def _expected(message: str) -> str:
    choices = re.search(r"is not one of (.*)", message)
    if choices is not None:
        return f"one of {choices[1].replace(chr(39), '')}"
    for pattern, words in _EXPECTED:
        found = re.search(pattern, message)
        if found is not None:
            return words.format(next((part for part in found.groups() if part), ""))
    return f"something else ({message})"


def _called(param: Any) -> str:
    if param.param_type_name == "argument":
        return str(param.metavar or param.name.upper())
    return str(max(param.opts, key=len))


def _came(param: Any, given: Sequence[str]) -> str | None:
    """The word that an option was given, the last one where it was given more than once."""
    if param.param_type_name != "option":
        return None
    found = None
    for index, word in enumerate(given):
        name, equals, value = word.partition("=")
        if name in param.opts:
            found = value if equals else next(iter(given[index + 1 : index + 2]), None)
    return found


def _did_you_mean(name: str, names: Sequence[str]) -> str:
    """A question about the nearest name; nothing where none is near."""
    plain = {one.lstrip("-"): one for one in names}
    near = get_close_matches(name.lstrip("-"), plain, n=1, cutoff=_LIKE)
    return f": did you mean {plain[near[0]]}?" if near else ""
