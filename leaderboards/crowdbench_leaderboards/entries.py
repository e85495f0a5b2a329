"""The entries of a board: who they are, and which of them are left out.

An entry that is damaged, or that has the name of another one, is left out with a reason. Of two entries with the same
name, the one that was merged first stays. No entry can stop the others.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import PLANNERS, InputError
from crowdbench.isolation import one_line
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.entry import ENTRIES, ENTRY, CardSpec, Entry, read_entry
from crowdbench_leaderboards.planner_files import named_externals
from crowdbench_leaderboards.shipped import CARDS, ShippedSpec, read_shipped


@dataclass(frozen=True)
class BoardEntries:
    """The entries of a board.

    Attributes:
        good: The entries in the order in which they were merged.
        bad: The reasons of those that are left out, by name.
        shipped: The planners that the maintainers enter, by the name of the entry.
    """

    good: list[Entry]
    bad: dict[str, str]
    shipped: Mapping[str, ShippedSpec]


def read_entries(board: Board, root: Path) -> BoardEntries:
    """Read the entries of a board. Raises InputError only if `shipped.toml` is wrong."""
    shipped, folder = read_shipped(root), root / board.name
    good: list[Entry] = []
    bad: dict[str, str] = {}
    for path in merge_order(folder / ENTRIES):
        try:
            entry = read_entry(path)
            check_entry(entry, board, root, good)
        except Exception as error:  # whatever one entry does, the others stay
            bad[one_line(path.name, 60)] = one_line(str(error) or type(error).__name__, 300)
        else:
            good.append(entry)
    return BoardEntries(good, bad, shipped)


def check_entry(entry: Entry, board: Board, root: Path, others: Iterable[Entry]) -> None:
    """Raise InputError if an entry belongs to another board, or is not what its name and account say.

    Args:
        entry: The entry.
        board: The board.
        root: The folder of boards.
        others: The entries that were merged before it.
    """
    if entry.spec.board != board.name:
        raise InputError(f"{entry.directory} is an entry of the board {entry.spec.board}, not of {board.name}")
    check_identity(entry.name, entry.spec.planner, [entry.spec.options, *entry.spec.networks], entry.card, root)
    check_free_name(entry.name, entry.card, others)


def check_identity(name: str, planner: str, options: Sequence[Mapping[str, Any]], card: CardSpec, root: Path) -> None:
    """Raise InputError unless an entry has an account and a name of its own, or is a planner of `shipped.toml`.

    Args:
        name: The name of the entry.
        planner: Its planner.
        options: The options of the planner, and those in which other networks of its method differ.
        card: Its card.
        root: The folder of boards.
    """
    listed = read_shipped(root)
    if not card.account:
        if name not in listed:
            raise InputError(f"the card of {name!r} names no account: write the login of your account, `account`")
        if why := listed[name].why_not(planner, options[0]):
            raise InputError(why)
        return
    if named_externals(list(options)):
        raise InputError(f"{name!r} names a file that is not in it: an entry holds all files of its planner")
    carded = {path.stem for path in root.glob(f"{CARDS}/*.toml")}
    reserved = {fold(each) for each in (PLANNERS.sources().keys() - {planner}) | carded | listed.keys()}
    if fold(name) in reserved or fold(card.title) in reserved:
        raise InputError(
            f"{name!r}, {card.title!r} is the name of a planner that ships, or looks like it: choose another one"
        )


def check_free_name(name: str, card: CardSpec, others: Iterable[Entry]) -> None:
    """Raise InputError if another entry has the same name or title."""
    for other in others:
        same = {fold(name), fold(card.title)} & {fold(other.name), fold(other.card.title)}
        if other.name != name and same:
            raise InputError(f"{name!r}, {card.title!r} is the name of the entry {other.name}, or looks like it")


def fold(name: str) -> str:
    """Return the letters and digits of a name in lower case, with o, l and l for the similar 0, 1 and i."""
    return re.sub("[^a-z0-9]", "", name.lower()).translate(str.maketrans("01i", "oll"))


def merge_order(folder: Path) -> list[Path]:
    """Return the folders of entries in the order in which they were merged, and others by name after them.

    Args:
        folder: The folder of the entries of a board.
    """
    present = sorted(path.parent for path in folder.glob(f"*/{ENTRY}"))
    command = "git log --first-parent -m --diff-filter=A --no-renames --name-only -z --relative --format=%x3a -- ."
    try:
        added = subprocess.run(command.split(), cwd=folder, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return present  # no repository, or no git
    place: dict[str, int] = {}
    for number, commit in enumerate(added.decode(errors="replace").split(":")):  # the last one comes first
        for path in commit.split("\0"):
            name, _, file = path.strip("\n").partition("/")
            if file == ENTRY:
                place.setdefault(name, -number)
    return sorted(present, key=lambda path: (place.get(path.name, 1), path.name))
