"""Text for readers: in lines as wide as the terminal, whose words are not broken, and in colour."""

from __future__ import annotations

import contextlib
import os
import sys
import textwrap
from typing import TextIO

GOOD, BAD = "green", "red"
"""Colours of successes and of failures."""

COMMAND = ": crowdbench "
"""The text before a command at the end of a line."""


def width(stream: TextIO) -> int | None:
    """Return the number of columns of a terminal; None for other streams, such as files."""
    if not stream.isatty():
        return None
    with contextlib.suppress(ValueError):
        return max(1, int(os.environ.get("COLUMNS", "")))
    with contextlib.suppress(OSError, ValueError):
        return os.get_terminal_size(stream.fileno()).columns or None
    return None


def say(text: str, color: str = "") -> None:
    """Print a message that is not a result. It is lost if standard error is closed or full."""
    with contextlib.suppress(OSError, ValueError):
        _print(text, sys.stderr, color)


def write(text: str, color: str = "") -> None:
    """Print a text that is a result."""
    _print(text, sys.stdout, color)


def _print(text: str, stream: TextIO, color: str) -> None:
    columns = width(stream)
    if columns is not None:
        text = "\n".join(part for line in text.split("\n") for part in _wrap(line, columns))
    if color:
        from rich.console import Console

        Console(file=stream, markup=False, highlight=False, emoji=False).print(text, style=color, soft_wrap=True)
    else:
        print(text, file=stream)
    stream.flush()


def _wrap(line: str, columns: int) -> list[str]:
    """Return a line as lines that break at spaces. A command at its end is not broken, so that it can be copied."""
    if len(line) <= columns:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()))
    prose, _, command = line.partition(COMMAND)
    lines = textwrap.wrap(
        f"{prose}:" if command else prose,
        columns,
        subsequent_indent=indent and f"{indent}  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [*lines, f"{indent}  {COMMAND.strip(' :')} {command}"] if command else lines
