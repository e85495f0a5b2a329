"""A pool of threads that share work: NumPy, torch and compiled kernels release Python's lock while they compute."""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

Part = TypeVar("Part")


_state = threading.local()
"""`is_worker` is True in the threads of the pool."""


def share(work: Callable[[Part], None], parts: Iterable[Part], threads: int, start: Callable[[], None] | None) -> None:
    """Do parts of some work in threads; in the calling thread if there is one part, or if it belongs to the pool.

    A single thread does each part, so that its result is bitwise independent of the number of threads.

    Args:
        work: Called with each part once.
        start: Called in each thread of the pool when it starts.
    """
    parts = list(parts)
    if min(len(parts), threads) <= 1 or hasattr(_state, "is_worker"):
        for part in parts:
            work(part)
        return
    futures = [_workers(threads, start).submit(work, part) for part in parts]
    wait(futures)  # all of them, so that no thread continues after an exception
    for future in futures:
        future.result()


@functools.cache
def _workers(threads: int, start: Callable[[], None] | None) -> ThreadPoolExecutor:
    """Return a pool of threads, which is cached. New threads start slowly, without buffers for matrix products."""

    def begin() -> None:
        _state.is_worker = True
        if start is not None:
            start()

    return ThreadPoolExecutor(threads, initializer=begin)


# A forked process has no threads but the one that forked.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_workers.cache_clear)
