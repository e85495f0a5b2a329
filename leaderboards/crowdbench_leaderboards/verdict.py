"""The verdict on an entry in a season: its files, and the conditions for its validity.

verifications/<entry>/<season>/verification.json       a `Verification`, with the sha256 of all other files
verifications/<entry>/<season>/verification.json.sig   the signature of the maintainer who has verified the entry
verifications/<entry>/<season>/<scenario>/             outcome, steps and SCT of the cases of the season

They lie in the folder of the board. The folder of the entry belongs to its submitter.
"""

from __future__ import annotations

import dataclasses
import enum
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationError

from crowdbench import InputError
from crowdbench.metrics import Estimate
from crowdbench.results import EPISODES, read_estimate
from crowdbench.utils import new_directory, read_regular
from crowdbench_leaderboards.board import Board
from crowdbench_leaderboards.board_runs import read_episodes
from crowdbench_leaderboards.entry import Entry, Record, Sha256, file_digests, write_record
from crowdbench_leaderboards.season import Season
from crowdbench_leaderboards.signature import is_signed, sign

VERIFICATIONS = "verifications"
VERIFICATION = "verification.json"

DIGITS = 6
"""Decimal places of the SCT of ranked cases."""


class Verdict(enum.StrEnum):
    """The result of a verification."""

    RERUN = "re-run"
    """The recorded commands reproduce the reported results, and the planner performs similarly on held-out cases."""
    NOT_REPRODUCED = "not reproduced"
    """The recorded commands do not reproduce the entry's public runs."""
    LOWER = "lower than claimed"
    """The planner is significantly worse on held-out cases."""
    REFUSED = "refused"
    """The planner breaks its contract or a limit."""


class DecisionTime(Record):
    """The time of a planner's decisions in a single world, on one core: see `decision_time`.

    Attributes:
        p99_ms: The 99th percentile over decisions, in milliseconds.
        kernel: Name of the calibration kernel.
        kernel_ms: Time of the kernel on the same core, in milliseconds.
        calibrated_p99_ms: The 99th percentile, scaled to the reference machine.
        is_real_time: True if `calibrated_p99_ms` is at most the time step.
    """

    p99_ms: float
    kernel: str
    kernel_ms: float
    calibrated_p99_ms: float
    is_real_time: bool


Rounded = Annotated[float | None, AfterValidator(lambda value: None if value is None else float(f"{value:.6g}"))]
"""A number with six digits; None if it is undefined."""


class Figure(Record):
    """The estimate of a metric, see `crowdbench.metrics.summary.Estimate`."""

    mean: Rounded
    low: Rounded
    high: Rounded
    n: int
    max: Rounded

    @property
    def estimate(self) -> Estimate:
        """The estimate."""
        return read_estimate(self.model_dump())


class Method(Record):
    """Means over networks that were trained with other seeds.

    Attributes:
        networks: The number of networks, including the entry's network.
        cases: The number of cases that each network drives.
        metrics: The means by metric, with intervals that account for both networks and cases.
    """

    networks: int
    cases: int
    metrics: dict[str, Figure]


class Verification(Record):
    """The verdict on an entry, and the measurements.

    Attributes:
        by: The maintainer who has signed it; empty if it is not signed.
        on: The day, such as 2027-01-31.
        board: The name of the board.
        board_digest: The digest of the board, which includes the digest of the simulator's code.
        entry: The name of the entry.
        entry_digest: The digest of the entry.
        season: The season of the seed; empty for a seed that was drawn only for this verification.
        seed: The seed of the cases.
        level: The level of isolation, see `crowdbench.isolation.sandbox.level`.
        verdict: The verdict.
        reason: The reason for the verdict, in a sentence.
        figures: The estimates on these cases by scenario and metric; empty if the verdict was reached before this run.
        decision_time: The time of decisions; None if it was not measured.
        untimed: The reason why decisions could not be timed, in a sentence; otherwise empty.
        method: The means over the networks of the method; None if the entry has too few networks.
        files: The sha256 of each file of the runs, by its path beside `verification.json`.
    """

    by: str
    on: str
    board: str
    board_digest: Sha256
    entry: str
    entry_digest: Sha256
    season: str
    seed: int
    level: str
    verdict: Annotated[Verdict, Field(strict=False)]
    reason: str
    figures: dict[str, dict[str, Figure]] = Field(default_factory=dict)
    decision_time: DecisionTime | None = None
    untimed: str = ""
    method: Method | None = None
    files: dict[str, Sha256] = Field(default_factory=dict)


class Unverified(InputError):
    """Raised if no verification of an entry is valid. The message states the reason."""


def verification_folder(entry: Entry, season: Season) -> Path:
    """Return the folder of the verification of an entry in a season."""
    return season.root / entry.spec.board / VERIFICATIONS / entry.name / season.spec.name


def write_verification(folder: Path, verification: Verification, board: Board, runs: Path, key: Path) -> None:
    """Write a verification with outcome, steps and SCT of its runs, and sign it. An earlier one is replaced.

    Args:
        folder: The folder of the verification.
        verification: The verification.
        board: The board.
        runs: The runs, a folder for each scenario.
        key: The key of the maintainer who has verified the entry, see `signature.sign`.

    Raises:
        InputError: The key does not sign.
        NotWritten: The folder cannot be written.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with new_directory(folder, overwrite=True, mark=VERIFICATION) as partial:
        for name, episodes in read_episodes(board, runs).items() if verification.figures else ():
            (partial / name).mkdir()
            columns = {"sct": episodes.columns["sct"].round(DIGITS)}
            dataclasses.replace(episodes, columns=columns).write(partial / name / EPISODES)
        path = partial / VERIFICATION
        write_record(path, verification.model_copy(update={"files": file_digests(partial)}))
        sign(path, key)


def read_verification(entry: Entry, board: Board, season: Season) -> Verification:
    """Read the verification of an entry in a season.

    A verification is valid for the frozen entry, the board's current digest and the seed of the season. A maintainer
    must have signed it, and its runs must be unchanged since then.

    Raises:
        Unverified: No verification is valid.
    """
    folder = verification_folder(entry, season)
    path = folder / VERIFICATION
    if not path.is_file():
        raise Unverified("nobody has verified it in this season")
    try:
        verification = Verification.model_validate_json(read_regular(path))
        runs = {name: digest for name, digest in file_digests(folder).items() if not name.startswith(VERIFICATION)}
        seed = season.seed(board.name)
    except (ValidationError, OSError):
        raise Unverified(f"its {VERIFICATION} is damaged") from None
    except InputError as error:
        raise Unverified(f"its verification does not count, because {error}") from None
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise Unverified("it was not frozen with the other entries, or was changed since")
    stated = verification.model_dump(include={"board", "board_digest", "entry", "entry_digest", "season", "seed"})
    expected = {
        "board": board.name,
        "board_digest": board.digest,
        "entry": entry.name,
        "entry_digest": entry.digest,
        "season": season.spec.name,
        "seed": seed,
    }
    if stated != expected:
        raise Unverified("its verification is of another entry, another digest of the board, or other cases")
    if runs != verification.files:
        raise Unverified("the runs of its verification were changed")
    if not is_signed(path, verification.by, season.root):
        raise Unverified("no maintainer has signed its verification")
    return verification
