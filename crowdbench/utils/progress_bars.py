"""Messages on standard error about the progress of long work, and about compilation."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator

from crowdbench.utils.terminal import say

SLOW = 5.0
"""Seconds without a line after which a phase without a percentage, such as loading, is named if there is no
terminal."""

PERIOD = 1.0
"""Seconds between two looks at the progress if there is no terminal."""

ALIVE = 600.0
"""Seconds after which a line is repeated if there is no terminal."""

KNOWN_AFTER = 2.0
"""Seconds after the first piece of work before the remaining time is estimated."""

WIDE = 60
"""Smallest width of a terminal on which the elapsed time is shown."""

LOADING, COMPILING, FINISHING = "loading", "compiling", "finishing"
"""Phases of work before its first piece and after its last."""


@contextlib.contextmanager
def progress(total: float, what: str = "") -> Iterator[Callable[[float], None]]:
    """Show the progress of some work: a bar on a terminal, elsewhere a line of text for each 10 %.

    Args:
        total: The pieces of work.
        what: Text after the share that is done, such as `of 8 scenes`; `of TOTAL cases` if empty.

    Yields:
        A function to be called with the number of pieces, or parts of them, that were done since its last call. The
        phase of loading ends with its first call, also of 0.
    """
    work = _Work(total, what or f"of {total} cases")
    _shown.append(work)
    try:
        has_bar = sys.stderr.isatty() and os.environ.get("TERM") not in ("dumb", "unknown")
        with _bar(work) if has_bar else _lines(work):
            yield work.add
    finally:
        _shown.remove(work)


class _Work:
    """Progress of some work, and the remaining time.

    The remaining time is estimated from the mean time of pieces of work after the first report. The time before that is
    compilation and the loading of files.

    Attributes:
        phase: The phase of the work; empty between its first piece and its last.
        update: Called after each change.
    """

    def __init__(self, total: float, what: str) -> None:
        self.total, self.what = total, what
        self.done = self.before = 0.0
        self.phase = LOADING
        self.start = 0.0
        self.update: Callable[[], None] = lambda: None

    def add(self, done: float) -> None:
        """Count work that was done since the last call."""
        self.done += done
        if self.phase in (LOADING, COMPILING):
            self.before, self.start = self.done, time.monotonic()
        self.phase = FINISHING if self.percent >= 100 else ""
        self.update()

    @property
    def percent(self) -> int:
        """Percentage of finished work, rounded down: 100 is all of it, up to rounding in sums of parts."""
        return int(100 * self.done / self.total + 1e-6) if self.total else 100

    def __str__(self) -> str:
        return self.phase or self.share

    @property
    def share(self) -> str:
        """The share of the work that is done, with the time that is left, if it can be estimated."""
        elapsed = time.monotonic() - self.start
        text = f"{self.percent} % {self.what}"
        if self.percent >= 100 or elapsed < KNOWN_AFTER or self.done == self.before:
            return text
        seconds = elapsed * (self.total - self.done) / (self.done - self.before)
        left = f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
        return f"{text}, {left} left"


_shown: list[_Work] = []
"""The work whose progress is shown."""


@contextlib.contextmanager
def _bar(work: _Work) -> Iterator[None]:
    """Show a bar, which moves to and fro in phases without a percentage."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = [BarColumn(), TextColumn("{task.description}")]
    if console.width >= WIDE:
        columns.append(TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        bar.add_task(str(work), total=None)
        (task,) = bar.tasks

        def update() -> None:
            task.description, task.completed = str(work), work.done
            task.total = None if work.phase or not work.done else work.total

        work.update = update
        yield


@contextlib.contextmanager
def _lines(work: _Work) -> Iterator[None]:
    """Print a line for each 10 %, for a slow phase without a percentage, and after a long time without a line.

    Work that ends soon prints nothing.
    """
    created = printed = time.monotonic()
    tenths, phase = 0, ""
    ended, lock = threading.Event(), threading.Lock()

    def update() -> None:
        nonlocal tenths, phase, printed
        with lock:
            silent = time.monotonic() - printed
            is_slow_phase = work.phase in (LOADING, FINISHING) and work.phase != phase and silent >= SLOW
            is_tenth = work.percent // 10 > tenths and time.monotonic() - created >= SLOW
            if is_tenth:
                say(work.share)
            elif is_slow_phase or silent >= ALIVE:
                say(str(work))
                phase = work.phase
            else:
                return
            tenths, printed = work.percent // 10, time.monotonic()

    def repeat() -> None:
        while not ended.wait(PERIOD):
            update()

    work.update = update
    threading.Thread(target=repeat, daemon=True).start()
    try:
        yield
    finally:
        ended.set()


def announce_compilation() -> None:
    """Print a message, once, when the simulator is compiled, which happens when it first runs on a machine."""
    from crowdbench.utils.compiled import on_first_compilation

    on_first_compilation(_tell_compilation)


def _tell_compilation() -> None:
    for work in _shown:
        if work.phase == LOADING:
            work.phase = COMPILING
            work.update()
    if not (_shown and sys.stderr.isatty()):
        _say_compilation()


@functools.cache
def _say_compilation() -> None:
    say("compiling what has not run on this machine before (takes some seconds; later runs use a cache)")
