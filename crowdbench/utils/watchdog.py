"""Ends a command with one sentence if a plug-in hangs so that no exception can interrupt it.

A thread watches the limits of time that run. Compiled code that holds Python's lock stops this thread too: then the
timer of `faulthandler`, which the thread renews, ends the process. It writes where the main thread is to a small
program, which prints the sentence.
"""

from __future__ import annotations

import faulthandler
import os
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

_SENTENCE = """
/^Thread/ { first = 1; next }
first { place = $0; first = 0 }
END { if (place) { sub(/^ *File /, "", place); print "crowdbench: compiled code hangs, called from " place } }
"""
"""Program of awk: prints a sentence with the innermost line of the main thread, the last one that is listed."""


@runtime_checkable
class Limit(Protocol):
    """A limit of time, see `resources.FairLimit`."""

    seconds: float

    def over(self) -> bool:
        """Return whether the limit is exceeded."""


_is_enabled, _is_started = False, False


def enable() -> None:
    """Let limits end this process: it is a command, not the Python of a user."""
    global _is_enabled
    _is_enabled = True


def start(running: Sequence[Limit]) -> None:
    """Watch the running limits from now on, if `enable` was called before."""
    global _is_started
    if not _is_enabled or _is_started:
        return
    _is_started = True
    source, sink = os.pipe()
    streams = [(os.POSIX_SPAWN_DUP2, source, 0), (os.POSIX_SPAWN_DUP2, 2, 1)]
    os.posix_spawnp("awk", ["awk", _SENTENCE], os.environ, file_actions=streams)
    os.close(source)
    _renew(sink, running)
    threading.Thread(target=_watch, args=(sink, running), daemon=True).start()


def _renew(sink: int, running: Sequence[Limit]) -> None:
    """Start the time of `HANG` again."""
    longest = max((limit.seconds for limit in running), default=0.0)
    faulthandler.dump_traceback_later(min(max(HANG, 2.0 * longest), 1e6), exit=True, file=sink)


def _watch(sink: int, running: Sequence[Limit]) -> None:
    over_since: dict[Limit, float] = {}
    while True:
        time.sleep(TICK)
        now, limits = time.monotonic(), tuple(running)
        _renew(sink, limits)
        over_since = {limit: over_since.get(limit, now) for limit in limits if limit.over()}
        for limit, since in over_since.items():
            if now - since > min(GRACE, limit.seconds):
                _end(limit)


def _end(limit: Limit) -> None:
    frames = traceback.walk_stack(sys._current_frames()[threading.main_thread().ident or 0])
    place = line_of(reversed(list(frames)))
    sentence = f"a plug-in took longer than {limit.seconds:g} s and cannot be interrupted{place}"
    os.write(2, f"crowdbench: {sentence}\n".encode(errors="backslashreplace"))
    os._exit(1)
