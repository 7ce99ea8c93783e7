"""Reading ahead: errors arrive where they happened, and the source is closed."""

from __future__ import annotations

from contextlib import closing

import pytest

from bendtrack.tracker.errors import VideoError
from bendtrack.tracker.prefetch import read_ahead


def test_read_ahead_hands_over_errors_and_stops_when_told():
    closed = []

    def numbers(fail_at: int | None = None):
        try:
            for n in range(1000):
                if n == fail_at:
                    raise VideoError("broken")
                yield n
        finally:
            closed.append(True)

    broken = read_ahead(numbers(fail_at=5))
    assert [next(broken) for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(VideoError, match="broken"):
        next(broken)
    with closing(read_ahead(numbers())) as ahead:
        assert next(ahead) == 0
    assert closed == [True, True]
