"""Messages while a command works, on standard error: progress, and the wait for the compiler."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

PLAIN_INTERVAL = 5.0
"""Seconds between two lines of progress, where there is no terminal."""

EARLY = 0.02
"""Share of the work after which the time left is shown."""


@contextlib.contextmanager
def progress(total: int, what: str, percent: bool = False) -> Iterator[Callable[[int], None]]:
    """Show the progress of some work: a bar on a terminal, lines of text elsewhere.

    The time left is estimated as if each piece of work took as long as those before.

    Args:
        total: The pieces of work: 100 where `percent` is set.
        what: What they are called, such as `cases`.
        percent: Whether to show `11 %` instead of `11 of 100`.

    Yields:
        A function to be called with the number of pieces that were finished since its last call.
    """
    if sys.stderr.isatty():
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        times = TimeElapsedColumn(), TimeRemainingColumn()
        count = TextColumn("{task.percentage:.0f} %") if percent else MofNCompleteColumn()
        columns = (TextColumn("{task.description}"), BarColumn(), count, *times)
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(what, total=total)
            yield lambda done: bar.advance(task, done)
        return
    start = last = time.monotonic()
    done_so_far = 0

    def tell(done: int) -> None:
        nonlocal done_so_far, last
        done_so_far += done
        if time.monotonic() - last >= PLAIN_INTERVAL:
            last = time.monotonic()
            left = (last - start) * (total - done_so_far) / max(done_so_far, 1)
            # Not after the first one, because all of a batch start together and end at almost the same time.
            told = done_so_far > EARLY * total
            count_so_far = f"{done_so_far} %" if percent else f"{done_so_far} of {total}"
            say(f"{count_so_far} {what}" + (f", about {_duration(left)} left" if told else ""))

    yield tell


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def say(text: str) -> None:
    """Print a message that is not a result. Where standard error is closed or full, nobody reads it."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def announce_compilation() -> None:
    """Print a message when the simulator is compiled, which happens when it first runs on a machine."""
    from crowdbench.compiled import on_first_compilation

    on_first_compilation(
        lambda: say("compiling the simulator for this machine (once, takes some seconds; later runs use a cache)")
    )
