"""Limits the time of processes, in a fair way on a busy machine, and keeps freed memory."""

from __future__ import annotations

import contextlib
import contextvars
import ctypes
import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FrameType

from crowdbench.utils import watchdog
from crowdbench.utils.defaults import START_LIMIT
from crowdbench.utils.errors import plugin_errors

MAX_FACTOR = 10.0
"""Largest elapsed time as a multiple of the limit, even if a process waits for a processor."""

HEAD = 1.0
"""Seconds at the start that always count, or half of the limit if less, so that short work needs no measurement."""


class FairLimit:
    """A limit of time for the work of one or several processes, which starts now.

    After `HEAD`, the time in which the thread that waited longest was ready to run, but had no processor, does not
    count. Only Linux reports this time: on other systems all time counts.

    Attributes:
        seconds: The limit.
        head: The seconds at the start that always count.

    Args:
        processes: Function that returns the ids of the working processes, called at each check.
    """

    def __init__(self, seconds: float, processes: Callable[[], Iterable[int]]) -> None:
        self.seconds = seconds
        self.head = min(HEAD, seconds / 2)
        self._processes = processes
        self._start = time.perf_counter()
        self._first_look: tuple[float, dict[Path, float]] | None = None

    def over(self) -> bool:
        """Return whether the limit is exceeded. Call it repeatedly after `head`: exclusion starts at the first call."""
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
            with contextlib.suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel does not report it
                waited[thread] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return waited


class TimeLimit(BaseException):
    """Raised inside a plug-in that takes too long. Not an Exception, which plug-ins may catch."""


_running: list[FairLimit] = []
"""The limits of the contexts that the main thread is in."""


@contextlib.contextmanager
def interrupted_after(limit: FairLimit) -> Iterator[None]:
    """Raise TimeLimit inside the context when a limit is over, if this is the main thread, which receives signals."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        # An exception in the code that leaves the context would keep the timer running.
        is_leaving = frame is not None and frame.f_code.co_filename in (__file__, contextlib.__file__)
        if is_leaving:
            return
        for one in _running:
            if one.over():
                raise TimeLimit(f"it took longer than {one.seconds:g} s")

    watchdog.start(_running)
    handler = signal.signal(signal.SIGALRM, interrupt)
    # Repeated until the limit is over, and because plug-ins may catch the exception and continue.
    timer = signal.setitimer(signal.ITIMER_REAL, limit.head, min(0.5, limit.head))
    _running.append(limit)
    try:
        yield
    finally:
        # The last alarm may still arrive here.
        try:
            _running.remove(limit)
            signal.setitimer(signal.ITIMER_REAL, *timer)
        finally:
            signal.signal(signal.SIGALRM, handler)


_start_limit = contextvars.ContextVar("start limit", default=START_LIMIT)


@contextlib.contextmanager
def start_limit(seconds: float) -> Iterator[None]:
    """Give plug-ins more time than `START_LIMIT` for a call of `plugin_in_time`."""
    token = _start_limit.set(max(START_LIMIT, seconds))
    try:
        yield
    finally:
        _start_limit.reset(token)


@contextlib.contextmanager
def plugin_in_time(beginning: str, where: str = "", seconds: float | None = None) -> Iterator[None]:
    """Turn any exception of a plug-in into an InputError, as `plugin_errors` does, and a call that takes too long.

    Args:
        beginning: See `plugin_errors`.
        where: See `plugin_errors`.
        seconds: The limit; by default that of `start_limit`.
    """
    limit = FairLimit(_start_limit.get() if seconds is None else seconds, lambda: (os.getpid(),))
    with plugin_errors(beginning, where), interrupted_after(limit):
        yield


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h
_MAX_KEPT = 32 * 2**20


def keep_freed_memory() -> None:
    """Keep the freed memory of arrays of some megabytes in this process, for later arrays.

    Otherwise the layers of a network return pages to the system and receive them again, zeroed, which takes as long as
    their matrix products. Only glibc supports this.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_M_MMAP_THRESHOLD, _MAX_KEPT)
        libc.mallopt(_M_TRIM_THRESHOLD, 8 * _MAX_KEPT)
