"""Standard input, output and errors: there in any case, and able to print any text."""

from __future__ import annotations

import os
import sys


def prepare() -> None:
    """Open what was closed, and let characters that an encoding lacks appear as escapes.

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


def flush() -> None:
    """Write what was printed. Raises OSError where it cannot be written, once: not again when Python ends."""
    try:
        sys.stdout.flush()
    except OSError:
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise
