"""Processor time and memory: a limit of time that is fair on a busy machine, and how much memory a process takes."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

MAX_FACTOR = 10.0
"""However long a process waits for a processor, it is not given more than this many times its limit."""

HEAD = 1.0
"""So many seconds of the work count in any case, or half of its limit, so that short work costs nothing."""


class FairLimit:
    """A limit of time for the work of one or several processes, which starts now.

    After `HEAD`, the time is left out in which the thread that waited longest was ready to run and had no processor.
    Only Linux says how long that is: elsewhere all time counts.

    Attributes:
        seconds: The limit.
        head: The seconds that count in any case.

    Args:
        seconds: The limit.
        processes: The numbers of the processes that work, read at each look.
    """

    def __init__(self, seconds: float, processes: Callable[[], Iterable[int]]) -> None:
        self.seconds = seconds
        self.head = min(HEAD, seconds / 2)
        self._processes = processes
        self._start = time.perf_counter()
        self._first_look: tuple[float, dict[Path, float]] | None = None

    def over(self) -> bool:
        """Return whether it is over. Call it now and then after `head`: the leaving out starts with the first call."""
        return self.spent() > self.seconds or time.perf_counter() - self._start > MAX_FACTOR * self.seconds

    def spent(self) -> float:
        """Return the seconds that count so far."""
        now = time.perf_counter()
        passed = now - self._start
        if passed < self.head:
            return passed
        waited = _waited(self._processes())
        if self._first_look is None:
            self._first_look = now, waited
        then, before = self._first_look
        left_out = max((seconds - before.get(thread, 0.0) for thread, seconds in waited.items()), default=0.0)
        return passed - min(left_out, now - then)


def _waited(processes: Iterable[int]) -> dict[Path, float]:
    """Return how many seconds each thread of the processes was ready to run and had no processor."""
    waited = {}
    for process in processes:
        for thread in Path(f"/proc/{process}/task").glob("*"):
            with contextlib.suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel does not say
                waited[thread] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return waited


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_MAX_KEPT = 32 * 2**20


def keep_freed_memory() -> None:
    """Have this process keep the memory that arrays of some megabytes leave, for the next ones.

    The layers of a network would otherwise give pages back to the system and get them again, zeroed, which takes as
    long as their products. Only glibc can be told so.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _MAX_KEPT)
        libc.mallopt(_M_TRIM_THRESHOLD, 8 * _MAX_KEPT)


@contextlib.contextmanager
def limit_memory(extra: float) -> Iterator[None]:
    """Have this process take so many bytes more at most: where it asks for more, MemoryError is raised.

    Only Linux keeps to it: elsewhere there is no limit.
    """
    if sys.platform != "linux":
        yield
        return
    import resource

    import psutil

    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = psutil.Process().memory_info().vms + int(extra)
    soft = limit if before[0] == resource.RLIM_INFINITY else min(limit, before[0])
    resource.setrlimit(resource.RLIMIT_AS, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
