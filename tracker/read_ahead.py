"""Work done ahead of the consumer, in a background thread with a small bounded queue.

Decoding releases the interpreter lock, so it runs beside inference. Knows nothing of video.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Generator, Iterable
from typing import TypeVar

T = TypeVar("T")

_POLL_S = 0.1  # how late a stopped producer or a Ctrl-C may be noticed


def read_ahead(items: Iterable[T], size: int = 2) -> Generator[T, None, None]:
    """Iterate over `items` in a background thread, at most `size` of them ahead of the consumer.

    Order is kept. An exception of `items` (KeyboardInterrupt included) is raised in the consumer, after
    what came before it. When the consumer stops early, close the generator (`contextlib.closing`): the
    thread ends after the item at hand, and `items` is closed in it.

    >>> list(read_ahead(range(5), size=2))
    [0, 1, 2, 3, 4]
    """
    if size < 1:
        raise ValueError(f"expected size >= 1, got {size}")
    waiting: queue.Queue[tuple[str, T | BaseException | None]] = queue.Queue(maxsize=size)
    stopped = threading.Event()

    def put(kind: str, value: T | BaseException | None) -> None:
        while not stopped.is_set():
            try:
                waiting.put((kind, value), timeout=_POLL_S)
                return
            except queue.Full:
                continue

    def produce() -> None:
        iterator = iter(items)
        try:
            for item in iterator:
                put("item", item)
                if stopped.is_set():
                    break
        except BaseException as error:
            put("error", error)
        else:
            put("end", None)
        finally:
            close = getattr(iterator, "close", None)
            if close is not None:
                close()

    thread = threading.Thread(target=produce, name="bendtrack-read-ahead", daemon=True)
    thread.start()
    try:
        while True:
            try:  # a timeout, because a wait without end cannot be interrupted on Windows
                kind, value = waiting.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            if kind == "end":
                return
            if kind == "error":
                assert isinstance(value, BaseException)
                raise value
            yield value  # type: ignore[misc]
    finally:
        stopped.set()
        thread.join()
