"""Deinterlacing: a picture of two moments, in every second line each, becomes one of the first moment.

Only pictures that the file marks as interlaced are changed. One row in, one row out: a frame has one time, which is
that of its first field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from typing import cast

import av
import av.filter

from .decoding import Row

# Lines of the second field are estimated from the first one, and from the pictures before and after where nothing
# moves. (yadif and w3fdif were tried too.)
_FILTER = "bwdif", "mode=send_frame:parity=auto:deint=all"


def deinterlaced(rows: Iterator[Row]) -> Iterator[Row]:
    """Rows with the pictures deinterlaced that the file marks so; all others as they are.

    Parameters
    ----------
    rows : iterator of Row
        In order.

    Yields
    ------
    Row
        As many, in the same order.
    """
    run: _Run | None = None
    for row in rows:
        picture = row.picture
        if picture is None or not picture.interlaced_frame or row.damaged:
            if run is not None:
                yield from run.end()
                run = None
            yield row if picture is None or not picture.interlaced_frame else next(_Run(row).end())
        elif run is None:
            run = _Run(row)
        else:
            yield from run.add(row)
    if run is not None:
        yield from run.end()


class _Run:
    """Consecutive sound interlaced pictures; the filter looks one picture ahead."""

    def __init__(self, first: Row) -> None:
        assert first.picture is not None
        self._waiting: list[Row] = []
        self._graph = av.filter.Graph()
        source = self._graph.add_buffer(
            width=first.picture.width,
            height=first.picture.height,
            format=first.picture.format,
            time_base=first.picture.time_base or Fraction(1, 25),
        )
        filter, sink = self._graph.add(*_FILTER), self._graph.add("buffersink")
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
