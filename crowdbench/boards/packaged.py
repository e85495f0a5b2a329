"""Planners that an entry does not hold: those that are built in, and those of installed packages."""

from __future__ import annotations

import importlib.metadata

from crowdbench import catalog
from crowdbench.boards.entry import PLANNER, EntrySpec
from crowdbench.errors import InputError


def package(planner: str) -> str:
    """The distribution with its version that a planner comes from; empty for one whose files are in its entry.

    Args:
        planner: The planner as its entry names it.
    """
    if _is_in_entry(planner):
        return ""
    for entry in _installed():
        if entry.name == planner and entry.dist is not None:
            return f"{entry.dist.name}=={entry.dist.version}"
    return f"crowdbench=={importlib.metadata.version('crowdbench')}"


def package_files(planner: str) -> dict[str, str]:
    """The sha256 of the Python files of such a planner, by path; none for one whose files are in its entry.

    Args:
        planner: The planner as its entry names it.

    Raises:
        InputError: There is none of that name. It is not loaded: an entry may name anything.
    """
    if _is_in_entry(planner):
        return {}
    built_in = [path.stem for path in catalog.PLANNERS.folder.glob("*.py")]
    if planner not in built_in and all(planner != entry.name for entry in _installed()):
        raise InputError(f"no planner that is built in or installed is called {planner!r}")
    return catalog.PLANNERS.files(planner)


def changed(spec: EntrySpec) -> str:
    """What is another planner here than the one that was entered, in a sentence; empty where it is the same.

    Args:
        spec: The entry.

    Raises:
        InputError: There is no such planner.
    """
    if (here := package(spec.planner)) != spec.package:
        return f"the planner is of {spec.package}, but {here} is installed"
    if package_files(spec.planner) != spec.package_files:
        return f"the files of the planner {spec.planner} are others than those that were entered"
    return ""


def _installed() -> importlib.metadata.EntryPoints:
    return importlib.metadata.entry_points(group=catalog.PLANNERS.entry_points)


def _is_in_entry(planner: str) -> bool:
    return planner.startswith(f"{PLANNER}/")
