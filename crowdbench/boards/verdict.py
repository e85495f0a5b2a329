"""What is found of an entry that is run again, and whether it is believed.

verifications/<entry>/<season>/verification.json       what was found, with the sha256 of every other file
verifications/<entry>/<season>/verification.json.sig   the signature of the maintainer who has verified the entry
verifications/<entry>/<season>/<scenario>/             outcome, steps and SCT of the cases of the season

They lie in the folder of the board and not in that of the entry, which belongs to whoever has submitted it.
"""

from __future__ import annotations

import enum
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationError

from crowdbench.boards.board import Board
from crowdbench.boards.entry import Entry, Record, Sha256, file_digests, write_record
from crowdbench.boards.kept_runs import keep_ranked
from crowdbench.boards.season import Season
from crowdbench.boards.signature import is_signed, sign
from crowdbench.metrics.summary import Estimate
from crowdbench.runs.results import read_estimate
from crowdbench.utils import files
from crowdbench.utils.errors import InputError

VERIFICATIONS = "verifications"
VERIFICATION = "verification.json"


class Verdict(enum.StrEnum):
    """What somebody found who ran an entry again."""

    RERUN = "re-run"
    """The recorded commands lead to the reported figures, and the planner does about as well on unknown cases."""
    NOT_REPRODUCED = "not reproduced"
    """The recorded commands do not lead to what the entry's public runs say."""
    LOWER = "lower than claimed"
    """On unknown cases the planner is worse than chance explains."""
    REFUSED = "refused"
    """The planner breaks its contract or a limit."""


class DecisionTime(Record):
    """How long a planner took for its decisions in one world alone, on one core: see `decision_time`.

    Attributes:
        p99_ms: The 99th percentile over decisions, in milliseconds.
        kernel: Name of the calibration kernel.
        kernel_ms: What the kernel took on the same core, in milliseconds.
        calibrated_p99_ms: What the 99th percentile would be on the machine of reference.
        is_real_time: Whether that is at most the time step.
    """

    p99_ms: float
    kernel: str
    kernel_ms: float
    calibrated_p99_ms: float
    is_real_time: bool


Rounded = Annotated[float | None, AfterValidator(lambda value: None if value is None else float(f"{value:.6g}"))]
"""A number with six digits; None where it is undefined."""


class Figure(Record):
    """The estimate of a metric, see `crowdbench.metrics.summary.Estimate`."""

    mean: Rounded
    low: Rounded
    high: Rounded
    n: int
    max: Rounded

    @property
    def estimate(self) -> Estimate:
        """The estimate itself."""
        return read_estimate(self.model_dump())


class Range(Record):
    """A mean with its 95 % interval."""

    mean: float
    low: float
    high: float


class Method(Record):
    """What holds of a method: the means over networks that were trained with other seeds.

    Attributes:
        networks: How many networks there are, that of the entry included.
        cases: How many cases each of them drives.
        metrics: The means by metric, with intervals for other networks on other cases.
    """

    networks: int
    cases: int
    metrics: dict[str, Range]


class Verification(Record):
    """What somebody found who ran an entry again.

    Attributes:
        by: The maintainer who has signed it; empty for one that nobody signs.
        on: The day, such as 2027-01-31.
        board: The name of the board.
        board_digest: Its digest, of which the digest of the simulator's code is a part.
        entry: The name of the entry.
        entry_digest: Its digest.
        season: The season whose seed it was; empty for a seed that was drawn for this verification alone.
        seed: The seed of the cases.
        level: How the planner was kept apart, as `crowdbench.isolation.sandbox.level` says it.
        verdict: The verdict.
        reason: Why, in a sentence.
        figures: The estimates on these cases by scenario and metric; empty where the planner did not come so far.
        decision_time: How long decisions took; None where that was not measured.
        untimed: Why it was not, in a sentence; empty where it was, or where the planner did not come so far.
        method: What holds of its method; None where the entry has too few networks to claim something.
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
    """There is no verification that is believed; the message says why."""


def verification_folder(entry: Entry, season: Season) -> Path:
    """The folder with what is found of an entry in a season."""
    return season.root / entry.spec.board / VERIFICATIONS / entry.name / season.spec.name


def write_verification(folder: Path, found: Verification, board: Board, runs: Path, key: Path) -> None:
    """Write a verification with what it keeps of its runs, and sign it. One that is there is replaced.

    Args:
        folder: Its folder.
        found: What was found.
        board: The board.
        runs: The runs, a folder for each scenario.
        key: The key of the maintainer who has verified the entry, see `signature.sign`.

    Raises:
        InputError: The key does not sign.
        NotWritten: The folder cannot be written.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with files.new_directory(folder, overwrite=True, mark=VERIFICATION) as partial:
        if found.figures:
            keep_ranked(runs, partial, board)
        found = found.model_copy(update={"files": file_digests(partial)})
        path = partial / VERIFICATION
        write_record(path, found)
        sign(path, key)


def read_verification(entry: Entry, board: Board, season: Season) -> Verification:
    """What was found of an entry in a season.

    A verification counts for the entry as it was frozen, for the board's present digest, for the seed of the season,
    with the runs that it was signed with, and where a maintainer has signed it.

    Raises:
        Unverified: There is none that counts.
    """
    folder = verification_folder(entry, season)
    path = folder / VERIFICATION
    if not path.is_file():
        raise Unverified("nobody has verified it in this season")
    try:
        found = Verification.model_validate_json(files.read_regular(path))
        runs = {name: digest for name, digest in file_digests(folder).items() if not name.startswith(VERIFICATION)}
        seed = season.seed(board.name)
    except (ValidationError, OSError):
        raise Unverified(f"its {VERIFICATION} is damaged") from None
    except InputError as error:
        raise Unverified(f"its verification does not count, because {error}") from None
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise Unverified("it was not frozen with the other entries, or was changed since")
    own = (board.name, board.digest, entry.name, entry.digest, season.spec.name, seed)
    if (found.board, found.board_digest, found.entry, found.entry_digest, found.season, found.seed) != own:
        raise Unverified("its verification is of another entry, another digest of the board, or other cases")
    if runs != found.files:
        raise Unverified("the runs of its verification were changed")
    if not is_signed(path, found.by, season.root):
        raise Unverified("no maintainer has signed its verification")
    return found
