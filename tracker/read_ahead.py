"""Work done ahead of the consumer, in background threads, a bounded number of items ahead.

Decoding and networks release the interpreter lock, so they run beside each other. Knows nothing of video.
"""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

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


def side_by_side(
    work: Callable[[T], R], items: Iterable[T], workers: int
) -> Generator[tuple[T, R], None, None]:
    """Each of `items` with what `work` makes of it, in their order, `workers` of them worked on at the same time.

    An exception of `work` is raised in its item's turn. When the consumer stops early, close the generator: what is
    being worked on is waited for, the rest is left.

    >>> list(side_by_side(abs, [-1, 2, -3], workers=2))
    [(-1, 1), (2, 2), (-3, 3)]
    """
    waiting: deque[tuple[T, Future[R]]] = deque()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            for item in items:
                waiting.append((item, pool.submit(work, item)))
                if len(waiting) > workers:
                    first, made = waiting.popleft()
                    yield first, made.result()
            for item, made in waiting:
                yield item, made.result()
        finally:
            for _, made in waiting:
                made.cancel()
