"""Output of commands: errors on standard error, and the streams."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

from typer.exceptions import TyperException

from crowdbench.cli.printed_tables import print_table as print_table
from crowdbench.isolation.untrusted_text import one_line
from crowdbench.utils.errors import InputError, Interrupted, describe_error
from crowdbench.utils.progress_bars import announce_compilation as announce_compilation
from crowdbench.utils.progress_bars import progress as progress
from crowdbench.utils.terminal import BAD as BAD
from crowdbench.utils.terminal import GOOD as GOOD
from crowdbench.utils.terminal import say as say
from crowdbench.utils.terminal import write as write

DEBUG = "--debug"

INTERRUPTED = 130
"""The exit status after Ctrl-C."""

NOTHING_KEPT = "interrupted: nothing was kept"

INTERNAL = 3
"""The exit status after an error of crowdbench itself."""


def failure(error: BaseException) -> tuple[str, int] | None:
    """Return the report of a command's exception for the user: one sentence, and the exit status.

    None is returned for an exit with a status other than 0, which was already reported.
    """
    if isinstance(error, SystemExit) and error.code:
        return None
    if isinstance(error, Interrupted):
        return NOTHING_KEPT, INTERRUPTED
    if isinstance(error, TyperException):
        return one_line(error.format_message().replace("Value error, ", "")), 2
    if isinstance(error, InputError):
        return one_line(with_notes(str(error), error)), 1
    if isinstance(error, MemoryError):
        advice = "ask for fewer cases at once (--batch), fewer pedestrians or shorter episodes"
        return f"there is not enough memory: {advice}", 1
    if isinstance(error, OSError):
        place = "the output" if error.filename is None else error.filename
        return one_line(f"{place} cannot be written or read: {error.strerror or error}"), 1
    if isinstance(error, RuntimeError) and str(error).startswith("Symlink loop from "):  # of Path.resolve, up to 3.12
        return one_line(f"{error}: name a file or a folder"), 1
    if isinstance(error, UnicodeEncodeError) and error.reason == "surrogates not allowed":
        name = error.object.encode("utf-8", "backslashreplace").decode()
        return one_line(f"'{name}' is not UTF-8, as this command needs it: rename the file or folder"), 1
    if getattr(sys.stdout, "closed", True):
        return "the output cannot be written: a plug-in has closed it", 1
    request = f"please report it, with the traceback that {DEBUG} shows"
    return one_line(f"an error in crowdbench itself, {describe_error(error)}: {request}"), INTERNAL


def with_notes(sentence: str, error: BaseException) -> str:
    """Return the sentence on an error with its notes, which report files that are kept."""
    return ": ".join([sentence, *getattr(error, "__notes__", [])])


@contextlib.contextmanager
def exit_on_interrupt(message: str = "") -> Iterator[None]:
    """Report the kept files of an interrupted command, and exit. Typer would exit without a message.

    Args:
        message: A note on kept files. If empty, the text of the interrupt is printed; an interrupt without text is
            raised again.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        if not (message or str(error) or hasattr(error, "__notes__")):
            raise
        report = f"interrupted: {message}" if message else with_notes(str(error) or "interrupted", error)
        say(f"crowdbench: {report}")
        sys.exit(INTERRUPTED)


def prepare_streams() -> None:
    """Open closed standard streams, and print characters that the encoding does not contain as escapes.

    Paths may contain bytes that are not text, and tables contain characters outside of ASCII.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            # It gets the lowest free number. Otherwise the next opened file would get it, and all printed text.
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, os.fdopen(number, "w" if number else "r"))
        elif number and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def flush_output() -> None:
    """Flush standard output. Raises OSError if it cannot be written, but not a second time when Python exits."""
    try:
        sys.stdout.flush()
    except OSError:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise
