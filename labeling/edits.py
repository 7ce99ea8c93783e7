"""Edits: each is checked against what is on disk, written there at once, and kept in the journal to be undone.

Under the project's lock, in this order: the journal's line (fsync), the label file and the notes (temporary file,
fsync, rename), the journal's word that it is done. A server that is killed in between leaves the line without the
word; whoever takes the lock next brings the labels into the state that the line says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from .annotations import Annotations
from .frame_state import FrameState
from .journal import Deed, Entry, Journal
from .label_table import Point
from .private_folder import PrivateFolder

# A thousandth of a pixel: finer than anyone points, coarse enough to be read.
_DECIMALS = 3


@dataclass(frozen=True)
class Change:
    """What a page asks for. None leaves a thing as it is.

    Attributes
    ----------
    points : keypoint -> position px, or None to take it away; those not named stay
    not_visible : all that are not visible; their points are taken away
    """

    points: Mapping[str, Point | None]
    not_visible: tuple[str, ...] | None = None
    note: str | None = None
    flagged: bool | None = None
    skipped: bool | None = None

    def applied_to(self, state: FrameState) -> FrameState:
        """The state that is asked for. New positions are rounded; a point that stays keeps every digit."""
        points = dict(state.points)
        for name, point in self.points.items():
            if point is None:
                points.pop(name, None)
            elif points.get(name) != point:
                x, y = point
                points[name] = (round(x, _DECIMALS) + 0.0, round(y, _DECIMALS) + 0.0)  # no -0.0
        hidden = state.not_visible if self.not_visible is None else self.not_visible
        placed_now = {name for name, point in self.points.items() if point is not None}
        if self.not_visible is None:
            hidden = tuple(name for name in hidden if name not in placed_now)
        changes: dict[str, Any] = {
            name: value
            for name, value in (("note", self.note), ("flagged", self.flagged), ("skipped", self.skipped))
            if value is not None
        }
        points = {name: point for name, point in points.items() if name not in hidden}
        return replace(state, points=points, not_visible=hidden, **changes)


@dataclass(frozen=True)
class Edited:
    """How an edit, an undo or a redo ended.

    Attributes
    ----------
    video, image : the frame
    conflict : someone else had changed it; nothing was done
    changed : the frame on disk is another now than before
    """

    video: str
    image: str
    conflict: bool = False
    changed: bool = False


class Editor:
    """Changes frames, one change at a time, with a memory.

    Any number of editors, in any number of processes, can work on one project.
    """

    def __init__(self, annotations: Annotations, private: PrivateFolder) -> None:
        self._annotations = annotations
        self._private = private
        self._journal = Journal(private.path / "journal.jsonl")
        with self._ready():
            pass  # what a killed server left undone

    def edit(
        self, video: str, image: str, change: Change, *, base_revision: int, edit_id: str, client_id: str
    ) -> Edited:
        """Change a frame, if it still is what the page has seen.

        Parameters
        ----------
        base_revision : of the state that the page has seen
        edit_id : the same one again does nothing again
        client_id : whose undo history it goes into

        Raises
        ------
        KeyError
            There is no such frame.
        LabelError, OSError
            The files cannot be read or written. The edit may still be carried out by the next call.
        """
        with self._ready():
            before = self._state(video, image)
            if before is None:
                raise KeyError(f"{video}/{image}")
            if edit_id in self._journal.outcomes:
                return Edited(video, image)
            after = change.applied_to(before)
            if after == before:
                return Edited(video, image)
            if base_revision != before.revision:
                return Edited(video, image, conflict=True)
            self._carry_out(Entry(Deed.EDIT, edit_id, client_id, video, image, before, after))
        return Edited(video, image, changed=True)

    def undo(self, *, edit_id: str, client_id: str) -> Edited | None:
        """Take back the client's latest edit; None when there is none. Errors as in `edit`.

        One whose frame someone else has changed since is passed over, with a conflict.
        """
        return self._step(Deed.UNDO, edit_id, client_id)

    def redo(self, *, edit_id: str, client_id: str) -> Edited | None:
        """Do again what the client's latest undo took back; otherwise as `undo`."""
        return self._step(Deed.REDO, edit_id, client_id)

    def repeat(
        self, video: str, image: str, repeat: Mapping[str, Any], *, edit_id: str, client_id: str
    ) -> None:
        """Keep a repeat label of a frame. Errors as in `edit`."""
        with self._ready():
            state = self._state(video, image)
            if state is None:
                raise KeyError(f"{video}/{image}")
            if edit_id not in self._journal.outcomes:
                self._carry_out(
                    Entry(Deed.REPEAT, edit_id, client_id, video, image, state, state, repeat=repeat)
                )

    def lately_edited(self, count: int) -> set[tuple[str, str]]:
        """The (video, image) that were edited last, at most `count`."""
        with self._ready():
            return set(list(self._journal.latest)[-count:])

    def was_done(self, edit_id: str) -> bool:
        """Whether an edit of that name has been carried out."""
        with self._ready():
            return edit_id in self._journal.outcomes

    def _step(self, deed: Deed, edit_id: str, client_id: str) -> Edited | None:
        with self._ready():
            if edit_id in self._journal.outcomes:
                first = self._journal.outcomes[edit_id]
                return Edited(first.video, first.image, conflict=first.conflict)
            while True:
                of = (self._journal.undoable if deed is Deed.UNDO else self._journal.redoable)(client_id)
                if of is None:
                    return None
                before, after = (of.after, of.before) if deed is Deed.UNDO else (of.before, of.after)
                state = self._state(of.video, of.image)
                if state == before:
                    self._carry_out(
                        Entry(deed, edit_id, client_id, of.video, of.image, before, after, of.edit_id)
                    )
                    return Edited(of.video, of.image, changed=True)
                self._journal.pass_over(deed, edit_id, client_id, of)
                if state is not None:
                    return Edited(of.video, of.image, conflict=True)
                # Its picture is gone: nothing to show, so on to the one before.

    @contextmanager
    def _ready(self) -> Iterator[None]:
        """Hold the lock, with nothing left undone."""
        with self._private.lock():
            self._journal.catch_up()
            pending = self._journal.pending
            if pending is not None:
                self._recover(pending)
            yield

    def _recover(self, entry: Entry) -> None:
        """Bring the labels into the state that an unfinished entry says, unless someone else has changed them."""
        state = self._state(entry.video, entry.image)
        if state is not None and _lies_between(state, entry):
            self._apply(entry, state)
            self._journal.finish(entry)
        else:
            self._journal.drop(entry)

    def _carry_out(self, entry: Entry) -> None:
        self._journal.begin(entry)
        self._apply(entry, entry.before)
        self._journal.finish(entry)

    def _apply(self, entry: Entry, state: FrameState) -> None:
        if entry.repeat is not None:
            self._annotations.write_repeat(entry.video, entry.image, entry.repeat)
        else:
            self._annotations.write(entry.video, entry.image, state, entry.after)

    def _state(self, video: str, image: str) -> FrameState | None:
        folder = self._annotations.folder(video)
        return None if folder is None else folder.states.get(image)


def _lies_between(state: FrameState, entry: Entry) -> bool:
    """Whether a state has only what an entry's two states have: it was killed before, between or after its writes."""
    ends = (entry.before, entry.after)
    # What is not visible depends on both files: a point in one overrules a word in the other.
    named = {name for end in ends for name in end.not_visible}
    return (
        any(state.points == end.points for end in ends)
        and named.issuperset(state.not_visible)
        and any((state.note, state.flagged, state.skipped) == (e.note, e.flagged, e.skipped) for e in ends)
    )
