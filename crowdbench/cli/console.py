"""Output of commands: progress, the wait for the compiler and errors on standard error, tables, and the streams."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import NamedTuple

from typer.exceptions import TyperException

from crowdbench.utils.errors import InputError, Interrupted, describe_error
from crowdbench.utils.tables import Grid

PLAIN_INTERVAL = 5.0
"""Seconds between two lines of progress, where there is no terminal."""

KNOWN_AFTER = 2.0
"""Seconds after the first piece of work, from which on the time left is estimated."""

DEBUG = "--debug"

INTERRUPTED = 130
"""The exit status after Ctrl-C."""

NOTHING_KEPT = "interrupted: nothing was kept"

INTERNAL = 3
"""The exit status after an error of crowdbench itself."""

LONGEST = 1000
"""Characters of a sentence that are shown: what was wrong may be a text of any length."""


@contextlib.contextmanager
def progress(total: float, what: str = "") -> Iterator[Callable[[float], None]]:
    """Show the progress of some work: a bar on a terminal, lines of text elsewhere.

    Args:
        total: The pieces of work.
        what: What is shown after the share that is done, such as `of 8 scenes`; `of TOTAL cases` if empty.

    Yields:
        A function to be called with the number of pieces, or parts of them, that were done since its last call.
    """
    work = _Work(total, what or f"of {total} cases")
    if not sys.stderr.isatty():
        yield work.print
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
    """How much of some work is done, and how long the rest takes.

    The time left is estimated as if each piece of work took as long as those after the first report: what comes before
    is compilation and the loading of files.
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
        """Count work, and print a line now and then."""
        self.add(done)
        # The end is told after other lines only, because what comes then, such as intervals, may take its time too.
        is_end = self.percent == 100 and self.printed > self.created
        if is_end or time.monotonic() - self.printed >= PLAIN_INTERVAL:
            self.printed = time.monotonic()
            say(str(self))

    @property
    def percent(self) -> int:
        """Rounded down, so that 100 is all of it; the parts of a piece sum to it only up to rounding."""
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
    """Print a message that is not a result. Where standard error is closed or full, nobody reads it."""
    with contextlib.suppress(OSError, ValueError):
        print(text, file=sys.stderr, flush=True)


def announce_compilation() -> None:
    """Print a message when the simulator is compiled, which happens when it first runs on a machine."""
    from crowdbench.utils.compiled import on_first_compilation

    on_first_compilation(
        lambda: say("compiling what has not run on this machine before (takes some seconds; later runs use a cache)")
    )


class Failure(NamedTuple):
    """What an exception means for a user: one sentence, and the exit status."""

    sentence: str
    status: int


def failure(error: BaseException) -> Failure | None:
    """What went wrong; None for an exit with a status other than 0, which has said it already.

    Args:
        error: What a command raised.
    """
    if isinstance(error, SystemExit) and error.code:
        return None
    if isinstance(error, Interrupted):
        return Failure(NOTHING_KEPT, INTERRUPTED)
    if isinstance(error, TyperException):
        return Failure(_one_line(error.format_message()), 2)
    if isinstance(error, InputError):
        return Failure(_one_line(with_notes(str(error), error)), 1)
    if isinstance(error, MemoryError):
        advice = "ask for fewer cases at once (--batch), fewer pedestrians or shorter episodes"
        return Failure(f"there is not enough memory: {advice}", 1)
    if isinstance(error, OSError):
        place = "the output" if error.filename is None else error.filename
        return Failure(_one_line(f"{place} cannot be written or read: {error.strerror or error}"), 1)
    if isinstance(error, UnicodeEncodeError) and error.reason == "surrogates not allowed":
        name = error.object.encode("utf-8", "backslashreplace").decode()
        return Failure(_one_line(f"'{name}' is not UTF-8, as this command needs it: rename the file or folder"), 1)
    if getattr(sys.stdout, "closed", True):
        return Failure("the output cannot be written: a plug-in has closed it", 1)
    request = f"please report it, with the traceback that {DEBUG} shows"
    return Failure(_one_line(f"an error in crowdbench itself, {describe_error(error)}: {request}"), INTERNAL)


def with_notes(sentence: str, error: BaseException) -> str:
    """The sentence on an error with its notes, which say what it leaves behind."""
    return ": ".join([sentence, *getattr(error, "__notes__", [])])


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


@contextlib.contextmanager
def exit_on_interrupt(message: str | Callable[[], str] = "") -> Iterator[None]:
    """Say what an interrupted command has kept, and exit. Typer would end the command without a word.

    Args:
        message: What is kept, or a function that says it after the interrupt. If empty, what the interrupt itself says
            is printed; an interrupt that says nothing is passed on.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        if not (message or str(error) or hasattr(error, "__notes__")):
            raise
        said = message if isinstance(message, str) else message()
        say(f"crowdbench: {f'interrupted: {said}' if said else with_notes(str(error) or 'interrupted', error)}")
        sys.exit(INTERRUPTED)


def prepare_streams() -> None:
    """Open standard streams that were closed, and let characters that an encoding lacks appear as escapes.

    Paths may hold bytes that are no text, and tables hold characters that ASCII lacks.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest number, which else the next file would get, with all that is printed in it.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))
        elif number and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def flush_output() -> None:
    """Write what was printed. Raises OSError where it cannot be written, once: not again when Python ends."""
    try:
        sys.stdout.flush()
    except OSError:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise


def print_table(table: Grid, colours: Mapping[str, str] = MappingProxyType({})) -> None:
    """Print a table under its title.

    Args:
        table: The table.
        colours: The colours of cells on a terminal, by their text.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # On a line of its own, because rich wraps a title at the table's width.
    print(table.title)
    printed = Table(box=None, pad_edge=False)
    for heading, alignment in zip(table.header, table.align, strict=True):
        printed.add_column(heading, justify="left" if alignment == "l" else "right")
    for row in table.rows:
        printed.add_row(*(Text(cell, colours[cell]) if cell in colours else cell for cell in row))
    # A file or a pipe has no width to fit. Brackets are units, not rich's markup.
    Console(width=None if sys.stdout.isatty() else 200, markup=False).print(printed)
