"""Reads what commands keep for figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from crowdbench.utils.errors import InputError
from crowdbench.utils.files import read_text


def read_kept(path: Path, command: str, *keys: tuple[str | int, ...]) -> dict[str, Any]:
    """Read a file that a command wrote.

    Args:
        path: The file.
        command: The command, without the name of the program.
        keys: Where there must be something in it.

    Returns:
        What it says.

    Raises:
        InputError: It cannot be read, or was not written by the command.
    """
    try:
        found: dict[str, Any] = json.loads(read_text(path))
        for each in keys:
            inside: Any = found
            for key in each:
                inside = inside[key]
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, IndexError):
        right = "give the files that it says it kept"
        raise InputError(f"{path} is not what `crowdbench {command}` writes: {right}") from None
    return found
