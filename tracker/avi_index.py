"""The index of an AVI file: which slot of time each chunk of the picture stream belongs to.

An AVI has no presentation times: the n-th chunk is the n-th frame. A chunk that is lost would shift all later frames
in time, unless the index tells that it was there. FFmpeg reads the index only where it lies where the header says.
"""

from __future__ import annotations

import struct
from collections import Counter, deque
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

# An hour at 240 frames/s with sound has an index of 28 MB; more of the end of a file is not searched.
_MAX_INDEX_BYTES = 32 << 20
# So many chunks in a row may be lost and the rest still find their slots.
_MAX_LOST = 4096


class IndexedChunk(NamedTuple):
    """A chunk according to the index: its position (of what kind, differs between writers) and size in bytes."""

    position: int
    size: int


def index_at_end(path: Path, stream_index: int) -> tuple[list[IndexedChunk], int]:
    """Read the index at the end of an AVI wherever it lies.

    Parameters
    ----------
    path : Path
        The file.
    stream_index : int
        Number of the picture stream.

    Returns
    -------
    chunks : list of IndexedChunk
        The stream's chunks in order, also those of size 0, in which the recorder dropped a frame; none where there is
        no index.
    position : int
        Where the index lies in the file, bytes.
    """
    with path.open("rb") as file:
        length = file.seek(0, 2)
        begin = max(0, length - _MAX_INDEX_BYTES)
        file.seek(begin)
        tail = file.read()
    at = tail.rfind(b"idx1")
    if at < 0 or at + 8 > len(tail):
        return [], length
    (size,) = struct.unpack_from("<I", tail, at + 4)
    entries = tail[at + 8 : at + 8 + size]
    own = f"{stream_index:02d}".encode()
    chunks = [
        IndexedChunk(position, chunk_size)
        for name, _, position, chunk_size in struct.iter_unpack("<4sIII", entries[: len(entries) // 16 * 16])
        if name[:2] == own and name[2:] not in (b"pc", b"ix")
    ]
    return chunks, begin + at


class ChunkSlots:
    """Gives each chunk, as it is read, its slot; chunks that the index has and the file has lost are found out.

    Parameters
    ----------
    index : sequence of IndexedChunk
        The stream's index, at least one chunk.
    index_position : int
        Where the index lies in the file, bytes.

    Attributes
    ----------
    is_uncertain : bool
        Chunks are missing from the file, and all have one size: nothing tells which. Known after the first chunk.
    """

    def __init__(self, index: Sequence[IndexedChunk], index_position: int) -> None:
        self.is_uncertain = False
        self._left = deque(enumerate(index))
        self._shift: int | None = None
        self._span = index[-1].position + index[-1].size - index[0].position
        self._index_position = index_position
        self._of_one_size = Counter(chunk.size for chunk in index).most_common(1)[0][1] > len(index) / 4

    def lost_before(self, position: int, size: int) -> tuple[list[int], int | None]:
        """Match the next chunk of the file to the index.

        Parameters
        ----------
        position, size : int
            Of the chunk in the file, bytes.

        Returns
        -------
        lost : list of int
            Slots of the chunks before it that the file has lost.
        slot : int or None
            Its own slot; None where the index does not know it.
        """
        lost: list[int] = []
        for ahead, (slot, chunk) in enumerate(self._left):
            if ahead > _MAX_LOST:
                break
            shift = chunk.position - position
            # Bytes that are missing make positions in the file smaller than in the index, never larger.
            if chunk.size == size and size and (self._shift is None or shift >= self._shift):
                if self._shift is None:
                    is_short = self._span > self._index_position - position
                    self.is_uncertain = is_short and self._of_one_size
                self._shift = shift
                for _ in range(ahead + 1):
                    self._left.popleft()
                return lost, slot
            if chunk.size:
                lost.append(slot)
        return [], None

    def lost_at_end(self) -> list[int]:
        """Slots of the chunks that never came."""
        return [slot for slot, chunk in self._left if chunk.size]
