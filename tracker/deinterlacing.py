"""Deinterlacing: a picture of two moments, in every second line each, becomes one of the first moment.

Pictures are changed that the file marks as interlaced, and all of a file that does not say so but shows it
(`combing.py`). One row in, one row out: a frame has one time, which is that of its first field.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from typing import cast

import av
import av.filter

from .combing import CombTest, FieldOrder
from .decoding import Row

# Lines of the second field are estimated from the first one, and from the pictures before and after where nothing
# moves. (yadif and w3fdif were tried too.)
_FILTER = "bwdif", "mode=send_frame:parity={}:deint=all"
# Rows that are held back while it is not known whether unmarked pictures are interlaced: where nothing has moved yet
# that makes no difference.
_HELD = 4


def deinterlaced(rows: Iterator[Row], on_unmarked: Callable[[], None] | None = None) -> Iterator[Row]:
    """Rows with their interlaced pictures deinterlaced; all others as they are.

    Parameters
    ----------
    rows : iterator of Row
        In order.
    on_unmarked : callable, optional
        Called once where pictures are interlaced and the file does not say so.

    Yields
    ------
    Row
        As many, in the same order.
    """
    run: _Run | None = None
    for row, parity in _with_parity(rows, on_unmarked):
        if parity is None or row.damaged:
            if run is not None:
                yield from run.end()
                run = None
            yield row if parity is None else next(_Run(row, parity).end())
        elif run is None:
            run = _Run(row, parity)
        else:
            yield from run.add(row)
    if run is not None:
        yield from run.end()


def _with_parity(
    rows: Iterator[Row], on_unmarked: Callable[[], None] | None
) -> Iterator[tuple[Row, str | None]]:
    """Rows, each with bwdif's name for its field order; None for what is not interlaced."""
    test: CombTest | None = CombTest()
    unmarked: FieldOrder | None = None
    held: deque[Row] = deque()

    def parity(row: Row) -> str | None:
        if row.picture is None:
            return None
        if row.picture.interlaced_frame:
            return "auto"
        return unmarked if unmarked != "progressive" else None

    for row in rows:
        held.append(row)
        if test is not None and row.picture is not None and not row.damaged:
            # A file that marks some pictures knows what it does.
            unmarked = "progressive" if row.picture.interlaced_frame else test.add(row.picture)
            if unmarked is not None:
                test = None
                if unmarked != "progressive" and on_unmarked is not None:
                    on_unmarked()
        while held and (test is None or len(held) > _HELD):
            first = held.popleft()
            yield first, parity(first)
    for row in held:
        yield row, parity(row)


class _Run:
    """Consecutive sound interlaced pictures; the filter looks one picture ahead."""

    def __init__(self, first: Row, parity: str) -> None:
        assert first.picture is not None
        self._waiting: list[Row] = []
        self._graph = av.filter.Graph()
        source = self._graph.add_buffer(
            width=first.picture.width,
            height=first.picture.height,
            format=first.picture.format,
            time_base=first.picture.time_base or Fraction(1, 25),
        )
        name, options = _FILTER
        filter, sink = self._graph.add(name, options.format(parity)), self._graph.add("buffersink")
        source.link_to(filter)
        filter.link_to(sink)
        self._graph.configure()
        list(self.add(first))

    def add(self, row: Row) -> Iterator[Row]:
        """Give a row in; those that are known by now come out."""
        assert row.picture is not None
        self._waiting.append(row)
        self._graph.push(row.picture)
        yield from self._known()

    def end(self) -> Iterator[Row]:
        """The rows that are left."""
        self._graph.push(None)
        yield from self._known()
        yield from self._waiting  # none, unless the filter gave fewer pictures than it got

    def _known(self) -> Iterator[Row]:
        while self._waiting:
            try:
                picture = cast(av.VideoFrame, self._graph.pull())
            except (av.BlockingIOError, av.EOFError):
                return
            yield replace(self._waiting.pop(0), picture=picture)
