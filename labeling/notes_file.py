"""The notes file of a video, labeled-data/<video>/bendtrack-notes.json: what CollectedData has no columns for.

It holds keypoints that are not visible, notes, flags, skipped frames, and repeat labels. DeepLabCut ignores the file.
Unknown keys are kept.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..tracker.atomic import atomic_write_text
from ..tracker.errors import LabelError
from ..tracker.json_files import read_json

NOTES_FILE = "bendtrack-notes.json"
_FORMAT = "bendtrack-notes-1"

NotesEntry = Mapping[str, Any]
"""One image's entry: not_visible, note, flagged, skipped, repeat. A key with an empty value is left out."""


def read_notes(folder: Path) -> dict[str, NotesEntry]:
    """Read the notes file of a video.

    Parameters
    ----------
    folder : Path
        The video's folder in labeled-data/.

    Returns
    -------
    dict of str to NotesEntry
        Image name -> its entry; empty where there is no file.

    Raises
    ------
    LabelError
        The file is malformed.
    """
    path = folder / NOTES_FILE
    try:
        document = read_json(path, LabelError)
    except FileNotFoundError:
        return {}
    images = document.get("images") if isinstance(document, dict) else None
    if not isinstance(images, dict) or document.get("format") != _FORMAT:
        raise LabelError(f"{path}: expected bendtrack's notes ({_FORMAT}), got other JSON")
    for image, entry in images.items():
        if not _is_entry(entry):
            raise LabelError(f"{path}: {image}: expected an entry of bendtrack's, got {str(entry)[:60]}")
    return images


def _is_entry(entry: Any) -> bool:
    return (
        isinstance(entry, dict)
        and isinstance(names := entry.get("not_visible", []), list)
        and all(isinstance(name, str) for name in names)
        and isinstance(entry.get("repeat", {}), dict)
    )


def write_notes(folder: Path, image: str, changes: Mapping[str, Any]) -> None:
    """Set keys of one image's entry in the notes file. The file is replaced as a whole.

    Parameters
    ----------
    folder : Path
        The video's folder in labeled-data/.
    image : str
        File name of the image.
    changes : mapping of str to Any
        Keys to set; an empty value (None, False, "", []) removes the key.

    Raises
    ------
    LabelError
        The file is malformed.
    OSError
        The file cannot be written; the old one is unchanged.
    """
    images = read_notes(folder)
    entry = {key: value for key, value in {**images.get(image, {}), **changes}.items() if value}
    images = {**images, image: entry}
    document = {"format": _FORMAT, "images": {name: e for name, e in sorted(images.items()) if e}}
    atomic_write_text(folder / NOTES_FILE, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
