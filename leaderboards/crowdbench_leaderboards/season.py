"""A season: entries are frozen, and the seed of their cases follows from a later round of a public beacon.

The seed is computed from the randomness of the round and from the digests of all entries. The cases cannot be known
before the round is published, and cannot be chosen.
"""

from __future__ import annotations

import datetime
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, StrictStr

from crowdbench import InputError
from crowdbench.utils import (
    Flag,
    Location,
    Name,
    TomlTable,
    integer,
    parse_table,
    read_json,
    read_toml,
    write_whole,
)

SEASON = "season.toml"
FROZEN = "frozen.json"

Frozen = Mapping[str, Mapping[str, str]]
"""The digests of entries by board and name."""


class SeasonSpec(TomlTable):
    """The contents of `season.toml`: when entries are frozen, and the source of the seed.

    `round` is a round of drand's default chain (League of Entropy) after `closes`, and `randomness` its published
    value, empty before. `rehearsal` marks a season whose round was known before it closed.
    """

    name: Name
    closes: Annotated[datetime.date, Field(description="a date, such as 2027-01-31")]
    round: int = integer(least=1, most=2**53)
    randomness: Annotated[
        str,
        Field(pattern="^([0-9a-f]{64})?$", description="64 hexadecimal digits, or empty before the round"),
    ] = ""
    rehearsal: Flag = False


class _FrozenFile(BaseModel):
    season: StrictStr
    entries: dict[str, dict[str, StrictStr]]


class TooEarly(InputError):
    """Raised if entries are not frozen yet, or the round of the beacon is not published yet."""


@dataclass(frozen=True)
class Season:
    """The present season.

    Attributes:
        spec: The contents of `season.toml`.
        frozen: The entries that take part, by board; boards whose entries are not frozen yet are missing.
        root: The folder of boards.
    """

    spec: SeasonSpec
    frozen: Frozen
    root: Path

    def seed(self, board: str) -> int:
        """Return the seed of the cases of a board, of 63 bits.

        Raises:
            TooEarly: Entries are not frozen yet, or the randomness of the round is not known.
        """
        if board not in self.frozen:
            raise TooEarly(f"the entries of {board} are not frozen yet: {FROZEN} does not list them")
        if not self.spec.randomness:
            raise TooEarly(
                f"{SEASON} lacks the randomness of round {self.spec.round}: fetch it from drand, and write it there"
            )
        text = "\n".join([*sorted(self.frozen[board].values()), self.spec.randomness])
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1

    def takes_part(self, board: str, entry: str, digest: str) -> bool:
        """Check if an entry of a board was frozen with this digest."""
        return self.frozen.get(board, {}).get(entry) == digest


def read_season(root: Path) -> Season:
    """Read the season of a folder of boards. Raises InputError if one of its files is missing or wrong."""
    spec = parse_table(SeasonSpec, read_toml(root / SEASON, "season"), Location(SEASON))
    path = root / FROZEN
    try:
        frozen = _FrozenFile.model_validate(read_json(path))
    except FileNotFoundError:
        return Season(spec, {}, root)
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{path} must hold the name of a season and the digests of its entries") from None
    return Season(spec, frozen.entries if frozen.season == spec.name else {}, root)


def freeze(root: Path, board: str, entries: Mapping[str, str]) -> Season:
    """Freeze the entries of a board, if its season is not frozen yet.

    Args:
        root: The folder of boards.
        board: The board's name.
        entries: The digest of each entry that takes part.

    Returns:
        The season.

    Raises:
        TooEarly: The season has not closed yet.
        InputError: There is no entry, or the randomness is known already, so that entries could be chosen by it.
    """
    season = read_season(root)
    if board in season.frozen:
        return season
    spec = season.spec
    if not spec.rehearsal and datetime.datetime.now(datetime.UTC).date() <= spec.closes:
        raise TooEarly(f"the season {spec.name} is open until {spec.closes}: its entries are frozen on a later day")
    if not spec.rehearsal and spec.randomness:
        raise InputError(
            f"{SEASON} has the randomness of round {spec.round} already, but the entries of {board} must be frozen "
            "before anybody knows it: name a later round, without its randomness"
        )
    if not entries:
        raise InputError(f"the board {board} has no entries to freeze")
    frozen = {**season.frozen, board: dict(entries)}
    table = {"season": spec.name, "entries": frozen}
    with write_whole(root / FROZEN) as partial:
        partial.write_text(json.dumps(table, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return Season(spec, frozen, root)
