"""Checksums of a Matroska file: which of its clusters are not as they were written.

FFmpeg (and so OBS and many recorders) writes a CRC-32 into every cluster of a few seconds, and does not look at it when
it reads. WebM files have none.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import BinaryIO

_SEGMENT, _CLUSTER, _CRC32 = 0x18538067, 0x1F43B675, 0xBF
# A cluster is at most 5 MB by default; a size beyond this is damage itself.
_MAX_CLUSTER_BYTES = 1 << 28


def damaged_ranges(path: Path) -> list[tuple[int, int]]:
    """Find the clusters whose checksum does not match.

    Parameters
    ----------
    path : Path
        A Matroska file.

    Returns
    -------
    list of (int, int)
        First byte, and the one after the last, of each; none where the file has no checksums. Behind an element that
        cannot be read nothing is checked: FFmpeg reports it.
    """
    found: list[tuple[int, int]] = []
    with path.open("rb") as file:
        while True:
            begin = file.tell()
            name, size = _element(file)
            if name is None:
                return found
            if name == _SEGMENT:
                continue  # its contents follow
            if size is None or size > _MAX_CLUSTER_BYTES:
                return found
            if name != _CLUSTER:
                file.seek(size, 1)
                continue
            content = file.read(size)
            if len(content) < size or content[:2] != bytes((_CRC32, 0x84)):
                return found  # cut short, or a writer without checksums
            if zlib.crc32(content[6:]) != int.from_bytes(content[2:6], "little"):
                found.append((begin, file.tell()))


def _element(file: BinaryIO) -> tuple[int | None, int | None]:
    """Name and size of the EBML element at this place; None for the end, and for a size that is not given."""
    name = _number(file, keep_marker=True)
    size = _number(file, keep_marker=False)
    return (None, None) if name is None else (name, size)


def _number(file: BinaryIO, *, keep_marker: bool) -> int | None:
    first = file.read(1)
    if not first or not first[0]:
        return None
    length = 9 - first[0].bit_length()
    rest = file.read(length - 1)
    if len(rest) < length - 1:
        return None
    value = int.from_bytes(first + rest, "big")
    if keep_marker:
        return value
    value -= 1 << 7 * length
    return None if value == (1 << 7 * length) - 1 else value
