"""A season: entries are frozen, and the seed of their cases follows from a later round of a public beacon.

The seed is computed from the randomness of the round and from the digests of all entries. The cases cannot be known
before the round is published, and cannot be chosen.
"""

from __future__ import annotations

import datetime
import hashlib
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field, StrictBool, StrictStr

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
from crowdbench_leaderboards.entry import Entry

SEASON = "season.toml"
FROZEN = "frozen.json"

MAX_RANKED = 2
"""Largest number of ranked entries of an account on a board."""


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


class FrozenEntry(BaseModel):
    """An entry that takes part in a season, also if it is withdrawn afterwards.

    Attributes:
        digest: Its digest.
        account: The account that has submitted it; empty for a planner that the maintainers enter.
        ranked: True if it ranks: at most `MAX_RANKED` of an account do.
    """

    digest: StrictStr
    account: StrictStr
    ranked: StrictBool


Frozen = Mapping[str, Mapping[str, FrozenEntry]]
"""The entries by board and name."""


class _FrozenFile(BaseModel):
    season: StrictStr
    entries: dict[str, dict[str, FrozenEntry]]


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
        digests = sorted(entry.digest for entry in self.frozen[board].values())
        text = "\n".join([*digests, self.spec.randomness])
        return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1

    def takes_part(self, board: str, entry: str, digest: str) -> bool:
        """Check if an entry of a board was frozen with this digest."""
        frozen = self.frozen.get(board, {}).get(entry)
        return frozen is not None and frozen.digest == digest

    def ranks(self, board: str, entry: str) -> bool:
        """Check if an entry of a board was frozen as one that ranks."""
        return entry in self.frozen.get(board, {}) and self.frozen[board][entry].ranked


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


def freeze(root: Path, board: str, entries: Sequence[Entry]) -> Season:
    """Freeze the entries of a board, if its season is not frozen yet.

    Of the entries that an account names for ranks, the first `MAX_RANKED` rank.

    Args:
        root: The folder of boards.
        board: The board's name.
        entries: The entries that take part, in the order in which they were merged.

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
    named: Counter[str] = Counter()
    own = {}
    for entry in entries:
        named[entry.account] += entry.card.ranked
        ranked = entry.card.ranked and (not entry.account or named[entry.account] <= MAX_RANKED)
        own[entry.name] = FrozenEntry(digest=entry.digest, account=entry.account, ranked=ranked)
    frozen = {**{name: dict(each) for name, each in season.frozen.items()}, board: own}
    table = _FrozenFile(season=spec.name, entries=frozen).model_dump()
    with write_whole(root / FROZEN) as partial:
        partial.write_text(json.dumps(table, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return Season(spec, frozen, root)
