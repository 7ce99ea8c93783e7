"""Whose results files are, and whether they are up to date: by recorded hashes, never by mere existence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import h5py

from .atomic import atomic_write_text
from .errors import ResultsError
from .hashing import file_sha256
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

    So it is when the JSON records the same three, and the CSV and the HDF5 are there with the hashes it
    records.

    Parameters
    ----------
    settings : as `tracking.tracking_settings` gives them; None where they follow from video and detector
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
    """Under which name a video's results go.

    Attributes
    ----------
    stem : name of the files, without suffix
    note : one line for the user when it is not simply the video's own stem, else None
    """

    stem: str
    note: str | None


def choose_stem(out_dir: str | Path, video: str | Path, video_sha256: str) -> StemChoice:
    """The name for a video's results, so that two videos with one stem never overwrite each other's.

    A video is known by its content. Where the files under its stem belong to other content, or to nobody
    knows whom, the first digits of the video's own hash are added: the same name every time.
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
        with h5py.File(h5_path, "r") as file:
            return _video_of(json.loads(file["provenance"].asstr()[()]))
    except (OSError, KeyError, ValueError):
        return None


def _video_of(record: Any) -> str | None:
    video = record.get("video") if isinstance(record, dict) else None
    return video.get("sha256") if isinstance(video, dict) else None


def record_file(out_dir: str | Path, stem: str, path: Path) -> None:
    """Enter a picture or an overlay made from a table into its JSON, by hash.

    A table that is written again has a JSON without it, so that what was made from the old one is known to be.
    """
    json_path = Path(out_dir) / f"{stem}.json"
    record = read_record(json_path)
    record["files"][path.suffix[1:]] = file_sha256(path)
    atomic_write_text(json_path, json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


def is_recorded(out_dir: str | Path, stem: str, path: Path) -> bool:
    """Whether a picture or an overlay was made from the table as it is now (see `record_file`)."""
    try:
        recorded = read_record(Path(out_dir) / f"{stem}.json").get("files", {}).get(path.suffix[1:])
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
