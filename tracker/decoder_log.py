"""What FFmpeg says while it reads and decodes: its own log, call by call, for one thread.

FFmpeg conceals errors and goes on; often its log is the only place where it says so. What follows from a line for
the rows of a video is decided in `decoding.py`.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import av

# Below errors, FFmpeg mixes habits of encoders with damage. These are damage.
_WARNINGS_OF_DAMAGE = (
    "Skipping invalid",
    "EOI missing",
    "ignoring overflow",
    "CABAC_MAX_BIN",
    "Packet corrupt",
)
# Errors that sound films give, too: a stream that is joined in the middle, or written by a careless recorder.
_ERRORS_OF_SOUND_FILMS = (
    *("co located POCs unavailable", "mmco: unref short failure", "number of reference frames"),
    *("deprecated pixel format", "Could not find codec parameters", "DTS", "non monoton", "Late SEI"),
    *("SEI type", "unknown SEI", "sps_id", "reference picture missing during reorder"),
)


def listen() -> None:
    """Let FFmpeg tell PyAV what it logs: once for the process, unless somebody has set it up already."""
    if av.logging.get_level() is None:
        # Python would print what nobody captures, such as notes of encoders.
        logging.getLogger("libav").addHandler(logging.NullHandler())
        av.logging.set_level(av.logging.WARNING)
    av.logging.set_skip_repeated(False)  # each call is asked for itself


def complaints(logs: Sequence[tuple[int, str, str]]) -> list[str]:
    """The lines of a captured log that speak of damage.

    Parameters
    ----------
    logs : sequence of (int, str, str)
        Level, part of FFmpeg, and message, as `av.logging.Capture` collects them.

    Returns
    -------
    list of str
        Messages without line ends.
    """
    found = []
    for level, _, message in logs:
        text = message.strip()
        if any(part in text for part in _WARNINGS_OF_DAMAGE) or (
            level <= av.logging.ERROR and not any(part in text for part in _ERRORS_OF_SOUND_FILMS)
        ):
            found.append(text)
    return found
