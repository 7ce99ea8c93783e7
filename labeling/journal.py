"""The journal of all edits: an append-only file of JSON lines, and the undo histories that follow from it.

Edits are applied in `edits.py`. An entry is on disk before the labels change; a second, short line records that they
have changed. A line that was truncated by a crash is skipped.
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

from ..tracker.links import open_own_file
from .frame_state import FrameState


class Deed(StrEnum):
    """Kind of an entry."""

    EDIT = "edit"
    UNDO = "undo"
    REDO = "redo"
    REPEAT = "repeat"


@dataclass(frozen=True)
class Entry:
    """One change of one frame.

    Attributes
    ----------
    deed : Deed
        Its kind.
    edit_id : str
        Unique id, given by the page.
    client_id : str
        Undo history that it belongs to.
    video, image : str
        The frame.
    before, after : FrameState
        Its states before and after the change.
    of : str or None
        For an undo or redo, the `edit_id` of the edit that is undone or redone.
    repeat : mapping of str to Any or None
        For a repeat label, what to store; `before` and `after` are then equal.
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
        """Return the contents of the entry's line."""
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
        """Read what `to_json` has returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            The value is anything else.
        """
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
    """Outcome of an edit.

    Attributes
    ----------
    video, image : str
        The frame.
    conflict : bool
        Whether it was an undo or redo of a frame that someone else had changed.
    """

    video: str
    image: str
    conflict: bool = False


class Journal:
    """The journal file and the undo histories. Use it under the project's lock only.

    Parameters
    ----------
    path : Path
        The journal file; it need not exist yet.

    Attributes
    ----------
    outcomes : dict of str to Outcome
        `edit_id` -> its outcome.
    pending : Entry or None
        The last entry, while it is not recorded whether the labels have been written.
    latest : dict of tuple of str to None
        Frames in the order of their latest edit, the newest last.
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
        """Read what other servers have appended. If the file was removed, the histories start anew.

        Raises
        ------
        OSError
            It cannot be read, or is a link: what is read here is appended to.
        """
        try:
            descriptor = open_own_file(self._path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        except FileNotFoundError:
            self._forget()
            return
        with open(descriptor, "rb") as file:
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
        """Append an entry and flush it to disk, before the labels change."""
        self._append(entry.to_json(), durable=True)

    def finish(self, entry: Entry) -> None:
        """Record that the labels of an entry have been written."""
        # Not flushed: if a power failure loses the line, the next start finds the labels as the entry says.
        self._append({"done": entry.edit_id}, durable=False)

    def drop(self, entry: Entry) -> None:
        """Record that the labels of an entry have not been written and never will be."""
        self._append({"dropped": entry.edit_id}, durable=True)

    def skip(self, deed: Deed, edit_id: str, client_id: str, entry: Entry) -> None:
        """Record that an entry can no longer be undone or redone, as someone else has changed its frame.

        Parameters
        ----------
        deed : Deed
            UNDO or REDO.
        edit_id : str
            Id of the undo or redo.
        client_id : str
            Undo history.
        entry : Entry
            The entry to skip.
        """
        self._append(
            {"passed": deed.value, "edit_id": edit_id, "client": client_id, "of": entry.edit_id}, durable=True
        )

    def undoable(self, client_id: str) -> Entry | None:
        """Return the edit that this client's next undo undoes, None without one."""
        return self._last(self._undo, client_id)

    def redoable(self, client_id: str) -> Entry | None:
        """Return the edit that this client's next redo redoes, None without one."""
        return self._last(self._redo, client_id)

    @staticmethod
    def _last(stacks: Mapping[str, list[Entry]], client_id: str) -> Entry | None:
        stack = stacks.get(client_id)
        return stack[-1] if stack else None

    def _append(self, record: Mapping[str, Any], *, durable: bool) -> None:
        is_new = not self._path.exists()
        descriptor = open_own_file(
            self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        )
        try:
            size = os.fstat(descriptor).st_size
            line = json.dumps(record, separators=(",", ":")).encode() + b"\n"
            if size > self._offset:  # part of a line that a crash has truncated
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
            return  # truncated, or of a later version

    def _settle(self) -> None:
        """Accept the pending entry: it can be undone, and what was undone before it cannot be redone."""
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
