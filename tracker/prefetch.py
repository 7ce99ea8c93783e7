"""Prefetching: work in background threads, a bounded number of items ahead of the consumer.

Decoding and networks release the interpreter lock, so they run in parallel. Independent of video.
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

_POLL_S = 0.1  # longest delay until a stopped producer or a Ctrl-C is noticed


def read_ahead(items: Iterable[T], size: int = 2) -> Generator[T, None, None]:
    """Iterate over `items` in a background thread, at most `size` of them ahead of the consumer.

    Order is kept. An exception of `items` (KeyboardInterrupt included) is raised in the consumer, after
    the items before it. When the consumer stops early, close the generator (`contextlib.closing`): the
    thread ends after the current item, and `items` is closed in it.

    Parameters
    ----------
    items : iterable of T
        Produced in the background thread.
    size : int, optional
        Largest number of items ahead.

    Raises
    ------
    ValueError
        `size` is below 1.

    Examples
    --------
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


def parallel_map(
    work: Callable[[T], R], items: Iterable[T], workers: int
) -> Generator[tuple[T, R], None, None]:
    """Each of `items` with the result of `work`, in order, computed by `workers` threads in parallel.

    An exception of `work` is raised at its item. When the consumer stops early, close the generator: running
    work is waited for, the rest is cancelled.

    Parameters
    ----------
    work : callable
        Takes an item, returns its result.
    items : iterable of T
        Read in the consumer's thread, `workers` ahead.
    workers : int
        Number of threads.

    Examples
    --------
    >>> list(parallel_map(abs, [-1, 2, -3], workers=2))
    [(-1, 1), (2, 2), (-3, 3)]
    """
    waiting: deque[tuple[T, Future[R]]] = deque()
    with ThreadPoolExecutor(max_workers=workers) as pool:
        try:
            for item in items:
                waiting.append((item, pool.submit(work, item)))
                if len(waiting) > workers:
                    first, future = waiting.popleft()
                    yield first, future.result()
            for item, future in waiting:
                yield item, future.result()
        finally:
            for _, future in waiting:
                future.cancel()
