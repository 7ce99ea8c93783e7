"""Where the video of a folder of labelled frames lies: labeled-data/<video>/bendtrack-video.json.

DeepLabCut ignores the file. A video that has moved is not looked for.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from ..tracker.atomic import atomic_write_text
from ..tracker.errors import LabelError
from ..tracker.json_files import read_json
from ..tracker.video import video_stem

VIDEO_FILE = "bendtrack-video.json"
_FORMAT = "bendtrack-video-1"


def remember_video(folder: Path, video: Path) -> None:
    """Write where a video lies, so that a study's folder can be moved as a whole.

    Parameters
    ----------
    folder : Path
        The video's folder in labeled-data/.
    video : Path
        The video file.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    try:
        path = Path(os.path.relpath(video.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive of Windows
        path = video.resolve().as_posix()
    document = {"format": _FORMAT, "path": path}
    text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
    record = folder / VIDEO_FILE
    # A record that says so already is left as it is, with its time.
    if not (record.is_file() and not record.is_symlink() and record.read_bytes() == text.encode()):
        atomic_write_text(record, text)


def remembered_video(folder: Path) -> Path | None:
    """Read where the video of a folder of frames lies.

    Parameters
    ----------
    folder : Path
        The video's folder in labeled-data/.

    Returns
    -------
    Path or None
        An existing file whose name is the folder's; None where there is none, or the record cannot be read.
    """
    try:
        document = read_json(folder / VIDEO_FILE, LabelError)
        if document["format"] != _FORMAT:
            return None
        path = Path(os.path.normpath(folder.resolve() / str(document["path"])))
        return path if path.is_file() and video_stem(path) == folder.name else None
    except (OSError, LabelError, KeyError, TypeError, ValueError):
        return None
