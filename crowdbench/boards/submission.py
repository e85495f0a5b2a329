"""Makes an entry: copies what the planner consists of, and drives the public cases of the board with the copy."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import catalog, plugins
from crowdbench.boards.board import Board
from crowdbench.boards.driving import Entrant, InUse, Progress, drive, figures, locked, run_digest
from crowdbench.boards.entry import (
    CARD,
    NAMES,
    NAMING,
    PLANNER,
    PUBLIC,
    SCHEMA,
    Entry,
    EntrySpec,
    file_digests,
    read_entry,
    write_entry,
)
from crowdbench.boards.packaged import package, package_files
from crowdbench.boards.schema import CardSpec
from crowdbench.errors import InputError
from crowdbench.evaluate.directory import new_directory
from crowdbench.evaluate.results import read_result
from crowdbench.evaluate.wanted import versions
from crowdbench.toml_file import Location, parsed, read_toml

ENTRIES = "entries"

LARGEST = 25e6
"""Bytes that the files of a planner may have together: entries are kept in git."""


@dataclass(frozen=True)
class Submission:
    """What somebody wants to enter.

    Attributes:
        board: The board.
        name: The name of the entry.
        planner: As `crowdbench run --planner` takes it.
        options: The planner's options.
        networks: The options in which other networks of the same method differ.
        card: The file of the card.
        by: Who submits it.
    """

    board: Board
    name: str
    planner: str
    options: Mapping[str, Any]
    networks: Sequence[Mapping[str, Any]]
    card: Path
    by: str

    def __post_init__(self) -> None:
        if not NAMES.fullmatch(self.name):
            raise InputError(f"{self.name!r} cannot be an entry: {NAMING}")
        if not self.by.strip():
            raise InputError("an entry needs the name of who submits it")


def submit(submission: Submission, root: Path, work: Path, progress: Progress | None = None) -> Entry:
    """Make an entry.

    Args:
        submission: What is entered.
        root: The folder of boards, in which the entry gets its folder.
        work: The folder that keeps finished runs until the entry is made.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        The entry.

    Raises:
        InputError: The entry exists, the card is wrong, or the planner cannot be loaded or breaks its contract.
        KeyboardInterrupt: Somebody interrupted it. The same call goes on with what is finished.
    """
    board = submission.board
    directory = root / board.name / ENTRIES / submission.name
    read_card(submission.card)
    name = f"submit-{board.name}-{submission.name}"
    with locked(work / name):
        if directory.exists():
            raise InUse(f"{directory} exists already: choose another name, or remove it")
        directory.parent.mkdir(parents=True, exist_ok=True)
        with new_directory(directory, overwrite=False) as folder:
            entrant = _copied(submission, folder)
            networks = [_copied_value(options, folder / PLANNER) for options in submission.networks]
            kept = work / f"{name}-{run_digest(board, entrant)}"
            drive(board, entrant, kept, cases=board.public_cases, seed=None, progress=progress)
            shutil.copytree(kept, folder / PUBLIC)
            write_entry(folder, _spec(submission, entrant, networks))
    shutil.rmtree(kept)
    return read_entry(directory)


def read_card(path: Path) -> CardSpec:
    """Read the card of an entry. Raises InputError where it is missing or wrong."""
    if not path.exists():
        raise InputError(f"there is no card {path}, which says what the planner is: `crowdbench new-planner` makes one")
    return parsed(CardSpec, read_toml(path, "card"), Location(path.name))


def _copied(submission: Submission, folder: Path) -> Entrant:
    """Copy the card, and the files of the planner and those that its options name, into the folder of an entry.

    Args:
        submission: What is entered.
        folder: The folder of the entry.

    Returns:
        The planner as the entry has it.

    Raises:
        InputError: A file cannot be read, or they are too large.
    """
    shutil.copyfile(submission.card, folder / CARD)
    copies = folder / PLANNER
    planner = _copy(submission.planner, copies) or submission.planner
    package_files(planner)  # refuses one that does not exist
    options = {name: _copied_value(value, copies) for name, value in submission.options.items()}
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > LARGEST:
        raise InputError(f"the planner's files have {size / 1e6:.0f} MB, but an entry may have {LARGEST / 1e6:g} MB")
    return Entrant(folder, planner, options)


def _copied_value(value: Any, copies: Path) -> Any:
    if isinstance(value, Mapping):
        return {name: _copied_value(each, copies) for name, each in value.items()}
    if isinstance(value, list):
        return [_copied_value(each, copies) for each in value]
    return (_copy(value, copies) or value) if isinstance(value, str) else value


def _copy(value: str, copies: Path) -> str | None:
    """Copy the files that a planner or an option names, and return how the entry names them; None where it names none.

    Args:
        value: The planner, or the value of an option.
        copies: The folder to copy into.
    """
    file, function = plugins.file_and_function(value)
    path = file or Path(value)
    try:
        if not path.is_file():
            return None
        names = catalog.PLANNERS.files(value) if file else _beside(path)
        for name in names:
            target = copies / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path.parent / name, target)  # with its permissions: it may be a program
    except (OSError, ValueError) as error:
        raise InputError(f"{value} cannot be copied: {getattr(error, 'strerror', None) or error}") from None
    return f"{PLANNER}/{path.name}" + (f":{function}" if function else "")


def _beside(path: Path) -> list[str]:
    """The names of a file and, if these are weights, of their card."""
    card = path.with_suffix(".json")
    return [path.name, card.name] if path.suffix == ".safetensors" and card.is_file() else [path.name]


def _spec(submission: Submission, entrant: Entrant, networks: list[dict[str, Any]]) -> EntrySpec:
    """The contents of `entry.json` for an entry whose other files are there.

    Args:
        submission: What is entered.
        entrant: The planner as the entry has it.
        networks: The other networks as the entry has them.
    """
    board, folder = submission.board, entrant.folder
    first = read_result(folder / PUBLIC / board.scenarios[0].name)
    return EntrySpec(
        format=SCHEMA,
        board=board.name,
        board_version=board.spec.version,
        board_digest=board.digest,
        submitted_by=submission.by,
        planner=entrant.planner,
        package=package(entrant.planner),
        package_files=package_files(entrant.planner),
        facts=first.get("planner_facts", {}),
        options=dict(entrant.options),
        networks=networks,
        privileged=bool(first.get("privileged")),
        environment=versions(),
        files=file_digests(folder),
        reported=figures(board, folder / PUBLIC),
        verifications=[],
    )
