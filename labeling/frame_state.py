"""What people have said about one frame: its points, what is not visible, a note, flags; and its revision.

Where that lies on disk is in `annotations.py`; how it changes in `edits.py`.
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
    """How far a frame is."""

    UNLABELLED = "unlabelled"
    PARTIAL = "partial"
    LABELLED = "labelled"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class FrameState:
    """All that is known of a frame from people.

    Attributes
    ----------
    points : keypoint -> (x, y) px; those that are not placed are left out
    not_visible : keypoints that cannot be seen in the frame, in the project's order; none of them has a point
    note : free text
    flagged : to be looked at again
    skipped : not to be labelled
    """

    points: Mapping[str, Point] = field(default_factory=dict)
    not_visible: tuple[str, ...] = ()
    note: str = ""
    flagged: bool = False
    skipped: bool = False

    @cached_property
    def revision(self) -> int:
        """An integer below 2^52, which JavaScript holds exactly, made from the contents.

        States are equal exactly when their revisions are. Nothing is counted, so it holds across servers,
        restarts, and other programs that write the files.
        """
        text = json.dumps(self.to_json(), sort_keys=True)
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 12

    def progress(self, keypoints: Sequence[str]) -> Progress:
        """How far it is, for these keypoints."""
        settled = sum(name in self.points or name in self.not_visible for name in keypoints)
        if self.skipped:
            return Progress.SKIPPED
        if settled == len(keypoints):
            return Progress.LABELLED
        return Progress.PARTIAL if settled else Progress.UNLABELLED

    def to_json(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {
            "points": {name: [x, y] for name, (x, y) in self.points.items()},
            "not_visible": sorted(self.not_visible),
            "note": self.note,
            "flagged": self.flagged,
            "skipped": self.skipped,
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> FrameState:
        """What `to_json` gave; KeyError, TypeError or ValueError for anything else."""
        return cls(
            points_from_json(value["points"]),
            tuple(str(name) for name in value["not_visible"]),
            str(value["note"]),
            bool(value["flagged"]),
            bool(value["skipped"]),
        )


def points_from_json(value: Mapping[str, Any]) -> dict[str, Point]:
    """Points {keypoint: [x, y]} as they stand in JSON; those that are null are left out."""
    return {str(name): (float(xy[0]), float(xy[1])) for name, xy in value.items() if xy is not None}
