"""Copies what a planner consists of into an entry: its Python files, and the files that its options name."""

from __future__ import annotations

import filecmp
import itertools
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crowdbench import catalog, plugins
from crowdbench.boards.entry import PLANNER
from crowdbench.errors import InputError

LARGEST = 25e6
"""Bytes that the files of an entry may have together before it has runs: entries are kept in git."""


def copied_value(value: Any, folder: Path) -> Any:
    """Copy the files that a planner or the value of an option names into an entry.

    Args:
        value: The planner, or the value of an option: a text, or a table or list in which there may be texts.
        folder: The folder of the entry.

    Returns:
        The same with the names that the files have in the entry.

    Raises:
        InputError: A file cannot be read, or a folder is named.
    """
    if isinstance(value, Mapping):
        return {name: copied_value(each, folder) for name, each in value.items()}
    if isinstance(value, list):
        return [copied_value(each, folder) for each in value]
    return (_copied(value, folder / PLANNER) or value) if isinstance(value, str) else value


def check_size(folder: Path) -> None:
    """Raise InputError where the files of an entry are too large."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > LARGEST:
        raise InputError(f"the planner's files have {size / 1e6:.0f} MB, but an entry may have {LARGEST / 1e6:g} MB")


def _copied(value: str, copies: Path) -> str | None:
    """Copy the files that a text names, and return how the entry names them; None where it names none."""
    file, function = plugins.file_and_function(value)
    path = file or Path(value)
    try:
        if path.is_dir() and "/" in value:
            raise InputError(f"{value} is a folder: an entry takes files that are named one by one")
        if not path.is_file():
            return None
        path = path.resolve()  # the files beside a linked one are those beside its target
        names = list(catalog.PLANNERS.files(str(path))) if file else _beside(path)
        target = next(place for place in _places(copies) if _is_free(place, path.parent, names))
        for name in names:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path.parent / name, target / name)  # with its permissions: it may be a program
    except (OSError, ValueError) as error:
        raise InputError(f"{value} cannot be copied: {getattr(error, 'strerror', None) or error}") from None
    inside = (target / path.name).relative_to(copies.parent).as_posix()
    return f"{inside}:{function}" if function else inside


def _places(copies: Path) -> Any:
    """Folders for files, one of which has no other file of the same name."""
    return itertools.chain([copies], (copies / f"other_{number}" for number in itertools.count(2)))


def _is_free(place: Path, source: Path, names: list[str]) -> bool:
    """Whether files have the same contents in a folder, or are not there."""
    return all(not (place / name).exists() or filecmp.cmp(place / name, source / name, shallow=False) for name in names)


def _beside(path: Path) -> list[str]:
    """The names of a file and, if these are weights, of their card."""
    card = path.with_suffix(".json")
    return [path.name, card.name] if path.suffix == ".safetensors" and card.is_file() else [path.name]
