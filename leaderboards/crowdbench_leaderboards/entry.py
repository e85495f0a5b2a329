"""An entry of a board: the files of one planner, its card, and its runs on the public cases.

entries/<name>/entry.json          an `EntrySpec`, with the sha256 of all other files
entries/<name>/card.toml           a `CardSpec`, written by the authors
entries/<name>/planner/            the planner's files, unless it is built in or an installed package
entries/<name>/public/<scenario>/  episodes and commands of the public cases of a scenario
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, JsonValue

from crowdbench import PLANNERS, InputError
from crowdbench.plugins import CARD
from crowdbench.results import COMMANDS, EPISODES
from crowdbench.utils import (
    Flag,
    Location,
    Name,
    Names,
    Text,
    TomlTable,
    check_record,
    integer,
    parse_table,
    read_json,
    read_toml,
    sha256,
    write_whole,
)
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.planner_files import (
    PLANNER,
    check_files,
    check_named_files,
    contents,
    package,
    package_files,
)

ENTRIES = "entries"
ENTRY = "entry.json"
PUBLIC = "public"

NAMES = re.compile("[a-z0-9][a-z0-9_]{1,49}")
"""The pattern of an entry's name, which is the name of a folder and a part of URLs."""

NAMING = "its name must be 2 to 50 lower-case letters, digits and underscores"

_FILES = re.compile(
    rf"{re.escape(CARD)}|{PLANNER}(/[A-Za-z0-9_][A-Za-z0-9_.+-]*)+|{PUBLIC}/\w+/({re.escape(EPISODES)}|{re.escape(COMMANDS)})"
)
"""The files that an entry may have."""

SUBMITTER = r"^[A-Za-z0-9][A-Za-z0-9_ .'\-]{0,99}$"
"""The pattern of a submitter's name: ASCII, so that no two names look alike. Case and signs distinguish no names."""

MAINTAINERS = "crowdbench"
"""The submitter of the planners that ship with crowdbench. The number of its ranked entries is not limited."""

SHIPPED = f"{MAINTAINERS}=="
"""The beginning of the distribution of a planner that ships."""

SCHEMA = 1
"""Version of the format of `entry.json`."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Texts = Annotated[list[Text], Field(description="a list of texts in quotes")]
Means = dict[str, dict[str, float | None]]
"""Means over the cases, by scenario and metric."""


class CardSpec(TomlTable):
    """The contents of `card.toml`: declarations of the authors.

    `method` is the same for all entries of one method. `crowd_model` is the model of pedestrians inside the planner,
    such as "ORCA", or "none". `validation_runs` is the number of variants that were compared on validation cases.
    `account` is the GitHub account whose pull requests may change the entry. `planning` is true if the planner compares
    or optimises sequences of commands over several steps.
    """

    title: Name
    authors: Names
    contact: Name
    account: Text = ""
    method: Name
    licence: Name
    description: Name
    paper: Text = ""
    code: Text = ""
    training_data: Texts
    training_scenarios: Texts
    privileged_training: Flag
    crowd_model: Name
    validation_runs: int = integer(least=0, most=10**9)
    training_seeds: int = integer(least=0, most=10**9)
    ablation: Flag = False
    planning: Flag = False


class Record(BaseModel):
    """A record that is written as JSON. Unknown keys are refused."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class EntrySpec(Record):
    """The contents of `entry.json`.

    Attributes:
        format: Version of the format, `SCHEMA`.
        board: Name of the board.
        board_digest: Digest of the board, see `crowdbench_leaderboards.board.Board.digest`.
        submitted_by: The submitter.
        planner: Name or file of the planner, as for `crowdbench run --planner`; a file is relative to the entry.
        package: For a planner that is not a file: the distribution with its version, such as `crowdbench==0.1.0`.
        package_files: For a planner of another distribution than crowdbench, the sha256 of its Python files, by path.
        facts: The facts that the planner states in each scenario, such as the digest of its weights.
        options: The planner's options; files are relative to the entry.
        networks: The options in which other networks of the same method differ. They are trained with other seeds.
        privileged: True if the planner uses information that no sensor of a vehicle could measure.
        raw: True if the planner has a tracker of its own behind the detector of the board.
        environment: Versions of packages, and the machine, of the run on the public cases.
        files: The sha256 of every other file of the entry, by its path in it.
        reported: Results on the public cases, as reported by the authors.
    """

    format: int
    board: str
    board_digest: Sha256
    submitted_by: Annotated[str, Field(pattern=SUBMITTER)]
    planner: str
    package: str
    package_files: dict[str, Sha256]
    facts: dict[str, dict[str, str]]
    options: dict[str, JsonValue]
    networks: list[dict[str, JsonValue]]
    privileged: bool
    raw: bool = False
    environment: dict[str, str]
    files: dict[str, Sha256]
    reported: Means


@dataclass(frozen=True)
class Entry:
    """An entry that was read from its directory.

    Attributes:
        directory: The directory. Its name is the name of the entry.
        spec: The contents of `entry.json`.
        card: The contents of `card.toml`.
    """

    directory: Path
    spec: EntrySpec
    card: CardSpec

    @property
    def name(self) -> str:
        """The name of the entry."""
        return self.directory.name

    @property
    def public(self) -> Path:
        """The folder of the runs on the public cases."""
        return self.directory / PUBLIC

    @property
    def submitter(self) -> str:
        """The normalized name of the submitter, which is the same for all entries of one submitter."""
        return fold(self.card.account or self.spec.submitted_by)

    @property
    def digest(self) -> str:
        """The sha256 of everything that is frozen when a season closes: planner, options, files and card."""
        spec = self.spec
        frozen = {path: digest for path, digest in spec.files.items() if not path.startswith(f"{PUBLIC}/")}
        code = [spec.package, spec.package_files, frozen]
        planner = [spec.planner, spec.options, spec.networks, spec.facts, code]
        text = json.dumps([spec.board, self.name, planner], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def read_entry(directory: Path) -> Entry:
    """Read an entry from its directory, and check its files.

    Raises:
        InputError: A file is missing, was changed or is not listed, or `entry.json` or `card.toml` is wrong.
    """
    if not NAMES.fullmatch(directory.resolve().name):
        raise InputError(f"{directory} cannot be an entry: {NAMING}")
    path = directory / ENTRY
    try:
        table = read_json(path)
    except OSError as error:
        raise InputError(f"{directory} is no entry: {path} cannot be read ({error.strerror})") from None
    spec = check_record(EntrySpec, table, path, "entry", SCHEMA)
    check_submitter(spec.submitted_by, spec.package)
    check_named_files([spec.planner, spec.options, spec.networks], directory)
    _check_digests(directory, spec.files)
    check_networks(spec.options, spec.networks, directory)
    return Entry(directory, spec, read_card(directory / CARD))


def read_card(path: Path) -> CardSpec:
    """Read the card of an entry. Raises InputError if it is missing or wrong."""
    if not path.exists():
        raise InputError(f"there is no card {path}, which says what the planner is: `crowdbench new-planner` makes one")
    return parse_table(CardSpec, read_toml(path, "card"), Location(str(path)))


def read_entries(board: Board, root: Path) -> list[Entry]:
    """Read the entries of a board, sorted by name. Raises InputError if an entry is damaged, see `read_entry`."""
    entries = [read_entry(path.parent) for path in sorted((root / board.name).glob(f"{ENTRIES}/*/{ENTRY}"))]
    for entry in entries:
        check_board_name(entry, board)
        check_names(entry.name, entry.spec.planner, entry.card, entry.spec.submitted_by, root / board.name)
    return entries


def check_board_name(entry: Entry, board: Board) -> None:
    """Raise InputError if an entry is one of another board."""
    if entry.spec.board != board.name:
        raise InputError(f"{entry.directory} is an entry of the board {entry.spec.board}, not of {board.name}")


def fold(name: str) -> str:
    """Return the letters and digits of a name in lower case, with o, l and l for the similar 0, 1 and i."""
    return re.sub("[^a-z0-9]", "", name.lower()).translate(str.maketrans("01i", "oll"))


def check_names(name: str, planner: str, card: CardSpec, submitter: str, folder: Path) -> None:
    """Raise InputError if an entry has the name of another entry, or the name or title of a planner that ships.

    Args:
        name: The name of the entry.
        planner: Its planner. An entry of a built-in planner may have its name, if the board has no such baseline.
        card: Its card.
        submitter: Its submitter.
        folder: The folder of its board. Planners that ship have a card in `cards/` beside it.
    """
    if fold(submitter) == MAINTAINERS:
        return
    if any(letter.isalpha() and not letter.isascii() for letter in card.title):
        raise InputError(f"the title {card.title!r} must have letters of ASCII: others can look like these")
    shipped = PLANNERS.sources().keys() - {planner}
    carded = {path.stem for path in folder.parent.glob("cards/*.toml")}
    names_of_planners = {fold(each): "a planner that ships" for each in shipped | carded}
    entries = {path.parent.name for path in (folder / ENTRIES).glob(f"*/{ENTRY}")}
    names_of_entries = {fold(each): f"the entry {each}" for each in entries - {name}}
    taken = names_of_planners | names_of_entries
    whose = taken.get(fold(name)) or names_of_planners.get(fold(card.title))
    if whose:
        raise InputError(f"{name!r}, {card.title!r} is the name of {whose}, or looks like it: choose another one")


def check_submitter(name: str, package: str) -> None:
    """Raise InputError if a name is invalid, or if only maintainers may use it and the planner does not ship.

    Args:
        name: The submitter of an entry.
        package: The distribution of the planner; empty for a planner whose files are in the entry.
    """
    if not re.fullmatch(SUBMITTER, name) or name != name.strip():
        raise InputError(f"{name!r} cannot submit an entry: a name has letters, digits, spaces and -_.' of ASCII only")
    if fold(name) == MAINTAINERS and not package.startswith(SHIPPED):
        raise InputError(f"an entry submitted by {name} must be of a planner that ships: give another name")


def check_networks(options: Mapping[str, Any], networks: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Raise InputError if two networks of a method have the same options, or files with the same contents.

    Args:
        options: Options of the planner.
        networks: Options of further networks, which are added to `options`.
        folder: Folder of the files that options name.
    """
    found = contents([options, *({**options, **network} for network in networks)], folder)
    if any(network in found[:index] for index, network in enumerate(found)):
        raise InputError("two networks of the entry are the same: name each of them once, and not the entry's own")


def check_unchanged(entry: Entry) -> None:
    """Raise InputError if the installed planner differs from that of the entry.

    The code of a planner that ships may differ: the version of the simulator is raised if its episodes change.
    """
    spec = entry.spec
    if spec.package.startswith(SHIPPED):
        return
    if (installed := package(spec.planner)) != spec.package:
        raise InputError(f"the planner is of {spec.package}, but {installed} is installed")
    if package_files(spec.planner) != spec.package_files:
        raise InputError(f"the files of the planner {spec.planner} have changed since submission")


def is_pending(entry: Entry, board: Board) -> bool:
    """Check if an entry was made for another digest of the board."""
    return entry.spec.board_digest != board.digest


def file_digests(directory: Path) -> dict[str, str]:
    """Return the sha256 of all files of an entry except `entry.json`, by path."""
    check_files(directory)
    paths = [path for path in sorted(directory.rglob("*")) if path.is_file()]
    return {path.relative_to(directory).as_posix(): sha256(path) for path in paths if path != directory / ENTRY}


def _check_digests(directory: Path, digests: Mapping[str, str]) -> None:
    present = file_digests(directory)
    if missing := sorted(digests.keys() - present.keys()):
        raise InputError(f"{directory / missing[0]}, which {ENTRY} names, is missing")
    if more := sorted(present.keys() - digests.keys()):
        raise InputError(f"{directory / more[0]} is not a file of this entry: {ENTRY} does not name it; remove it")
    if unknown := sorted(path for path in present if not _FILES.fullmatch(path)):
        raise InputError(f"{directory / unknown[0]} is none of the files that an entry may have: remove it")
    for path, digest in digests.items():
        if present[path] != digest:
            raise InputError(f"{directory / path} was changed: its sha256 differs from {ENTRY}")


def write_entry(directory: Path, spec: EntrySpec) -> None:
    """Write `entry.json` into the folder of an entry, completely or not at all."""
    with write_whole(directory / ENTRY) as partial:
        write_record(partial, spec)


def write_record(path: Path, record: Record) -> None:
    """Write a record as JSON with a line for each value and each estimate."""
    path.write_text(_format(record.model_dump(mode="json")) + "\n", encoding="utf-8")


def _format(value: Any, end: str = "\n") -> str:
    if not isinstance(value, dict) or not value or "mean" in value:
        return json.dumps(value)
    lines = [f"{end}  {json.dumps(key)}: {_format(item, f'{end}  ')}" for key, item in value.items()]
    return f"{{{','.join(lines)}{end}}}"
