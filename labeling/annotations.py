"""Annotations: the state of every frame of a project, read from labeled-data/ as it is on disk.

Labels come from `store.py`, all else from `notes_file.py`; here the two become one `FrameState`. Links that lead
out of the project are not followed.
"""

from __future__ import annotations

import os
import stat
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ..tracker.errors import BendtrackError, LabelError
from ..tracker.project import SETTINGS_FILE, Project
from .frame_state import FrameState
from .notes_file import NOTES_FILE, NotesEntry, read_notes, write_notes
from .store import IMAGE_SUFFIXES, LabelStore, frame_index, sorted_by_frame

_Stamp = tuple[str, int, int, int]


@dataclass(frozen=True)
class ImageFile:
    """An image file in a video's folder.

    Attributes
    ----------
    path : Path
        The file.
    stamp : str
        Made of modification time and size, so that it changes when the file does.
    """

    path: Path
    stamp: str

    @property
    def name(self) -> str:
        """File name."""
        return self.path.name

    @cached_property
    def frame(self) -> int | None:
        """Index of the frame in its video, None where the name gives none."""
        return frame_index(self.path.name)


@dataclass(frozen=True)
class VideoFolder:
    """One folder of labeled-data/, as it was at one moment.

    Attributes
    ----------
    video : str
        Stem of the video, the folder's name.
    images : mapping of str to ImageFile
        Image name -> file, in the order of the frames.
    states : mapping of str to FrameState
        Image name -> state of the frame, for every image.
    repeats : mapping of str to mapping of str to Any
        Image name -> its repeat label as it is in the notes, where there is one.
    """

    video: str
    images: Mapping[str, ImageFile]
    states: Mapping[str, FrameState]
    repeats: Mapping[str, Mapping[str, Any]]


def by_actuator(project: Project, folders: Iterable[VideoFolder]) -> dict[str, list[VideoFolder]]:
    """Group videos' folders by the actuator that they show.

    Parameters
    ----------
    project : Project
        Which says what a video shows.
    folders : iterable of VideoFolder
        Folders of the project.

    Returns
    -------
    dict of str to list of VideoFolder
        By the actuators' names, sorted.
    """
    found: dict[str, list[VideoFolder]] = {}
    for folder in folders:
        found.setdefault(project.actuator_of(folder.video), []).append(folder)
    return dict(sorted(found.items()))


class Annotations:
    """Reads and writes frame states. Files that have not changed on disk are not read again.

    Parameters
    ----------
    project : Project
        The project; its settings are read again when bendtrack.toml has changed.
    lock : callable, optional
        Returns a context that is held while files are read, so that none is read between two writes of one
        edit. A caller that writes nothing can leave it out.
    check_reachable : callable, optional
        Raises an error while the project's folder is away: a frame that is not found then may still be there.

    Raises
    ------
    LabelError
        labeled-data/ is a link that leads out of the project.
    """

    def __init__(
        self,
        project: Project,
        lock: Callable[[], AbstractContextManager[None]] = nullcontext,
        check_reachable: Callable[[], None] = lambda: None,
    ) -> None:
        self._lock = lock
        self._check_reachable = check_reachable
        self._root = Path(os.path.realpath(project.root))
        self.project, self.store = project, LabelStore.of(project)
        self._known_settings_mtime = self._settings_mtime()
        self._cache: dict[str, tuple[tuple[_Stamp, ...], VideoFolder]] = {}
        self._cache_lock = threading.Lock()
        self._had_videos = False
        if not self._is_inside(project.labels_dir):
            raise LabelError(
                f"expected {project.labels_dir} within the project, got a link to"
                f" {os.path.realpath(project.labels_dir)}"
            )

    def refresh(self) -> None:
        """Read bendtrack.toml again if it has changed (other commands write it) and is valid."""
        stamp = self._settings_mtime()
        if stamp == self._known_settings_mtime:
            return
        try:
            project = Project.open(self.project.root)
        except BendtrackError:
            return
        self.project, self.store = project, LabelStore.of(project)
        self._known_settings_mtime = stamp
        with self._cache_lock:
            self._cache.clear()

    def videos(self) -> list[str]:
        """Return the stems of the videos that have a folder within the project, sorted.

        Raises
        ------
        LabelError
            The project's folder, or its labeled-data/, is away.
        """
        self._check_reachable()
        names = [
            name
            for name in self.store.videos()
            if _is_text(name) and self._is_inside(self.store.labels_dir / name)
        ]
        if names:
            self._had_videos = True
        elif self._had_videos and not self.store.labels_dir.is_dir():
            self._check_reachable()  # its reason is the better one
            raise LabelError(f"expected {self.store.labels_dir}, got no such folder; it was there before")
        return names

    def folder(self, video: str) -> VideoFolder | None:
        """Return one video's folder.

        Parameters
        ----------
        video : str
            Stem of the video.

        Returns
        -------
        VideoFolder or None
            None where there is no such video.
        Raises
        ------
        LabelError
            A label file or the notes are malformed, or a link out of the project.
        """
        if video in self.videos():
            return self._folder(video)
        self._check_reachable()  # gone for good, or only with the whole folder?
        return None

    def folders(self) -> list[VideoFolder]:
        """Return all videos' folders, by name. Raises what `folder` raises."""
        return [self._folder(video) for video in self.videos()]

    def _folder(self, video: str) -> VideoFolder:
        stamps = self._stamps(self.store.labels_dir / video)
        with self._cache_lock:
            known = self._cache.get(video)
        if known is not None and known[0] == stamps:
            return known[1]
        with self._lock():
            stamps = self._stamps(self.store.labels_dir / video)
            folder = self._read(video, stamps)
        with self._cache_lock:
            self._cache[video] = (stamps, folder)
        return folder

    def write(self, video: str, image: str, before: FrameState, after: FrameState) -> None:
        """Write the difference between two states of a frame.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.
        before, after : FrameState
            State on disk, and the state to write. What is equal in both is not written.
        Raises
        ------
        LabelError
            A file is malformed.
        OSError
            A file cannot be written. The label file comes first, so the notes may still say `before`.
        """
        points = {
            name: after.points.get(name)
            for name in self.store.keypoints
            if after.points.get(name) != before.points.get(name)
        }
        if points:
            self.store.write_points(video, {image: points})
        entry = _notes_entry(after)
        if entry != _notes_entry(before):
            write_notes(self.store.labels_dir / video, image, entry)

    def write_repeat(self, video: str, image: str, repeat: Mapping[str, Any]) -> None:
        """Store a repeat label in the notes, never among the labels. Raises what `write` raises.

        Parameters
        ----------
        video : str
            Stem of the video.
        image : str
            File name of the image.
        repeat : mapping of str to Any
            The repeat label as it is stored in the notes, see `RepeatLabel.to_json`.
        """
        write_notes(self.store.labels_dir / video, image, {"repeat": dict(repeat)})

    def _read(self, video: str, stamps: tuple[_Stamp, ...]) -> VideoFolder:
        path = self.store.labels_dir / video
        images = {
            name: ImageFile(path / name, f"{mtime:x}-{size:x}")
            for name, mtime, size, _ in stamps
            if name.lower().endswith(IMAGE_SUFFIXES)
        }
        rows = {row.image: row for row in self.store.table(video).rows}
        notes = read_notes(path)
        states, repeats = {}, {}
        for name in sorted_by_frame(images):
            points = {}
            for keypoint in self.store.keypoints:
                point = rows[name].point(keypoint) if name in rows else None
                if point is not None:
                    points[keypoint] = point
            states[name] = _state(points, notes.get(name, {}), self.store.keypoints)
            if notes.get(name, {}).get("repeat"):
                repeats[name] = notes[name]["repeat"]
        return VideoFolder(video, {name: images[name] for name in states}, states, repeats)

    def _stamps(self, folder: Path) -> tuple[_Stamp, ...]:
        """Return name, modification time, size and inode of every image, label and notes file of a folder."""
        stamps = []
        with os.scandir(folder) as entries:
            for entry in entries:
                is_image = entry.name.lower().endswith(IMAGE_SUFFIXES)
                is_labels = entry.name.startswith("CollectedData_") and entry.name.endswith(".csv")
                if entry.name.startswith(".") or not (is_image or is_labels or entry.name == NOTES_FILE):
                    continue
                if entry.is_symlink() and not self._is_inside(Path(entry.path)):
                    if is_image:
                        continue
                    raise LabelError(f"{entry.path}: expected a file of the project, got a link out of it")
                try:
                    status = entry.stat()
                except FileNotFoundError:
                    continue  # replaced or removed meanwhile, or a broken link
                if stat.S_ISREG(status.st_mode) and _is_text(entry.name):
                    stamps.append((entry.name, status.st_mtime_ns, status.st_size, status.st_ino))
        return tuple(sorted(stamps))

    def _is_inside(self, path: Path) -> bool:
        return Path(os.path.realpath(path)).is_relative_to(self._root)

    def _settings_mtime(self) -> int:
        return (self._root / SETTINGS_FILE).stat().st_mtime_ns


def _state(
    points: Mapping[str, tuple[float, float]], entry: NotesEntry, keypoints: tuple[str, ...]
) -> FrameState:
    # A point that another program has placed since is visible, even if it was marked as not visible before.
    hidden = tuple(k for k in keypoints if k in entry.get("not_visible", []) and k not in points)
    note = entry.get("note", "")
    return FrameState(
        points,
        hidden,
        note if isinstance(note, str) else "",
        entry.get("flagged") is True,
        entry.get("skipped") is True,
    )


def _notes_entry(state: FrameState) -> dict[str, Any]:
    return {
        "not_visible": list(state.not_visible),
        "note": state.note,
        "flagged": state.flagged,
        "skipped": state.skipped,
    }


def _is_text(name: str) -> bool:
    """Whether a file name is valid text, as JSON and addresses require."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
