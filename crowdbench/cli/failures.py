"""What the command line says of an exception, and its exit status."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from typer.exceptions import TyperException

from crowdbench.cli.console import say
from crowdbench.utils.errors import InputError, Interrupted, describe_error

DEBUG = "--debug"

INTERRUPTED = 130
"""The exit status after Ctrl-C."""

NOTHING_KEPT = "interrupted: nothing was kept"

INTERNAL = 3
"""The exit status after an error of crowdbench itself."""

LONGEST = 1000
"""Characters of a sentence that are shown: what was wrong may be a text of any length."""


@dataclass(frozen=True)
class Failure:
    """One sentence, and the exit status."""

    sentence: str
    status: int


def failure(error: BaseException) -> Failure | None:
    """What went wrong; None for an exit with a status other than 0, which has told it already.

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
        return Failure(_one_line(str(error)), 1)
    if isinstance(error, MemoryError):
        advice = "ask for fewer cases at once (--batch), fewer pedestrians or shorter episodes"
        return Failure(f"there is not enough memory: {advice}", 1)
    if isinstance(error, OSError):
        place = "the output" if error.filename is None else error.filename
        return Failure(_one_line(f"{place} cannot be written or read: {error.strerror or error}"), 1)
    if getattr(sys.stdout, "closed", True):
        return Failure("the output cannot be written: a plug-in has closed it", 1)
    told = f"please report it, with the traceback that {DEBUG} shows"
    return Failure(_one_line(f"an error in crowdbench itself, {describe_error(error)}: {told}"), INTERNAL)


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


@contextlib.contextmanager
def exit_on_interrupt(kept: str | Callable[[], str] = "") -> Iterator[None]:
    """Say what an interrupted command has kept, and exit. Typer would end the command without a word.

    Args:
        kept: What is kept, or what says it after the interrupt. If empty, what the interrupt itself says is printed;
            an interrupt that says nothing is passed on.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        sentence = f"interrupted: {kept if isinstance(kept, str) else kept()}" if kept else str(error)
        if not sentence:
            raise
        say(f"crowdbench: {sentence}")
        sys.exit(INTERRUPTED)
