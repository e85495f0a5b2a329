"""An entry of a board: one folder with the files of a planner, its card, and its runs.

entries/<name>/entry.json       an `EntrySpec`, at most `MOST_LINES` lines
entries/<name>/card.toml        a `CardSpec`, written by the authors
entries/<name>/planner/         the planner's files, unless it is a planner that ships
entries/<name>/public.parquet   the episodes and commands of the public cases
entries/<name>/season.parquet   the episodes of the ranked cases of the last season, see `verdict`
entries/<name>/verdict.json     the verdict of that season
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

from crowdbench import InputError
from crowdbench.plugins import CARD
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
    FILE_NAME,
    check_files,
    check_named_files,
    check_planner,
    contents,
)

ENTRIES = "entries"
ENTRY, PUBLIC, SEASON_TABLE, VERDICT = "entry.json", "public.parquet", "season.parquet", "verdict.json"

NAMES = re.compile("[a-z0-9][a-z0-9_]{1,49}")
"""The pattern of an entry's name, which is the name of a folder and a part of URLs."""

NAMING = "its name must be 2 to 50 lower-case letters, digits and underscores"

TITLE = r"[A-Za-z0-9][A-Za-z0-9 .,:+()/'_-]{0,59}"
"""The pattern of a title: plain text, which looks like no other text."""

ACCOUNT = r"([a-z0-9](-?[a-z0-9]){0,38})?"
"""The pattern of a login of the forge in lower case; empty for a planner that ships."""

MOST_LINES, MOST_BYTES, MOST_NETWORKS = 40, 20_000, 12
"""Lines of `entry.json`, bytes of it and of the card, and other networks of a method, at most."""

SCHEMA = 2
"""Version of the format of `entry.json`."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Texts = Annotated[list[Text], Field(description="a list of texts in quotes")]
Title = Annotated[str, Field(pattern=f"^{TITLE}$", description="a text of up to 60 letters of ASCII, digits and signs")]
Account = Annotated[
    str, Field(pattern=f"^{ACCOUNT}$", description="the login of an account of the forge, in lower case")
]


class CardSpec(TomlTable):
    """The contents of `card.toml`: declarations of the authors.

    `account` is the login of the account whose pull requests may change the entry; only planners that ship have none.
    `ranked` is true if the entry is one of the two of its account that rank. `method` is the same for all entries of
    one method. `crowd_model` is the model of pedestrians inside the planner, such as "ORCA", or "none".
    `validation_runs` is the number of variants that were compared on validation cases. `planning` is true if the
    planner compares or optimises sequences of commands over several steps. `commit` and `weights_sha256` name the
    source of a planner of others that the maintainers have entered.
    """

    title: Title
    authors: Names
    contact: Name
    account: Account = ""
    ranked: Flag = True
    method: Name
    licence: Name
    description: Name
    paper: Text = ""
    code: Text = ""
    commit: Text = ""
    weights_sha256: Text = ""
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
        planner: Name or file of the planner, as for `crowdbench run --planner`; a file is relative to the entry.
        options: The planner's options; files are relative to the entry.
        networks: The options in which other networks of the same method differ. They are trained with other seeds.
        facts: The facts that the planner states in each scenario, such as the digest of its weights.
        privileged: True if the planner uses information that no sensor of a vehicle could measure.
        raw: True if the planner has a tracker of its own behind the detector of the board.
        environment: Versions of packages, and the machine, of the run on the public cases.
        files: The sha256 of the card and the planner's files, see `files_digest`.
    """

    format: int
    board: str
    board_digest: Sha256
    planner: Annotated[str, Field(pattern=r"^[A-Za-z0-9_./:+-]{1,200}$")]
    options: dict[str, JsonValue]
    networks: Annotated[list[dict[str, JsonValue]], Field(max_length=MOST_NETWORKS)]
    facts: dict[str, dict[str, str]]
    privileged: bool
    raw: bool
    environment: dict[str, str]
    files: Sha256


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
    def account(self) -> str:
        """The account that has submitted it; empty for a planner that ships."""
        return self.card.account

    @property
    def digest(self) -> str:
        """The sha256 of everything that is frozen when a season closes: planner, options, files and card."""
        spec = self.spec
        frozen = spec.model_dump(exclude={"format", "board_digest", "environment"})
        text = json.dumps([self.name, frozen], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def read_entry(directory: Path) -> Entry:
    """Read an entry from its directory, and check its files.

    Raises:
        InputError: A file is missing, was changed or is not allowed, or `entry.json` or `card.toml` is wrong.
    """
    if not NAMES.fullmatch(directory.resolve().name):
        raise InputError(f"{directory} cannot be an entry: {NAMING}")
    check_files(directory)  # no links from here on
    path, card = directory / ENTRY, directory / CARD
    for file in (path, card):
        if file.exists() and file.stat().st_size > MOST_BYTES:
            raise InputError(f"{file} has more than {MOST_BYTES / 1e3:g} kB")
    try:
        table = read_json(path)
        lines = path.read_bytes().count(b"\n")
    except OSError as error:
        raise InputError(f"{directory} is no entry: {path} cannot be read ({error.strerror})") from None
    if lines > MOST_LINES:
        raise InputError(f"{path} has more than {MOST_LINES} lines")
    spec = check_record(EntrySpec, table, path, "entry", SCHEMA)
    check_planner(spec.planner)
    check_named_files([spec.planner, spec.options, spec.networks], directory)
    if files_digest(directory) != spec.files:
        raise InputError(f"{directory}: its card or a file of its planner was changed since: submit it again")
    check_networks(spec.options, spec.networks, directory)
    return Entry(directory, spec, read_card(card))


def read_card(path: Path) -> CardSpec:
    """Read the card of an entry. Raises InputError if it is missing or wrong."""
    if not path.exists():
        raise InputError(f"there is no card {path}, which says what the planner is: `crowdbench new-planner` makes one")
    return parse_table(CardSpec, read_toml(path, "card"), Location(str(path)))


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


def is_pending(entry: Entry, board: Board) -> bool:
    """Check if an entry was made for another digest of the board."""
    return entry.spec.board_digest != board.digest


def files_digest(directory: Path) -> str:
    """Return the sha256 of the card and the planner's files of an entry. Raises InputError if a file is not allowed."""
    check_files(directory)
    paths = [path.relative_to(directory).as_posix() for path in sorted(directory.rglob("*")) if path.is_file()]
    own = {ENTRY, PUBLIC, SEASON_TABLE, VERDICT}
    if unknown := [path for path in paths if path not in {*own, CARD} and not re.fullmatch(FILE_NAME, path)]:
        raise InputError(f"{directory / unknown[0]} is none of the files that an entry may have: remove it")
    lines = [f"{sha256(directory / path)} {path}\n" for path in paths if path not in own]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def write_record(path: Path, record: Record) -> None:
    """Write a record as JSON, completely or not at all: a line for each value, and for each item of tables."""
    with write_whole(path) as partial:
        partial.write_text(format_record(record), encoding="utf-8")


def format_record(record: Record) -> str:
    """Return a record as JSON with a line for each value, for each item of a table, and for each table of a list."""
    lines = [f"  {json.dumps(key)}: {_format(key, value)}" for key, value in record.model_dump(mode="json").items()]
    return "{\n" + ",\n".join(lines) + "\n}\n"


def _format(key: str, value: Any) -> str:
    if key in ("facts", "metrics") and value:
        items = [f"    {json.dumps(name)}: {json.dumps(item)}" for name, item in value.items()]
        return "{\n" + ",\n".join(items) + "\n  }"
    if key == "networks" and value:
        return "[\n" + ",\n".join(f"    {json.dumps(item)}" for item in value) + "\n  ]"
    return json.dumps(value)
