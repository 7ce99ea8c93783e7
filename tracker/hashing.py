"""SHA-256 of files, by which videos, checkpoints, logs and results are known whatever they are called."""

from __future__ import annotations

import hashlib
from pathlib import Path


def file_sha256(path: str | Path) -> str:
    """Hash a file; it is read in pieces, so memory does not grow with it.

    Parameters
    ----------
    path : str or Path
        An existing file.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    OSError
        The file cannot be read.
    """
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
