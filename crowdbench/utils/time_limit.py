"""A limit of time that is fair on a busy machine: time in which a process waits for a processor does not count."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable
from pathlib import Path

MOST = 10.0
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
        processes: The numbers of the processes that work, asked at each look.
    """

    def __init__(self, seconds: float, processes: Callable[[], Iterable[int]]) -> None:
        self.seconds = seconds
        self.head = min(HEAD, seconds / 2)
        self._processes = processes
        self._start = time.perf_counter()
        self._first_look: tuple[float, dict[Path, float]] | None = None

    def over(self) -> bool:
        """Whether it is over. Ask now and then once `head` is: the leaving out starts with the first answer."""
        return self.spent() > self.seconds or time.perf_counter() - self._start > MOST * self.seconds

    def spent(self) -> float:
        """The seconds that count so far."""
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
    """How many seconds each thread of the processes was ready to run and had no processor."""
    waited = {}
    for process in processes:
        for thread in Path(f"/proc/{process}/task").glob("*"):
            with contextlib.suppress(OSError, ValueError, IndexError):  # it has ended, or the kernel does not say
                waited[thread] = int((thread / "schedstat").read_text().split()[1]) / 1e9
    return waited
