"""Makes an entry: copies what the planner consists of, and drives the public cases of the board with the copy."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.boards.board import Board
from crowdbench.boards.copying import check_size, copied_value
from crowdbench.boards.driving import (
    NO_RUNS,
    Entrant,
    InUse,
    Progress,
    check_finished,
    drive,
    figures,
    locked,
    made,
    run_digest,
    timed,
)
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
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.evaluate.wanted import versions
from crowdbench.toml_file import Location, parsed, read_toml

ENTRIES = "entries"


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
            raise InputError("an entry needs the name of who submits it: give --by, or name the authors in the card")


def submit(
    submission: Submission, root: Path, work: Path, progress: Progress | None = None, shard: Shard = WHOLE
) -> tuple[Entry, dict[str, str]]:
    """Make an entry.

    Args:
        submission: What is entered.
        root: The folder of boards, in which the entry gets its folder.
        work: The folder that keeps finished runs until the entry is made.
        progress: Called after each step with what it added to the episodes, in parts of an episode.
        shard: Which share of the batches is run. The last one makes the entry.

    Returns:
        The entry, and the scenarios that its planner cannot drive, with the reason.

    Raises:
        Unfinished: Runs are missing that other shards make.
        InputError: The entry exists, the card is wrong, or the planner cannot be loaded or breaks its contract.
        KeyboardInterrupt: Somebody interrupted it. The same call goes on with what is finished.
    """
    board = submission.board
    directory = root / board.name / ENTRIES / submission.name
    read_card(submission.card)
    name = f"submit-{board.name}-{submission.name}"
    with contextlib.ExitStack() as lock:
        if shard == WHOLE:
            lock.enter_context(locked(work / name))
        _check_free(directory)
        directory.parent.mkdir(parents=True, exist_ok=True)
        with new_directory(directory, overwrite=False) as folder:
            entrant, networks = _copied(submission, folder)
            kept = work / f"{name}-{run_digest(board, entrant, package_files(entrant.planner))}"
            failed = drive(board, entrant, kept, cases=board.public_cases, seed=None, shard=shard, progress=progress)
            if shard != WHOLE:
                lock.enter_context(locked(work / name))
                _check_free(directory)  # another shard may have been the last one
            check_finished(board, kept, failed)
            shutil.copytree(kept, folder / PUBLIC, ignore=NO_RUNS)
            if (folder / PLANNER).exists():  # what is built in is known to be quick enough
                timed(board, entrant, folder / PUBLIC, [])
            write_entry(folder, _spec(submission, entrant, networks))
    shutil.rmtree(kept)
    return read_entry(directory), failed


def _check_free(directory: Path) -> None:
    if directory.exists():
        raise InUse(f"{directory} exists already: choose another name, or remove it")


def read_card(path: Path) -> CardSpec:
    """Read the card of an entry. Raises InputError where it is missing or wrong."""
    if not path.exists():
        raise InputError(f"there is no card {path}, which says what the planner is: `crowdbench new-planner` makes one")
    return parsed(CardSpec, read_toml(path, "card"), Location(path.name))


def _copied(submission: Submission, folder: Path) -> tuple[Entrant, list[dict[str, Any]]]:
    """Copy the card, and the files of the planner and those that its options name, into the folder of an entry.

    Args:
        submission: What is entered.
        folder: The folder of the entry.

    Returns:
        The planner and the other networks, as the entry has them.

    Raises:
        InputError: A file cannot be read, they are too large, or a network is entered twice.
    """
    shutil.copyfile(submission.card, folder / CARD)
    planner = copied_value(submission.planner, folder)
    package_files(planner)  # refuses one that does not exist
    options = copied_value(submission.options, folder)
    networks = [{**options, **copied_value(each, folder)} for each in submission.networks]
    if any(one in (options, *networks[:index]) for index, one in enumerate(networks)):
        raise InputError("two networks of the entry are the same: name each of them once, and not the entry's own")
    check_size(folder)
    return Entrant(folder, planner, options), networks


def _spec(submission: Submission, entrant: Entrant, networks: list[dict[str, Any]]) -> EntrySpec:
    """The contents of `entry.json` for an entry whose other files are there.

    Args:
        submission: What is entered.
        entrant: The planner as the entry has it.
        networks: The other networks as the entry has them.
    """
    board, folder = submission.board, entrant.folder
    first = read_result(folder / PUBLIC / made(board, folder / PUBLIC)[0])
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
