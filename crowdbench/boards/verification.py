"""Verifies an entry: runs it again, and records in a season what was found."""

from __future__ import annotations

import datetime
import secrets
import shutil
import tempfile
from pathlib import Path

from crowdbench.boards.board import Board
from crowdbench.boards.driving import (
    NO_RUNS,
    InUse,
    Progress,
    Unfinished,
    locked,
    run_digest,
)
from crowdbench.boards.entry import (
    SEASONS,
    Entry,
    Verification,
    file_digests,
    read_entry,
    write_entry,
)
from crowdbench.boards.rerun import cases_of_season, drive_all, entrant_of, found
from crowdbench.boards.season import Season
from crowdbench.errors import InputError, MachineFault
from crowdbench.evaluate.seal import code
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.isolation import sandbox
from crowdbench.scenario.cases import Cases


def verify(
    entry: Entry,
    board: Board,
    *,
    by: str,
    work: Path,
    season: Season | None = None,
    cases: Cases | None = None,
    shard: Shard = WHOLE,
    progress: Progress | None = None,
) -> Verification:
    """Run an entry again.

    Args:
        entry: The entry.
        board: Its board.
        by: Who runs it.
        work: The folder that keeps finished runs until the verdict.
        season: The season whose cases it drives, of which the verdict is recorded in the entry; None for cases of a
            seed that is drawn now, of which nothing is recorded.
        cases: The cases of each scenario without a season, if not those that it would have.
        shard: Which share of a season's batches is run. The last one comes to the verdict.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What was found.

    Raises:
        Unfinished: Runs are missing that other shards make.
        MachineFault: `work` or the entry cannot be written, or crowdbench has changed meanwhile.
        InputError: The entry is not one of this board, or takes no part in the season, or was verified in it before.
        KeyboardInterrupt: Somebody interrupted it. In a season, the same call goes on with what is finished.
    """
    _check_possible(entry, board, season)
    if season is None:
        wanted = cases or cases_of_season(entry, board)
        work.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f"verify-{board.name}-{entry.name}-", dir=work) as folder:
            return _verified(entry, board, by, secrets.randbits(63), wanted, Path(folder), progress)
    cases = cases_of_season(entry, board)
    seed = season.seed(board.name)
    digest = run_digest(board, entrant_of(entry), entry.spec.package_files)
    kept = work / f"verify-{board.name}-{entry.name}-{digest}-{seed:016x}"
    if shard != WHOLE:
        try:
            drive_all(entry, board, seed, cases, kept, shard, progress)
        except (MachineFault, Unfinished):
            raise
        except InputError:
            # A fault of the planner's is no end: `_verified` below drives the same cases, meets it again, and makes a
            # verdict of it, which says that the entry is refused.
            pass
    with locked(kept):
        _check_possible(read_entry(entry.directory, check_files=False), board, season)  # another process may be done
        # Of a process that was killed between writing its runs and its verdict.
        shutil.rmtree(entry.directory / SEASONS / season.spec.name, ignore_errors=True)
        entry = read_entry(entry.directory)
        outside = _verified(entry, board, by, seed, cases, kept, progress)
        verification = outside.model_copy(update={"season": season.spec.name})
        _record(entry, verification, kept)
    shutil.rmtree(kept, ignore_errors=True)
    return verification


def _verified(
    entry: Entry, board: Board, by: str, seed: int, cases: Cases, kept: Path, progress: Progress | None
) -> Verification:
    """Run an entry again on the cases of a seed, and say what was found, outside any season."""
    rerun = found(entry, board, seed, cases, kept, progress)
    return Verification(
        by=by,
        on=datetime.datetime.now(datetime.UTC).date().isoformat(),
        season="",
        seed=seed,
        code=code(),
        level=sandbox.level(),
        verdict=rerun.verdict,
        reason=rerun.reason,
        figures=rerun.figures,
        decision_time=rerun.decision_time,
        method=rerun.method,
    )


def _check_possible(entry: Entry, board: Board, season: Season | None) -> None:
    spec = entry.spec
    if spec.board != board.name:
        raise InputError(f"{entry.directory} is an entry of the board {spec.board}, not of {board.name}")
    if spec.board_digest != board.digest:
        raise InputError(
            f"{entry.directory} was made for other rules of the board {board.name} (version {spec.board_version}, "
            f"{spec.board_digest[:12]}) than these (version {board.spec.version}, {board.digest[:12]}): submit it again"
        )
    if season is None:
        return
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise InputError(
            f"{entry.directory} takes no part in the season {season.spec.name}: it was not among the entries that were "
            "frozen, or was changed since"
        )
    if any(each.season == season.spec.name for each in spec.verifications):
        raise InUse(f"{entry.directory} was verified in the season {season.spec.name} before, which is done once")


def _record(entry: Entry, verification: Verification, kept: Path) -> None:
    """Write a verification and its runs into an entry."""
    runs = entry.directory / SEASONS / verification.season
    if verification.figures:
        shutil.copytree(kept, runs, ignore=NO_RUNS)
    spec = entry.spec.model_copy(
        update={
            "files": file_digests(entry.directory),
            "verifications": [*entry.spec.verifications, verification],
        }
    )
    write_entry(entry.directory, spec)
    read_entry(entry.directory)
