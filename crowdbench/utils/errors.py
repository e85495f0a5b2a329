"""The one error that is meant for the user, and how it is made of whatever a plug-in raises."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from typing import NoReturn

LONGEST = 500
"""Characters of somebody else's message that are shown."""


class InputError(ValueError):
    """Something the user gave is wrong. The message is one sentence: what, where, and what would be right."""


class MachineFault(InputError):
    """A fault of the machine, or of the installation, never of a plug-in."""


class NotWritten(MachineFault):
    """A file or folder cannot be written."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM has arrived. Only crowdbench's own handlers raise it, never a plug-in."""


class plugin_errors:
    """Turn whatever a plug-in raises, even SystemExit, into an InputError. A process that it forks ends here.

    Args:
        beginning: How the sentence begins, such as `metric mine raised`. The exception's type and message follow.
        where: What is put between type and message, such as ` in reset()`.

    Raises:
        InputError: The plug-in raised something. An InputError of its own stays as it is.
        KeyboardInterrupt: Somebody interrupted it.
    """

    # A class, and not `with one_process(...)`: the policies of pedestrians are asked in here in every step, and a
    # generator would take as long as all the rest of asking them.
    __slots__ = ("_beginning", "_process", "_where")

    def __init__(self, beginning: str, where: str = "") -> None:
        self._beginning, self._where = beginning, where

    def __enter__(self) -> None:
        self._process = os.getpid()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if os.getpid() != self._process:
            _end_fork("a plug-in", error)
        if error is not None and not (isinstance(error, InputError) or is_interrupt(error)):
            raise InputError(f"{self._beginning} {describe_error(error, self._where)}") from error


@contextlib.contextmanager
def one_process(who: str) -> Iterator[None]:
    """End a process that is forked in here and comes out of here: it would write, and remove, the same files.

    Args:
        who: What forks, for the message.
    """
    process = os.getpid()
    try:
        yield
    except BaseException as error:
        if os.getpid() == process:
            raise
        _end_fork(who, error)
    if os.getpid() != process:
        _end_fork(who, None)


def _end_fork(who: str, error: BaseException | None) -> NoReturn:
    """End a forked process, quietly where it asks for that by SystemExit."""
    if isinstance(error, SystemExit) and isinstance(error.code, int | None):
        os._exit(error.code or 0)
    message = (
        f"crowdbench: a process that {who} has forked went on with the run, and was ended: end it by os._exit(0)\n"
    )
    with contextlib.suppress(OSError):  # the stream may be closed
        os.write(2, message.encode(errors="backslashreplace"))
    os._exit(1)


def is_interrupt(error: BaseException) -> bool:
    """Whether an exception comes from Ctrl-C or SIGTERM, and not from a plug-in that raises KeyboardInterrupt."""
    # Where Python's own handler is in place, the two look alike.
    own = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return isinstance(error, Interrupted if own else KeyboardInterrupt)


def describe_error(error: BaseException, where: str = "") -> str:
    """An exception in one line: its type, and its message if it has one that can be read.

    Args:
        error: The exception.
        where: What is put between the two, such as ` in reset()`.
    """
    try:
        message = " ".join(str(error).split())[:LONGEST]
    except BaseException as unreadable:
        if is_interrupt(unreadable):
            raise
        message = "its message cannot be read"
    return f"{type(error).__name__}{where}" + (f": {message}" if message else "")
