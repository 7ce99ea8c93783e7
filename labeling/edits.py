"""Edits: each is checked against the state on disk, written at once, and recorded in the journal so it can be undone.

The order, under the project's lock: the journal's entry (fsync), the label file and the notes (temporary file, fsync,
rename), the journal's record that the entry is done. A server that is killed in between leaves an entry that is not
done. The next holder of the lock then writes the state that the entry gives.
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

# A thousandth of a px: finer than any labelling, short enough to read.
_DECIMALS = 3


@dataclass(frozen=True)
class Change:
    """The change of a frame that a page asks for. None leaves a field as it is.

    Attributes
    ----------
    points : mapping of str to Point or None
        Keypoint -> (x, y) px, None to remove the point. Points that are not named stay.
    not_visible : tuple of str or None
        All that are not visible; their points are taken away.
    """

    points: Mapping[str, Point | None]
    not_visible: tuple[str, ...] | None = None
    note: str | None = None
    flagged: bool | None = None
    skipped: bool | None = None

    def applied_to(self, state: FrameState) -> FrameState:
        """Return the changed state.

        Parameters
        ----------
        state : FrameState
            The state to change.

        Returns
        -------
        FrameState
            The new state. New positions are rounded; a point that stays keeps every digit.
        """
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
    """Outcome of an edit, an undo or a redo.

    Attributes
    ----------
    video, image : str
        The frame.
    conflict : bool
        Someone else had changed it; nothing was done.
    changed : bool
        The frame on disk is another now than before.
    """

    video: str
    image: str
    conflict: bool = False
    changed: bool = False


class Editor:
    """Changes frames, one change at a time, with undo and redo.

    Any number of editors, in any number of processes, can work on one project.

    Parameters
    ----------
    annotations : Annotations
        The project's frames.
    private : PrivateFolder
        Folder of the lock and the journal.
    """

    def __init__(self, annotations: Annotations, private: PrivateFolder) -> None:
        self._annotations = annotations
        self._private = private
        self._journal = Journal(private.path / "journal.jsonl")
        with self._ready():
            pass  # finishes an edit that a killed server has left

    def edit(
        self, video: str, image: str, change: Change, *, base_revision: int, edit_id: str, client_id: str
    ) -> Edited:
        """Change a frame, if its state is still the one that the page has seen.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.
        change : Change
            What to change.
        base_revision : int
            Revision of the state that the page has seen.
        edit_id : str
            Unique id of this edit; the same one again does nothing again.
        client_id : str
            Undo history that the edit goes into.

        Returns
        -------
        Edited
            What became of it.

        Raises
        ------
        KeyError
            There is no such frame.
        LabelError, OSError
            The files cannot be read or written. The next call may still carry out the edit.
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
        """Undo the client's latest edit. Raises what `edit` raises.

        An edit whose frame someone else has changed since is skipped, with a conflict.

        Parameters
        ----------
        edit_id : str
            Unique id of this undo; the same one again does nothing again.
        client_id : str
            Undo history.

        Returns
        -------
        Edited or None
            None when there is no edit to undo.
        """
        return self._step(Deed.UNDO, edit_id, client_id)

    def redo(self, *, edit_id: str, client_id: str) -> Edited | None:
        """Redo what the client's latest undo has undone. Raises what `edit` raises.

        Parameters
        ----------
        edit_id : str
            Unique id of this redo; the same one again does nothing again.
        client_id : str
            Undo history.

        Returns
        -------
        Edited or None
            None when there is nothing to redo.
        """
        return self._step(Deed.REDO, edit_id, client_id)

    def repeat(
        self, video: str, image: str, repeat: Mapping[str, Any], *, edit_id: str, client_id: str
    ) -> None:
        """Store a repeat label of a frame. Raises what `edit` raises.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.
        repeat : mapping of str to Any
            The repeat label as it is stored in the notes.
        edit_id : str
            Unique id; the same one again does nothing again.
        client_id : str
            The page.
        """
        with self._ready():
            state = self._state(video, image)
            if state is None:
                raise KeyError(f"{video}/{image}")
            if edit_id not in self._journal.outcomes:
                self._carry_out(
                    Entry(Deed.REPEAT, edit_id, client_id, video, image, state, state, repeat=repeat)
                )

    def recently_edited(self, count: int) -> set[tuple[str, str]]:
        """Return the (video, image) of the frames that were edited last, at most `count`."""
        with self._ready():
            return set(list(self._journal.latest)[-count:])

    def was_done(self, edit_id: str) -> bool:
        """Whether the edit of this id has been carried out."""
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
                self._journal.skip(deed, edit_id, client_id, of)
                if state is not None:
                    return Edited(of.video, of.image, conflict=True)
                # Its image is gone, so there is nothing to show: continue with the edit before.

    @contextmanager
    def _ready(self) -> Iterator[None]:
        """Hold the lock, with all earlier edits finished."""
        with self._private.lock():
            self._journal.catch_up()
            pending = self._journal.pending
            if pending is not None:
                self._recover(pending)
            yield

    def _recover(self, entry: Entry) -> None:
        """Write the state that an unfinished entry gives, unless someone else has changed the frame."""
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
    """Whether a state mixes an entry's two states: the server was killed before, between or after its writes."""
    ends = (entry.before, entry.after)
    # `not_visible` depends on both files: a point in the label file overrules an entry of the notes.
    named = {name for end in ends for name in end.not_visible}
    return (
        any(state.points == end.points for end in ends)
        and named.issuperset(state.not_visible)
        and any((state.note, state.flagged, state.skipped) == (e.note, e.flagged, e.skipped) for e in ends)
    )
