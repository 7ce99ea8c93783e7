"""Stopping at a good moment: a signal such as Ctrl-C's sets an event, and the work ends where nothing is half done."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stop_event(*numbers: signal.Signals) -> Iterator[threading.Event]:
    """Give an event that signals set instead of what they usually do; a second signal does that.

    Signals reach a program's main thread only: in another one the event is never set, and nothing is changed.

    Parameters
    ----------
    *numbers : signal.Signals
        The signals, such as `signal.SIGINT`.

    Yields
    ------
    threading.Event
        Set once one of the signals has come. What they did before is restored at the end.
    """
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return
    before = {number: signal.getsignal(number) for number in numbers}

    def end(number: int, frame: object) -> None:
        stop.set()
        signal.signal(number, before[signal.Signals(number)])

    for number in before:
        signal.signal(number, end)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
