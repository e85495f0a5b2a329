"""An entry of a board: one planner's files, its card, and its runs on the public cases.

entries/<name>/entry.json          what follows, with the sha256 of every other file
entries/<name>/card.toml           what its authors say of it
entries/<name>/planner/            the planner's files, unless it is built in or an installed package
entries/<name>/public/<scenario>/  episodes and commands of the public cases of each scenario
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from crowdbench.plugins.load import file_and_function
from crowdbench.runs.recording import COMMANDS
from crowdbench.runs.results import EPISODES
from crowdbench.utils import files
from crowdbench.utils.errors import InputError
from crowdbench.utils.toml import Flag, Location, Name, Names, Text, TomlTable, integer, parse_table, read_toml

ENTRY = "entry.json"
CARD = "card.toml"
PLANNER = "planner"
PUBLIC = "public"

NAMES = re.compile("[a-z0-9][a-z0-9_]{1,49}")
"""What an entry may be called: its name is a folder and a part of addresses."""

NAMING = "its name must be 2 to 50 lower-case letters, digits and underscores"

_HOLDS = re.compile(rf"{re.escape(CARD)}|{PLANNER}/.+|{PUBLIC}/\w+/({re.escape(EPISODES)}|{re.escape(COMMANDS)})")
"""The files that an entry may have."""

SUBMITTER = r"^\w[\w .'\-]{0,99}$"
"""What the name of a submitter may be: it stands on pages and in Markdown."""

MAINTAINERS = "crowdbench"
"""Who submits the planners that ship, of which any number is ranked."""

SCHEMA = 1
"""Version of what `entry.json` holds."""

Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Texts = Annotated[list[Text], Field(description="a list of texts in quotes")]
Means = dict[str, dict[str, float | None]]
"""By scenario and metric, the mean over the cases."""


class CardSpec(TomlTable):
    """The whole of `card.toml`: what the authors of an entry say of it.

    `method` names what the entry belongs to, so that several entries of one method can be compared with others as a
    method. `crowd_model` is the model of pedestrians inside the planner, such as "ORCA", or "none".
    `validation_runs` is how many trained or tuned variants were compared before this one was chosen.
    """

    title: Name
    authors: Names
    contact: Name
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


class Record(BaseModel):
    """What is kept as JSON, of which every key is known."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class EntrySpec(Record):
    """The contents of `entry.json`.

    Attributes:
        format: Version of the format, `SCHEMA`.
        board: Name of the board.
        board_digest: Its digest, see `crowdbench.boards.board.Board.digest`.
        submitted_by: Who has submitted it.
        planner: As `crowdbench run --planner` takes it, relative to the entry.
        package: For a planner that is no file: the distribution with its version, such as `crowdbench==0.1.0`.
        package_files: For such a planner, the sha256 of the Python files that it consists of, by path.
        code: The digest of the code of crowdbench that the planner imports.
        facts: What the planner says of itself beyond its options, such as the digest of its weights. What it does not
            say in all scenarios alike is named `<scenario>/<fact>`: among recorded people it may have other weights.
        options: The planner's options; files are relative to the entry.
        networks: The options in which other networks of the same method differ, trained with other seeds.
        privileged: Whether the planner uses what no vehicle could see.
        environment: Versions of packages, and the machine, of the run on the public cases.
        files: The sha256 of every other file of the entry, by its path in it.
        reported: What its authors measured on the public cases.
    """

    format: int
    board: str
    board_digest: Sha256
    submitted_by: Annotated[str, Field(pattern=SUBMITTER)]
    planner: str
    package: str
    package_files: dict[str, Sha256]
    code: Sha256
    facts: dict[str, str]
    options: dict[str, JsonValue]
    networks: list[dict[str, JsonValue]]
    privileged: bool
    environment: dict[str, str]
    files: dict[str, Sha256]
    reported: Means

    def facts_in(self, scenario: str) -> dict[str, str]:
        """What the planner says of itself in one of the scenarios that it drives."""
        others = tuple(f"{name}/" for name in self.reported)
        own = f"{scenario}/"
        return {
            name.removeprefix(own): fact
            for name, fact in self.facts.items()
            if name.startswith(own) or not name.startswith(others)
        }


def join_facts(facts: Mapping[str, Mapping[str, str]]) -> dict[str, str]:
    """The `facts` of an entry: what a planner says of itself in each scenario, by the scenario's name."""
    first, *others = facts.values()
    common = {name: fact for name, fact in first.items() if all(each.get(name) == fact for each in others)}
    return common | {
        f"{scenario}/{name}": fact
        for scenario, own in facts.items()
        for name, fact in own.items()
        if name not in common
    }


@dataclass(frozen=True)
class Entry:
    """An entry as it is on disk.

    Attributes:
        directory: Its directory, whose name is its own.
        spec: The contents of its `entry.json`.
        card: What its authors say of it.
    """

    directory: Path
    spec: EntrySpec
    card: CardSpec

    @property
    def name(self) -> str:
        """Its name."""
        return self.directory.name

    @property
    def public(self) -> Path:
        """The folder of its runs on the public cases."""
        return self.directory / PUBLIC

    @property
    def digest(self) -> str:
        """The sha256 of what is frozen when a season closes: the planner, its options, its files and its card."""
        spec = self.spec
        frozen = {path: digest for path, digest in spec.files.items() if not path.startswith(f"{PUBLIC}/")}
        code = [spec.package, spec.package_files, spec.code, frozen]
        planner = [spec.planner, spec.options, spec.networks, spec.facts, code]
        text = json.dumps([spec.board, self.name, planner], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def read_entry(directory: Path) -> Entry:
    """Read an entry from its directory and check that its files are those that it names.

    Raises InputError where a file is missing, was changed or is not named, or `entry.json` or `card.toml` are not as
    they must be.
    """
    if not NAMES.fullmatch(directory.resolve().name):
        raise InputError(f"{directory} cannot be an entry: {NAMING}")
    path = directory / ENTRY
    try:
        table = files.read_json(path)
    except OSError as error:
        raise InputError(f"{directory} is no entry: {path} cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON: {error}") from None
    spec = _parse(table, path)
    check_submitter(spec.submitted_by, spec.package)
    check_networks(spec.options, spec.networks)
    _check_named_files(directory, [spec.planner, spec.options, spec.networks])
    _check_files(directory, spec.files)
    card = parse_table(CardSpec, read_toml(directory / CARD, "card"), Location(f"{directory.name}/{CARD}"))
    return Entry(directory, spec, card)


def check_submitter(name: str, package: str) -> None:
    """Raise InputError where nobody can be called so, or it is the name of those whose planners ship.

    Args:
        name: Who submits an entry.
        package: The distribution that its planner comes from; empty for a planner in files of its own.
    """
    if not re.fullmatch(SUBMITTER, name) or name != name.strip():
        raise InputError(f"{name!r} cannot submit an entry: a name has letters, digits, spaces and -_.' only")
    if name.lower() == MAINTAINERS and not package.startswith(f"{MAINTAINERS}=="):
        raise InputError(f"an entry submitted by {name} must be of a planner that ships: give another name")


def check_networks(options: Mapping[str, Any], networks: Sequence[Mapping[str, Any]]) -> None:
    """Raise InputError where two networks of a method have the same options, those of the entry among them."""
    if any(one in (options, *networks[:index]) for index, one in enumerate(networks)):
        raise InputError("two networks of the entry are the same: name each of them once, and not the entry's own")


def _check_named_files(directory: Path, value: Any) -> None:
    """Raise InputError where the planner or an option names a file of the entry that is not frozen with it."""
    if isinstance(value, Mapping | list):
        for each in value.values() if isinstance(value, Mapping) else value:
            _check_named_files(directory, each)
    elif isinstance(value, str) and "/" in value and "\0" not in value:
        path = directory / (file_and_function(value)[0] or value)
        inside = directory / PLANNER
        if path.is_file() and (".." in path.parts or not path.resolve().is_relative_to(inside.resolve())):
            raise InputError(f"{directory / ENTRY} names the file {value}, which does not lie in {PLANNER}/")


def _parse(table: Any, path: Path) -> EntrySpec:
    if isinstance(table, dict) and table.get("format") != SCHEMA:
        raise InputError(f"{path} has the format {table.get('format')!r}, but this version reads format {SCHEMA}")
    try:
        return EntrySpec.model_validate(table)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "the whole file"
        raise InputError(f"{path} is no entry of crowdbench: {place}: {first['msg']}") from None


def file_digests(directory: Path) -> dict[str, str]:
    """The sha256 of every file of an entry but `entry.json`, by its path in it."""
    found = sorted(path for path in directory.rglob("*") if path != directory / ENTRY)
    paths = [path for path in found if path.is_symlink() or not path.is_dir()]
    for path in paths:
        if path.is_symlink() or not path.is_file():
            raise InputError(f"{path} is not a plain file: an entry holds nothing else")
    return {path.relative_to(directory).as_posix(): files.sha256(path) for path in paths}


def _check_files(directory: Path, digests: Mapping[str, str]) -> None:
    present = file_digests(directory)
    if missing := sorted(digests.keys() - present.keys()):
        raise InputError(f"{directory / missing[0]}, which {ENTRY} names, is missing")
    if more := sorted(present.keys() - digests.keys()):
        raise InputError(f"{directory / more[0]} is not a file of this entry: {ENTRY} does not name it; remove it")
    if unknown := sorted(path for path in present if not _HOLDS.fullmatch(path)):
        raise InputError(f"{directory / unknown[0]} is none of the files that an entry may have: remove it")
    for path, digest in digests.items():
        if present[path] != digest:
            raise InputError(f"{directory / path} was changed: its sha256 differs from {ENTRY}")


def write_entry(directory: Path, spec: EntrySpec) -> None:
    """Write `entry.json` into the folder of an entry, whole."""
    with files.whole(directory / ENTRY) as partial:
        write_record(partial, spec)


def write_record(path: Path, record: Record) -> None:
    """Write a record as JSON with a line for each value, and one for each estimate."""
    path.write_text(_format(record.model_dump(mode="json")) + "\n", encoding="utf-8")


def _format(value: Any, end: str = "\n") -> str:
    if not isinstance(value, dict) or not value or "mean" in value:
        return json.dumps(value)
    lines = [f"{end}  {json.dumps(key)}: {_format(each, f'{end}  ')}" for key, each in value.items()]
    return f"{{{','.join(lines)}{end}}}"
