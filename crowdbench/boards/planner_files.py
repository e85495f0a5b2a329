"""The files of an entry's planner: copied into the entry and found there, or those of a package that it names."""

from __future__ import annotations

import filecmp
import functools
import importlib.metadata
import itertools
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.boards.entry import MAINTAINERS, PLANNER, Entry
from crowdbench.plugins.files import file_digests
from crowdbench.plugins.load import file_and_function
from crowdbench.utils.errors import InputError

LARGEST = 25e6
"""Bytes that the files of an entry may have together before it has runs: entries are kept in git."""


def copy_named_files(value: Any, folder: Path) -> Any:
    """Copy the files that a planner or the value of an option names into an entry.

    Args:
        value: The planner, or the value of an option: a text, or a table or list in which there may be texts.
        folder: The folder of the entry.

    Returns:
        The same with the names that the files have in the entry.

    Raises:
        InputError: A file cannot be read, or a folder is named.
    """
    return _map_texts(functools.partial(_copy, copies=folder / PLANNER), value)


def locate_named_files(value: Any, folder: Path) -> Any:
    """The planner of an entry, or the value of an option, with the full paths of the files that the entry holds."""
    return _map_texts(functools.partial(_locate, folder=folder.resolve()), value)


def _map_texts(change: Callable[[str], str], value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _map_texts(change, each) for name, each in value.items()}
    if isinstance(value, list):
        return [_map_texts(change, each) for each in value]
    return change(value) if isinstance(value, str) else value


def _copy(value: str, copies: Path) -> str:
    """Copy the files that a text names, and return how the entry names them; the text where it names none."""
    file, function = file_and_function(value)
    path = file or Path(value)
    try:
        if path.is_dir() and "/" in value:
            raise InputError(f"{value} is a folder: an entry takes files that are named one by one")
        if not path.is_file():
            return value
        path = path.resolve()  # the files beside a linked one are those beside its target
        names = list(file_digests(path))
        places = itertools.chain([copies], (copies / f"other_{number}" for number in itertools.count(2)))
        target = next(place for place in places if _is_free(place, path.parent, names))
        for name in names:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path.parent / name, target / name)  # with its permissions: it may be a program
    except (OSError, ValueError) as error:
        raise InputError(f"{value} cannot be copied: {getattr(error, 'strerror', None) or error}") from None
    inside = (target / path.name).relative_to(copies.parent).as_posix()
    return f"{inside}:{function}" if function else inside


def _is_free(place: Path, source: Path, names: list[str]) -> bool:
    """Whether files have the same contents in a folder, or are not there."""
    return all(not (place / name).exists() or filecmp.cmp(place / name, source / name, shallow=False) for name in names)


def _locate(value: str, folder: Path) -> str:
    file, function = file_and_function(value)
    path = folder / (file or value)
    if "/" not in value or not path.is_file():
        return value
    return f"{path}:{function}" if function else str(path)


def check_size(folder: Path) -> None:
    """Raise InputError where the files of an entry are too large."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > LARGEST:
        raise InputError(f"the planner's files have {size / 1e6:.0f} MB, but an entry may have {LARGEST / 1e6:g} MB")


def package(planner: str) -> str:
    """The distribution with its version that a planner comes from; empty for one whose files are in its entry."""
    if _is_in_entry(planner):
        return ""
    source = catalog.PLANNERS.sources().get(planner)
    if isinstance(source, importlib.metadata.EntryPoint) and source.dist is not None:
        return f"{source.dist.name}=={source.dist.version}"
    return f"crowdbench=={importlib.metadata.version('crowdbench')}"


def package_files(planner: str) -> dict[str, str]:
    """The sha256 of the Python files of such a planner, by path; none for one whose files are in its entry.

    Raises:
        InputError: There is none of that name. It is not loaded: an entry may name anything.
    """
    if _is_in_entry(planner):
        return {}
    if planner not in catalog.PLANNERS.sources():
        raise InputError(f"no planner that is built in or installed is called {planner!r}")
    return catalog.PLANNERS.files(planner)


def imported_code(planner: str, options: Mapping[str, Any], folder: Path) -> str:
    """Return the digest of the code of crowdbench that the planner of an entry imports; nothing is loaded."""
    return catalog.planner_code(*(locate_named_files(each, folder) for each in (planner, options)))


def describe_change(entry: Entry) -> str:
    """Say in a sentence how the planner here differs from the one that was entered; empty where it is the same.

    Raises:
        InputError: There is no such planner.
    """
    spec = entry.spec
    if (here := package(spec.planner)) != spec.package:
        return f"the planner is of {spec.package}, but {here} is installed"
    if package_files(spec.planner) != spec.package_files:
        return f"the files of the planner {spec.planner} are others than those that were entered"
    if imported_code(spec.planner, spec.options, entry.directory) != spec.code:
        return f"the code of crowdbench that the planner {spec.planner} imports is another than when it was entered"
    return ""


def has_changed(entry: Entry) -> bool:
    """Check if the planner of an entry has other code here; False for a package that is not installed."""
    spec = entry.spec
    try:
        here = package_files(spec.planner), imported_code(spec.planner, spec.options, entry.directory)
    except InputError:
        return spec.package.startswith(f"{MAINTAINERS}==")
    return here != (spec.package_files, spec.code)


def _is_in_entry(planner: str) -> bool:
    return planner.startswith(f"{PLANNER}/")
