"""Packages that not every installation has: what lacks one says which, and how to install it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

from .errors import MissingPackageError

TRAINING_PACKAGES = ("torch", "torchvision", "nncf")
"""Needed to train, and to compile a network for a machine; tracking with a compiled network does without."""


def install_command(extra: str = "") -> str:
    """The command that installs bendtrack with an extra; it is run in a copy of the repository.

    Parameters
    ----------
    extra : str
        Name of the extra, empty for none.

    Examples
    --------
    >>> install_command("sleap")
    "in the copy of the repository run .venv/bin/pip install '.[sleap]'"
    """
    what = f"'.[{extra}]'" if extra else "."
    # Not `pip install bendtrack`: the package index has none, or somebody else's.
    return f"in the copy of the repository run .venv/bin/pip install {what}"


@contextmanager
def needed(what: str, packages: tuple[str, ...], install: str) -> Iterator[None]:
    """Turn the failing import of an optional package into one line for people.

    Parameters
    ----------
    what : str
        What cannot be done without, as the subject of a sentence.
    packages : tuple of str
        Top-level modules that may be missing.
    install : str
        The command that installs them.

    Raises
    ------
    MissingPackageError
        One of the modules is not installed.

    Examples
    --------
    >>> with needed("to_nothing()", ("no_such_module",), "pip install nothing"):  # doctest: +ELLIPSIS
    ...     import no_such_module
    Traceback (most recent call last):
    bendtrack.tracker.errors.MissingPackageError: to_nothing() needs no_such_module, which is ...
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in packages:
            raise
        raise MissingPackageError(f"{what} needs {missing}, which is not installed: {install}") from error


def training_packages_needed(what: str) -> AbstractContextManager[None]:
    """`needed` for torch and what comes with it, which `requirements/track-only.txt` leaves out.

    Parameters
    ----------
    what : str
        What cannot be done without, as the subject of a sentence.
    """
    return needed(what, TRAINING_PACKAGES, install_command())
