"""Messages on standard error about the progress of long work, and about compilation."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

PLAIN_INTERVAL = 2.5
"""Seconds between two lines of progress, if there is no terminal."""

KNOWN_AFTER = 2.0
"""Seconds after the first piece of work before the remaining time is estimated."""


@contextlib.contextmanager
def progress(total: float, what: str = "") -> Iterator[Callable[[float], None]]:
    """Show the progress of some work: a bar on a terminal, elsewhere a line of text every few seconds.

    Args:
        total: The pieces of work.
        what: Text after the share that is done, such as `of 8 scenes`; `of TOTAL cases` if empty.

    Yields:
        A function to be called with the number of pieces, or parts of them, that were done since its last call.
    """
    work = _Work(total, what or f"of {total} cases")
    if not sys.stderr.isatty():
        ended = threading.Event()
        threading.Thread(target=work.repeat, args=(ended,), daemon=True).start()
        try:
            yield work.print
        finally:
            ended.set()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = BarColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(str(work), total=total)

        def show(done: float) -> None:
            work.add(done)
            bar.update(task, completed=work.done, description=str(work))

        yield show


class _Work:
    """Progress of some work, and the remaining time.

    The remaining time is estimated from the mean time of pieces of work after the first report. The time before that is
    compilation and the loading of files.
    """

    def __init__(self, total: float, what: str) -> None:
        self.total, self.what = total, what
        self.done = self.before = 0.0
        self.created = self.printed = time.monotonic()
        self.start: float | None = None

    def add(self, done: float) -> None:
        """Count work that was done since the last call."""
        self.done += done
        if self.start is None:
            self.before, self.start = self.done, time.monotonic()

    def print(self, done: float) -> None:
        """Count work, and print a line every few seconds."""
        self.add(done)
        self.show()

    def show(self, more: str = "") -> None:
        """Print a line, unless the last one was less than `PLAIN_INTERVAL` ago."""
        # 100 % is printed only after other lines, because later work, such as intervals, may also take long.
        is_end = self.percent == 100 and self.printed > self.created
        if is_end or time.monotonic() - self.printed >= PLAIN_INTERVAL:
            self.printed = time.monotonic()
            say(f"{self}{more}")

    def repeat(self, ended: threading.Event) -> None:
        """Print lines also while nothing is reported, such as during compilation, until the work has ended."""
        while not ended.wait(PLAIN_INTERVAL):
            self.show(", finishing" if self.percent == 100 else "")

    @property
    def percent(self) -> int:
        """Percentage of finished work, rounded down: 100 is all of it, up to rounding in sums of parts."""
        return int(100 * self.done / self.total + 1e-6) if self.total else 100

    def __str__(self) -> str:
        elapsed = 0.0 if self.start is None else time.monotonic() - self.start
        text = f"{self.percent} % {self.what}"
        if self.percent == 100 or elapsed < KNOWN_AFTER or self.done == self.before:
            return text
        seconds = elapsed * (self.total - self.done) / (self.done - self.before)
        left = f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
        return f"{text}, about {left} left"


def say(text: str) -> None:
    """Print a message that is not a result. It is lost if standard error is closed or full."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def announce_compilation() -> None:
    """Print a message when the simulator is compiled, which happens when it first runs on a machine."""
    from crowdbench.utils.compiled import on_first_compilation

    on_first_compilation(
        lambda: say("compiling what has not run on this machine before (takes some seconds; later runs use a cache)")
    )
