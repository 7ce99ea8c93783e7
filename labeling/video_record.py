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
    # With escapes, since a name need not be text; such a video is not found again.
    text = json.dumps({"format": _FORMAT, "path": path}, indent=1) + "\n"
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
        An existing file whose name is the folder's; None where there is none, or the record cannot be read. A place on
        another machine is not asked: Windows would sign in there for whoever wrote the record.
    """
    try:
        document = read_json(folder / VIDEO_FILE, LabelError)
        recorded = str(document["path"])
        if document["format"] != _FORMAT or recorded.replace("\\", "/").startswith("//"):
            return None
        path = Path(os.path.normpath(folder.resolve() / recorded))
        return path if path.is_file() and video_stem(path) == folder.name else None
    except (OSError, LabelError, KeyError, TypeError, ValueError):
        return None
