"""What bendtrack says of a film, held against the truth: right, said, silent, or a bug."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from bendtrack.tracker.errors import BendtrackError
from bendtrack.tracker.tracking import track

from .scene import ANGLE, DiscDetector, angle_deg

LARGEST_ERROR_DEG = 1.0
COUNTED = "no presentation times"
"""In the warning that times are counted, not read."""


class Verdict(StrEnum):
    """Of one film, the worst that applies."""

    RIGHT = "right"
    SAID = "said"
    SILENT = "silent"
    SHORT = "short"
    TRACEBACK = "traceback"


@dataclass(frozen=True)
class Judged:
    """What became of a film.

    Attributes
    ----------
    verdict : Verdict
        Right: nothing is missing, wrong or said. Said: flags, warnings or one line. Silent: a row without a flag is
        wrong. Short: frames are missing without a word. Traceback: an error that is not for users.
    rows, flagged, wrong : int
        Rows, rows with a flag, rows without a flag that are wrong by more than `LARGEST_ERROR_DEG`.
    worst_deg : float
        The largest error of a row without a flag, degrees.
    complete : bool
        Whether the film counts as undamaged.
    words : list of str
        Warnings, or the error.
    """

    verdict: Verdict
    rows: int = 0
    flagged: int = 0
    wrong: int = 0
    worst_deg: float = 0.0
    complete: bool = True
    words: list[str] = field(default_factory=list)


def judge(path: Path, times_s: np.ndarray) -> Judged:
    """Track a film that shows the scene, and hold every row against the truth.

    Parameters
    ----------
    path : Path
        The film.
    times_s : ndarray of float
        When each frame of the sound film is shown, s.
    """
    try:
        table = track(path, DiscDetector(), ANGLE, video_sha256="0")
    except BendtrackError as error:
        return Judged(Verdict.SAID, complete=False, words=[str(error)])
    except Exception as error:
        return Judged(Verdict.TRACEBACK, complete=False, words=[f"{type(error).__name__}: {error}"])
    words, complete = list(table.provenance["warnings"]), bool(table.provenance["video"]["complete"])
    sound = table.flag == ""
    # Times are those of the true frames: the angle at the nearest one is what the row should say.
    shown_s = times_s - times_s[0]
    nearest = np.abs(table.time_s[:, None] - shown_s).argmin(axis=1)
    if any(COUNTED in word for word in words):  # then only the order of frames can be right
        nearest = np.minimum(np.arange(len(table)), len(shown_s) - 1)
    error_deg = np.abs(table.angle_deg - angle_deg(shown_s[nearest]))
    error_deg = np.where(np.isnan(error_deg), np.inf, error_deg)[sound]
    wrong = int((error_deg > LARGEST_ERROR_DEG).sum())
    flagged = int((~sound).sum())
    if wrong:
        verdict = Verdict.SILENT
    elif len(table) != len(times_s) and not words:
        verdict = Verdict.SHORT
    elif words or flagged:
        verdict = Verdict.SAID
    else:
        verdict = Verdict.RIGHT
    return Judged(verdict, len(table), flagged, wrong, float(error_deg.max(initial=0.0)), complete, words)
