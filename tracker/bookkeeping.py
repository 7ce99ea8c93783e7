"""Which video a results file belongs to, and whether it is up to date: by recorded hashes, never by existence alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from .atomic import atomic_write_text
from .errors import ResultsError
from .hashing import file_sha256
from .hdf5_files import open_hdf5
from .json_files import parse_json
from .results import FORMAT, json_ready, read_record
from .video import video_stem


def is_up_to_date(
    out_dir: str | Path,
    stem: str,
    video_sha256: str,
    detector_provenance: Mapping[str, Any],
    settings: Mapping[str, Any] | None,
) -> bool:
    """Whether tracking this video with this detector and these settings again would change nothing.

    True when the JSON records the same video, detector and settings, and the CSV and the HDF5 have the hashes
    recorded there.

    Parameters
    ----------
    out_dir : str or Path
        Folder of the results.
    stem : str
        Name of the results files, without suffix.
    video_sha256 : str
        SHA-256 of the video.
    detector_provenance : mapping of str to Any
        `Detector.provenance` of the detector.
    settings : mapping of str to Any or None
        Settings from `tracking.tracking_settings`; None where they follow from video and detector.

    Returns
    -------
    bool
        Whether the results are up to date.
    """
    folder = Path(out_dir)
    try:
        record = read_record(folder / f"{stem}.json")
    except ResultsError:
        return False
    expected = json_ready({"format": FORMAT, "detector": detector_provenance})
    if settings is not None:
        expected["settings"] = json_ready(settings)
    if any(record.get(key) != value for key, value in expected.items()):
        return False
    if _video_of(record) != video_sha256:
        return False
    files = record.get("files")
    try:
        return isinstance(files, dict) and all(
            file_sha256(folder / f"{stem}.{kind}") == files.get(kind) for kind in ("csv", "h5")
        )
    except OSError:
        return False


class StemChoice(NamedTuple):
    """The file name under which a video's results are written.

    Attributes
    ----------
    stem : str
        Name of the results files, without suffix.
    note : str or None
        One line for the user where the name differs from the video's own stem, else None.
    """

    stem: str
    note: str | None


def choose_stem(out_dir: str | Path, video: str | Path, video_sha256: str) -> StemChoice:
    """The name for a video's results, so that two videos with one stem never overwrite each other's.

    A video is identified by its content (SHA-256). Where the files under its stem belong to another or an unknown
    video, the first digits of the video's own hash are appended: the same name every time.

    Parameters
    ----------
    out_dir : str or Path
        Folder of the results.
    video : str or Path
        The video file.
    video_sha256 : str
        SHA-256 of the video.

    Returns
    -------
    StemChoice
        The name, and a note where it is not the video's own stem.
    """
    own = video_stem(video)
    folder = Path(out_dir)
    names = [own] + [f"{own}-{video_sha256[:digits]}" for digits in (8, 16, 64)]
    for stem in names:
        files = [folder / f"{stem}{suffix}" for suffix in (".json", ".h5", ".csv")]
        if not any(file.exists() for file in files) or _owner(files[0], files[1]) == video_sha256:
            break
    if stem == own:
        return StemChoice(stem, None)
    return StemChoice(
        stem, f"{video}: results named '{own}' belong to another video, so these are named '{stem}'"
    )


def _owner(json_path: Path, h5_path: Path) -> str | None:
    """SHA-256 of the video whose results these are; from the HDF5 where a kill came before the JSON."""
    try:
        return _video_of(read_record(json_path))
    except ResultsError:
        pass
    try:
        with open_hdf5(h5_path, ResultsError, "bendtrack's HDF5") as file:
            return _video_of(parse_json(file.text(file.root, "provenance")))
    except ResultsError:
        return None


def _video_of(record: Any) -> str | None:
    video = record.get("video") if isinstance(record, dict) else None
    sha256 = video.get("sha256") if isinstance(video, dict) else None
    return sha256 if isinstance(sha256, str) else None


def record_file(out_dir: str | Path, stem: str, path: Path) -> None:
    """Record the hash of a figure or an overlay, made from a table, in the table's JSON.

    A table that is written again gets a new JSON without this hash, so files made from the old table are detected.

    Parameters
    ----------
    out_dir : str or Path
        Folder of the results.
    stem : str
        Name of the results files, without suffix.
    path : Path
        The figure or overlay.

    Raises
    ------
    ResultsError
        The JSON record cannot be read.
    OSError
        A file cannot be read or written.
    """
    json_path = Path(out_dir) / f"{stem}.json"
    record = read_record(json_path)
    files = record.get("files")
    if not isinstance(files, dict):
        raise ResultsError(f"{json_path}: expected the files' hashes, got {str(files)[:60]}")
    files[path.suffix[1:]] = file_sha256(path)
    atomic_write_text(json_path, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def is_recorded(out_dir: str | Path, stem: str, path: Path) -> bool:
    """Whether a figure or an overlay was made from the current table (see `record_file`).

    Parameters
    ----------
    out_dir : str or Path
        Folder of the results.
    stem : str
        Name of the results files, without suffix.
    path : Path
        The figure or overlay.

    Returns
    -------
    bool
        Whether its hash is the recorded one.
    """
    try:
        files = read_record(Path(out_dir) / f"{stem}.json").get("files")
        recorded = files.get(path.suffix[1:]) if isinstance(files, dict) else None
        return recorded is not None and bool(recorded == file_sha256(path))
    except (ResultsError, OSError):
        return False


def overlay_of_record(out_dir: str | Path, stem: str) -> Path | None:
    """Find the overlay video that was made from a table as it is now.

    Until version 0.1 it had the video's own name, `<stem>.mp4`.

    Parameters
    ----------
    out_dir : str or Path
        The folder of the results.
    stem : str
        Name of the table's files, without suffix.

    Returns
    -------
    Path or None
        The overlay; None where there is none, or one of another table.
    """
    folder = Path(out_dir)
    named = (folder / f"{stem}.overlay.mp4", folder / f"{stem}.mp4")
    return next((path for path in named if path.exists() and is_recorded(folder, stem, path)), None)
