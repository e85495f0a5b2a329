"""Ends a command with one sentence if a plug-in hangs so that no exception can interrupt it.

A thread watches the limits of time that run. Compiled code that holds Python's lock stops this thread too. Then another
process, which the thread signals every second, ends the command. It counts its own seconds, so that a command that is
stopped (Ctrl-Z, a suspended job) may go on later.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from crowdbench.utils.errors import line_of

TICK = 1.0
"""Seconds between two looks."""

GRACE = 10.0
"""Seconds between the exception that a limit raises and the end of the process; at most the limit."""

HANG = 60.0
"""Shortest time in seconds without Python code after which the process ends; with longer limits, twice the limit."""


@runtime_checkable
class Limit(Protocol):
    """A limit of time, see `resources.FairLimit`."""

    seconds: float

    def over(self) -> bool:
        """Return whether the limit is exceeded."""


_sink: int | None = None
_is_started = False


def enable() -> None:
    """Let limits end this process: it is a command, not the Python of a user. Call it before threads start."""
    global _sink
    if _sink is not None or not hasattr(os, "fork"):
        return
    source, _sink = os.pipe()
    if os.fork() == 0:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # it ends with the command
        os.close(_sink)
        _end_silent(source, os.getppid())
        os._exit(0)
    os.close(source)
    if signal.getsignal(signal.SIGHUP) == signal.SIG_DFL:
        # A handler in C needs no lock of Python. It is called with the number of the signal, 1: the exit status.
        libc = ctypes.CDLL(None)
        libc.signal(signal.SIGHUP, libc._exit)


def start(running: Sequence[Limit]) -> None:
    """Watch the running limits from now on, if `enable` was called before."""
    global _is_started
    if _sink is not None and not _is_started:
        _is_started = True
        _report(running)
        threading.Thread(target=_watch, args=(running,), daemon=True).start()


def _report(running: Sequence[Limit]) -> None:
    """Tell the other process for how many seconds this one may be silent from now on."""
    longest = max((limit.seconds for limit in running), default=0.0)
    assert _sink is not None
    with contextlib.suppress(OSError):  # raised if the other process was killed
        os.write(_sink, f"{max(HANG, 2.0 * longest)} ".encode())


def _watch(running: Sequence[Limit]) -> None:
    over_since: dict[Limit, float] = {}
    while True:
        time.sleep(TICK)
        now, limits = time.monotonic(), tuple(running)
        _report(limits)
        over_since = {limit: over_since.get(limit, now) for limit in limits if limit.over()}
        for limit, since in over_since.items():
            if now - since > min(GRACE, limit.seconds):
                _end(limit)


def _end(limit: Limit) -> None:
    frames = traceback.walk_stack(sys._current_frames()[threading.main_thread().ident or 0])
    place = line_of(reversed(list(frames)))
    _say(f"a plug-in took longer than {limit.seconds:g} s and cannot be interrupted{place}")
    os._exit(1)


def _end_silent(source: int, process: int) -> None:
    """End a process that has been silent for too long; return when it has ended.

    Args:
        source: The pipe on which it reports.
        process: Its id.
    """
    longest, silent = 0.0, 0.0
    while True:
        if select.select([source], [], [], TICK)[0]:
            report = os.read(source, 65536)
            if not report:
                return
            longest, silent = float(report.split()[-1]), 0.0
            continue
        silent += TICK
        if longest and silent > longest:
            _say(f"a plug-in hangs in compiled code: no Python code has run for {longest:g} s")
            os.kill(process, signal.SIGHUP)
            has_ended = select.select([source], [], [], 10.0 * TICK)[0]
            if not has_ended:
                os.kill(process, signal.SIGKILL)
            return


def _say(sentence: str) -> None:
    os.write(2, f"crowdbench: {sentence}\n".encode(errors="backslashreplace"))
