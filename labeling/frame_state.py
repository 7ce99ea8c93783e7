"""The state of one frame as labelled by people: points, keypoints that are not visible, note, flags, and revision.

Its files are read and written in `annotations.py`; changes are in `edits.py`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

from .label_table import Point


class Progress(StrEnum):
    """Progress of labelling one frame."""

    UNLABELLED = "unlabelled"
    PARTIAL = "partial"
    LABELLED = "labelled"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class FrameState:
    """All annotations of one frame.

    Attributes
    ----------
    points : mapping of str to Point
        Keypoint -> (x, y) px; keypoints that are not placed are left out.
    not_visible : tuple of str
        Keypoints that cannot be seen in the frame, in the project's order; none of them has a point.
    note : str
        Free text.
    flagged : bool
        Whether it is to be looked at again.
    skipped : bool
        Whether it is not to be labelled.
    """

    points: Mapping[str, Point] = field(default_factory=dict)
    not_visible: tuple[str, ...] = ()
    note: str = ""
    flagged: bool = False
    skipped: bool = False

    @cached_property
    def revision(self) -> int:
        """Hash of the contents: an integer below 2^52, which JavaScript represents exactly.

        Two states are equal exactly when their revisions are. It is not a counter, so it is valid across servers,
        restarts, and other programs that write the files.
        """
        text = json.dumps(self.to_json(), sort_keys=True)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 12

    def progress(self, keypoints: Sequence[str]) -> Progress:
        """Return the frame's progress.

        Parameters
        ----------
        keypoints : sequence of str
            Keypoints that are to be placed or marked as not visible.

        Returns
        -------
        Progress
            SKIPPED, LABELLED where all keypoints are settled, PARTIAL where some are, else UNLABELLED.
        """
        settled = sum(name in self.points or name in self.not_visible for name in keypoints)
        if self.skipped:
            return Progress.SKIPPED
        if settled == len(keypoints):
            return Progress.LABELLED
        return Progress.PARTIAL if settled else Progress.UNLABELLED

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "points": {name: [x, y] for name, (x, y) in self.points.items()},
            "not_visible": sorted(self.not_visible),
            "note": self.note,
            "flagged": self.flagged,
            "skipped": self.skipped,
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> FrameState:
        """Read what `to_json` has returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            The value is anything else.
        """
        return cls(
            points_from_json(value["points"]),
            tuple(str(name) for name in value["not_visible"]),
            str(value["note"]),
            bool(value["flagged"]),
            bool(value["skipped"]),
        )


def points_from_json(value: Mapping[str, Any]) -> dict[str, Point]:
    """Read points {keypoint: [x, y]} of JSON; points that are null are left out."""
    return {str(name): (float(xy[0]), float(xy[1])) for name, xy in value.items() if xy is not None}
