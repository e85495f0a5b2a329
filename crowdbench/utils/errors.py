"""Errors that are raised for wrong input of users, and for errors of plug-ins."""

from __future__ import annotations

import contextlib
import difflib
import inspect
import math
import os
import signal
import sysconfig
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

Item = TypeVar("Item")

LONGEST = 500
"""Largest number of printed characters of an external message."""

MANY = 30
"""Number of names above which an error shows similar names only."""

INSTALLED = (str(Path(__file__).parents[1]), *map(sysconfig.get_path, ("stdlib", "purelib", "platlib")))
"""Folders of crowdbench, of Python and of installed packages."""


class InputError(ValueError):
    """Raised for wrong input of the user. The message is one sentence: the error, its location, and valid values."""


class MachineFault(InputError):
    """A fault of the machine, or of the installation, never of a plug-in."""


class NotWritten(MachineFault):
    """A file or folder cannot be written."""


class Interrupted(KeyboardInterrupt):
    """Ctrl-C or SIGTERM has arrived. Only crowdbench's own handlers raise it, never a plug-in."""


@contextlib.contextmanager
def plugin_errors(beginning: str, where: str = "") -> Iterator[None]:
    """Turn any exception of a plug-in, even SystemExit, into an InputError.

    Args:
        beginning: Beginning of the sentence, such as `metric mine raised`. The exception's type and message follow.
        where: Text between type and message, such as ` in reset()`.

    Raises:
        InputError: The plug-in raised an exception. An InputError of the plug-in is not changed.
        KeyboardInterrupt: The user interrupted it.
    """
    try:
        yield
    except BaseException as error:
        if isinstance(error, InputError) or is_interrupt(error):
            raise
        raise InputError(f"{beginning} {describe_error(error, where)}") from error


def is_interrupt(error: BaseException) -> bool:
    """Return whether an exception comes from Ctrl-C or SIGTERM, not from a plug-in that raises KeyboardInterrupt."""
    # With Python's default handler, the two cannot be distinguished.
    has_handler = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return isinstance(error, Interrupted if has_handler else KeyboardInterrupt)


def describe_error(error: BaseException, where: str = "") -> str:
    """Return an exception in one line: its type, its message if it can be read, and the line of a user's file.

    Args:
        where: Text between type and message, such as ` in reset()`.
    """
    try:
        message = " ".join(str(error).split())[:LONGEST]
    except BaseException as unreadable:
        if is_interrupt(unreadable):
            raise
        message = "its message cannot be read"
    sentence = f"{type(error).__name__}{where}"
    if message:
        sentence += f": {message}"
    return sentence + line_of(traceback.walk_tb(error.__traceback__))


def line_of(frames: Iterable[tuple[FrameType, int]]) -> str:
    """Return the innermost line outside of installed packages, as `, in line 8 of mine.py`; empty if there is none.

    Args:
        frames: Frames with their line numbers, the innermost last.
    """
    place = ""
    for frame, number in frames:
        file = frame.f_code.co_filename
        if not file.startswith(("<", *INSTALLED)):
            place = f", in line {number} of {Path(file).name}"
    return place


def is_integer(value: Any) -> bool:
    """Return whether a value is a whole number, and not True or False."""
    return isinstance(value, int) and not isinstance(value, bool)


def is_number(value: Any) -> bool:
    """Return whether a value is a number, and neither True, False nor NaN."""
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def require(name: str, value: object, good: bool, right: str) -> None:
    """Raise InputError with the value called `name` and the valid values, `right`, unless `good` is true."""
    if not good:
        text = repr(value)
        shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
        raise InputError(f"{name} is {shown}, but must be {right}")


def takes_arguments(function: Callable[..., Any], number: int) -> bool:
    """Return whether a function can be called with a number of arguments; True if its signature is unknown."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return True
    try:
        signature.bind(*range(number))
    except TypeError:
        return False
    return True


def require_options(options: object) -> None:
    """Raise InputError unless options of a plug-in are None or values by name."""
    is_table = isinstance(options, Mapping) and all(isinstance(name, str) for name in options)
    require("options", options, options is None or is_table, "a table such as {'speed': 0.5}")


def require_count(name: str, value: object, most: int | None = None) -> None:
    """Raise InputError unless the value called `name` is a whole number above 0, and not above `most`."""
    is_count = is_integer(value) and value >= 1 and (most is None or value <= most)  # type: ignore[operator]
    require(name, value, is_count, "a whole number, 1 or more" if most is None else f"a whole number from 1 to {most}")


def require_positive(name: str, value: object) -> None:
    """Raise InputError unless the value called `name` is a finite number above 0."""
    require(name, value, is_number(value) and 0.0 < value < math.inf, "a number above 0")  # type: ignore[operator]


def require_not_negative(name: str, value: object) -> None:
    """Raise InputError unless the value called `name` is a finite number, 0 or more."""
    require(name, value, is_number(value) and 0.0 <= value < math.inf, "a number, 0 or more")  # type: ignore[operator]


def find_named(kind: str, name: str, known: Mapping[str, Item], suffix: str = "") -> Item:
    """Return the item that has a name. Raises InputError with similar or all known names if no item has it.

    Args:
        kind: The noun for each of them, such as `planner`.
        known: The items by their names.
        suffix: Suffix of the files in which users define others, such as `.py`; empty if they cannot.
    """
    if name not in known:
        files, hint = [], ""
        if suffix:
            hint = f", or give a file: ./mine{suffix}"
            if os.path.isfile(name + suffix):
                files = [f"./{name}{suffix}"]
        meant = did_you_mean(name, known, files)
        shown = "there are " + ", ".join(known)
        if meant and len(known) > MANY:
            shown = "see crowdbench list"
        raise InputError(f"no {kind} is called {name!r}{meant}; {shown}{hint}")
    return known[name]


def did_you_mean(name: str, known: Iterable[str], files: Sequence[str] = ()) -> str:
    """Return ` (did you mean A or B?)` with names that resemble a name or contain it as a word; else empty.

    Args:
        known: The existing names.
        files: Files of that name, which come first.
    """
    names = list(known)
    close = difflib.get_close_matches(name, names, 2)
    if not close:
        close = [other for other in names if name in other.split("_")]
    meant = [*files, *close][:2]
    return f" (did you mean {' or '.join(meant)}?)" if meant else ""
