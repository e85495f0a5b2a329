"""The verdict on an entry in a season, and the conditions for its validity.

verdict.json has the verdict with its signature, and the sha256 of season.parquet, which has the ranked cases.
"""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from crowdbench import Episodes, InputError
from crowdbench.metrics import Estimate
from crowdbench.results import read_estimate
from crowdbench.utils import read_regular, sha256
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.entry import (
    SCHEMA,
    SEASON_TABLE,
    VERDICT,
    Entry,
    Record,
    Sha256,
    format_record,
    write_record,
)
from crowdbench_leaderboards.episode_table import read_table, write_table
from crowdbench_leaderboards.season import Season
from crowdbench_leaderboards.signature import is_signed, sign


class Verdict(enum.StrEnum):
    """The result of a verification."""

    RERUN = "re-run"
    """The recorded commands lead to the public results, and the planner performs similarly on held-out cases."""
    NOT_REPRODUCED = "not reproduced"
    """The recorded commands do not lead to the public results."""
    LOWER = "lower than claimed"
    """The planner is significantly worse on held-out cases."""
    REFUSED = "refused"
    """The planner breaks its contract or a limit."""


class DecisionTime(Record):
    """The time of all decisions in the ranked run, on one core of the machine that has verified the entry.

    Attributes:
        p99_ms: The 99th percentile, in milliseconds.
        in_time: The share of decisions below the time step.
        is_real_time: True if that share is at least `ranked_run.MIN_IN_TIME`.
    """

    p99_ms: float
    in_time: float
    is_real_time: bool


class Method(Record):
    """Means over networks that were trained with other seeds.

    Attributes:
        networks: The number of networks, including the entry's network.
        cases: The number of cases that each network drives.
        metrics: The means by metric, with intervals that account for both networks and cases.
    """

    networks: int
    cases: int
    metrics: dict[str, dict[str, float | None]]

    @property
    def success(self) -> Estimate:
        """The mean success rate."""
        return read_estimate(self.metrics["success_rate"])


class Verification(Record):
    """The verdict on an entry, and the measurements.

    Attributes:
        format: Version of the format, `SCHEMA`.
        verdict: The verdict.
        reason: The reason for the verdict, in a sentence.
        by: The maintainer who has signed it; empty if it is not signed.
        on: The day, such as 2027-01-31.
        board: The name of the board.
        board_digest: The digest of the board, which includes the version of the simulator.
        entry: The name of the entry.
        entry_digest: The digest of the entry.
        season: The season of the seed; empty for a seed that was drawn only for this verification.
        seed: The seed of the cases.
        level: The level of isolation, see `crowdbench.isolation.level`.
        decision_time: The time of decisions; None if no ranked case was driven.
        method: The means over the networks of the method; None if the entry has too few networks.
        episodes: The sha256 of season.parquet; empty without one.
        signature: The signature of the maintainer over this record without it, see `signature.sign`.
    """

    format: int = SCHEMA
    verdict: Annotated[Verdict, Field(strict=False)]
    reason: str
    by: str
    on: str
    board: str
    board_digest: Sha256
    entry: str
    entry_digest: Sha256
    season: str
    seed: int
    level: str
    decision_time: DecisionTime | None = None
    method: Method | None = None
    episodes: str = ""
    signature: str = ""

    @property
    def signed_content(self) -> bytes:
        """The bytes that are signed."""
        return format_record(self.model_copy(update={"signature": ""})).encode()


class Unverified(InputError):
    """Raised if no verification of an entry is valid. The message states the reason."""


def write_verification(
    directory: Path, verification: Verification, episodes: dict[str, Episodes], key: Path
) -> Verification:
    """Write a verification into the folder of an entry, with the ranked cases, and sign it. An earlier one is replaced.

    Args:
        directory: The folder of the entry.
        verification: The verification.
        episodes: The ranked cases by scenario; empty if none were driven.
        key: The key of the maintainer who has verified the entry, see `signature.sign`.

    Returns:
        The signed verification.

    Raises:
        InputError: The key does not sign.
    """
    table = directory / SEASON_TABLE
    if episodes:
        write_table(table, episodes)
    else:
        table.unlink(missing_ok=True)
    named = verification.model_copy(update={"episodes": sha256(table) if episodes else ""})
    signed = named.model_copy(update={"signature": sign(named.signed_content, key)})
    write_record(directory / VERDICT, signed)
    return signed


def read_verification(entry: Entry, board: Board, season: Season) -> tuple[Verification, dict[str, Episodes]]:
    """Read the verification of an entry in a season, and its ranked cases by scenario.

    A verification is valid for the frozen entry, the board's current digest and the seed of the season. A maintainer
    must have signed it, and its ranked cases must be unchanged since then.

    Raises:
        Unverified: No verification is valid.
    """
    path = entry.directory / VERDICT
    if not path.is_file():
        raise Unverified("nobody has verified it in this season")
    try:
        verification = Verification.model_validate_json(read_regular(path))
    except (ValidationError, OSError):
        raise Unverified(f"its {VERDICT} is damaged") from None
    try:
        seed = season.seed(board.name)
    except InputError as error:
        raise Unverified(f"its verification does not count, because {error}") from None
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise Unverified("it was not frozen with the other entries, or was changed since")
    found = verification
    stated = [found.board, found.board_digest, found.entry, found.entry_digest, found.season, found.seed]
    if stated != [board.name, board.digest, entry.name, entry.digest, season.spec.name, seed]:
        raise Unverified("its verification is of another entry, another digest of the board, or other cases")
    if not is_signed(verification.signed_content, verification.signature, verification.by, season.root):
        raise Unverified("no maintainer has signed its verification")
    if not verification.episodes:
        return verification, {}
    table = entry.directory / SEASON_TABLE
    if not table.is_file() or sha256(table) != verification.episodes:
        raise Unverified("the ranked cases of its verification were changed")
    return verification, read_table(table, board, board.cases)
