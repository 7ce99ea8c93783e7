"""The history of all edits: an append-only file of JSON lines, and what can be undone according to it.

Applying an edit to the labels is `edits.py`. A line is on disk before the labels change; a second, short one says
that they have. A line that was cut short by a crash is passed over.
"""

from __future__ import annotations

import json
import os
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

from .frame_state import FrameState


class Deed(StrEnum):
    """What an entry did."""

    EDIT = "edit"
    UNDO = "undo"
    REDO = "redo"
    REPEAT = "repeat"


@dataclass(frozen=True)
class Entry:
    """One change of one frame.

    Attributes
    ----------
    deed : what it was
    edit_id : the page's name for it, unique
    client_id : whose history it belongs to
    video, image : the frame
    before, after : its states
    of : of an undo or redo, the `edit_id` of the edit meant
    repeat : of a repeat label, what is to be kept; `before` and `after` then are equal
    """

    deed: Deed
    edit_id: str
    client_id: str
    video: str
    image: str
    before: FrameState
    after: FrameState
    of: str | None = None
    repeat: Mapping[str, Any] | None = None

    def to_json(self) -> dict[str, Any]:
        """As one line says it."""
        return {
            "do": self.deed.value,
            "edit_id": self.edit_id,
            "client": self.client_id,
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "video": self.video,
            "image": self.image,
            "before": self.before.to_json(),
            "after": self.after.to_json(),
            **({} if self.of is None else {"of": self.of}),
            **({} if self.repeat is None else {"repeat": dict(self.repeat)}),
        }

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> Entry:
        """What `to_json` gave; KeyError, TypeError or ValueError for anything else."""
        return cls(
            Deed(value["do"]),
            value["edit_id"],
            value["client"],
            value["video"],
            value["image"],
            FrameState.from_json(value["before"]),
            FrameState.from_json(value["after"]),
            value.get("of"),
            value.get("repeat"),
        )


@dataclass(frozen=True)
class Outcome:
    """What became of an edit_id.

    Attributes
    ----------
    video, image : the frame
    conflict : it was an undo or redo that found the frame changed by someone else
    """

    video: str
    image: str
    conflict: bool = False


class Journal:
    """The journal file and what follows from it. Use it under the project's lock only.

    Attributes
    ----------
    outcomes : edit_id -> what became of it
    pending : the last entry, if it does not say whether the labels have followed
    latest : frames in the order of their latest edit, the newest last
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._forget()

    def _forget(self) -> None:
        self._offset = 0
        self._file: tuple[int, int] | None = None
        self.outcomes: dict[str, Outcome] = {}
        self.pending: Entry | None = None
        self.latest: dict[tuple[str, str], None] = {}
        self._undo: dict[str, list[Entry]] = defaultdict(list)
        self._redo: dict[str, list[Entry]] = defaultdict(list)

    def catch_up(self) -> None:
        """Read what other servers have added. A journal that was removed is a history that begins anew."""
        try:
            file = self._path.open("rb")
        except FileNotFoundError:
            self._forget()
            return
        with file:
            status = os.fstat(file.fileno())
            identity = (status.st_dev, status.st_ino)
            if self._file not in (None, identity) or status.st_size < self._offset:
                self._forget()
            self._file = identity
            if status.st_size == self._offset:
                return
            file.seek(self._offset)
            text = file.read()
        whole = text[: text.rfind(b"\n") + 1]
        self._offset += len(whole)
        for line in whole.splitlines():
            self._take(line)

    def begin(self, entry: Entry) -> None:
        """Write an entry to disk, to the last byte, before the labels change."""
        self._append(entry.to_json(), durable=True)

    def finish(self, entry: Entry) -> None:
        """Say that the labels have followed an entry."""
        # Not flushed: if a power failure loses the line, the next start finds the labels as the entry says.
        self._append({"done": entry.edit_id}, durable=False)

    def drop(self, entry: Entry) -> None:
        """Say that the labels have not followed and never will."""
        self._append({"dropped": entry.edit_id}, durable=True)

    def pass_over(self, deed: Deed, edit_id: str, client_id: str, entry: Entry) -> None:
        """Say that an entry can no longer be undone or redone, as someone else has changed its frame."""
        self._append(
            {"passed": deed.value, "edit_id": edit_id, "client": client_id, "of": entry.edit_id}, durable=True
        )

    def undoable(self, client_id: str) -> Entry | None:
        """The edit that this client's next undo takes back."""
        return self._last(self._undo, client_id)

    def redoable(self, client_id: str) -> Entry | None:
        """The edit that this client's next redo does again."""
        return self._last(self._redo, client_id)

    @staticmethod
    def _last(stacks: Mapping[str, list[Entry]], client_id: str) -> Entry | None:
        stack = stacks.get(client_id)
        return stack[-1] if stack else None

    def _append(self, record: Mapping[str, Any], *, durable: bool) -> None:
        is_new = not self._path.exists()
        descriptor = os.open(
            self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o600
        )
        try:
            size = os.fstat(descriptor).st_size
            line = json.dumps(record, separators=(",", ":")).encode() + b"\n"
            if size > self._offset:  # the rest of a line that a crash cut short
                line = b"\n" + line
            written = os.write(descriptor, line)
            if written != len(line):
                raise OSError(f"{self._path}: expected to write {len(line)} bytes, could write {written}")
            if durable:
                os.fsync(descriptor)
        finally:
            os.close(descriptor)
        if is_new and os.name == "posix":
            folder = os.open(self._path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
        self.catch_up()

    def _take(self, line: bytes) -> None:
        try:
            record = json.loads(line)
            if "do" in record:
                entry = Entry.from_json(record)
                self._settle()  # its "done" was lost in a power failure
                self.pending = entry
            elif "passed" in record:
                self._pass(record)
            elif self.pending is not None and record.get("done") == self.pending.edit_id:
                self._settle()
            elif self.pending is not None and record.get("dropped") == self.pending.edit_id:
                self.pending = None
        except (ValueError, KeyError, TypeError, AttributeError, IndexError):
            return  # cut short, or of a later version

    def _settle(self) -> None:
        """The pending entry has happened: it can be undone, and what was undone before it cannot be redone."""
        entry, self.pending = self.pending, None
        if entry is None:
            return
        self.outcomes[entry.edit_id] = Outcome(entry.video, entry.image)
        self.latest.pop((entry.video, entry.image), None)
        self.latest[entry.video, entry.image] = None
        undo, redo = self._undo[entry.client_id], self._redo[entry.client_id]
        if entry.deed is Deed.EDIT:
            undo.append(entry)
            redo.clear()
        elif entry.deed is not Deed.REPEAT:
            source, target = (undo, redo) if entry.deed is Deed.UNDO else (redo, undo)
            if source and source[-1].edit_id == entry.of:
                target.append(source.pop())

    def _pass(self, record: Mapping[str, Any]) -> None:
        self._settle()
        stacks = self._undo if Deed(record["passed"]) is Deed.UNDO else self._redo
        stack = stacks[record["client"]]
        if stack and stack[-1].edit_id == record["of"]:
            gone = stack.pop()
            self.outcomes[record["edit_id"]] = Outcome(gone.video, gone.image, conflict=True)
