"""Verifies an entry: runs it again, compares, and records in a season what was found.

First every public case is simulated again from its recorded commands, in this process, which never loads the planner.
Then the planner drives cases that it cannot know, in a process of its own. What no replay can see is in
`docs/boards.md`.
"""

from __future__ import annotations

import dataclasses
import datetime
import secrets
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.boards.board import Board
from crowdbench.boards.consistency_test import lower_than_claimed
from crowdbench.boards.entry import MAINTAINERS, Entry, read_entry
from crowdbench.boards.kept_runs import driven_scenarios, read_episodes, read_figures, read_public_run
from crowdbench.boards.method import method_cases, method_networks, network_runs, summarize_method
from crowdbench.boards.planner_files import check_size as check_files_size
from crowdbench.boards.planner_files import describe_change, package
from crowdbench.boards.run_entry import EntryRun, InUse, Progress, Unfinished, lock_runs
from crowdbench.boards.season import Season
from crowdbench.boards.signature import find_signer
from crowdbench.boards.verdict import (
    Unverified,
    Verdict,
    Verification,
    read_verification,
    verification_folder,
    write_verification,
)
from crowdbench.isolation import sandbox
from crowdbench.runs.recording import COMMANDS, check_size
from crowdbench.runs.replay import replay
from crowdbench.runs.result_file import read_result
from crowdbench.runs.results import EPISODES
from crowdbench.runs.shards import WHOLE, Shard
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError, MachineFault
from crowdbench.utils.memory import limit_memory

MOST_MEMORY = 4e9
"""Bytes that the replay of an entry's public runs may take."""


def count_cases(entry: Entry, board: Board, cases: Cases) -> int:
    """How many cases a verification replays and drives; `cases` are those of each scenario."""
    own = (len(cases) + board.spec.public_cases) * len(board.scenarios)
    return own + len(method_networks(entry, board)) * len(method_cases(cases))


def verify(
    entry: Entry,
    board: Board,
    *,
    work: Path,
    season: Season | None = None,
    key: Path | None = None,
    cases: Cases | None = None,
    shard: Shard = WHOLE,
    progress: Progress | None = None,
) -> Verification:
    """Run an entry again.

    Args:
        entry: The entry.
        board: Its board.
        work: The folder that keeps finished runs until the verdict.
        season: The season whose cases it drives, of which the verdict is recorded; None for cases of a seed that is
            drawn now, of which nothing is recorded.
        key: For a season, the key of the maintainer who verifies it, see `signature.sign`.
        cases: Without a season, other cases of each scenario than those of the board.
        shard: Which share of a season's batches is run. The last one comes to the verdict.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What was found.

    Raises:
        Unfinished: Runs are missing that other shards make.
        MachineFault: `work` or the entry cannot be written, or crowdbench has changed meanwhile.
        InputError: The entry is not one of this board, or takes no part in the season, or was verified in it before, or
            the key is no maintainer's, or the planner could read it because there is no sandbox.
        KeyboardInterrupt: Somebody interrupted it. In a season, the same call goes on with what is finished.
    """
    if season is not None and key is None:
        raise InputError("what is found in a season is signed: give a maintainer's key, --key FILE")
    by = find_signer(key, season.root) if season and key else ""
    _check_possible(entry, board, season)
    spec = entry.spec
    seed = secrets.randbits(63) if season is None else season.seed(board.name)
    run = EntryRun(board, entry.directory, spec.planner, spec.options, work, board.cases, seed, shard, progress)
    if season and key:
        return _verify_in_season(entry, run, season, by, key)
    work.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"verify-{board.name}-{entry.name}-", dir=work) as folder:
        return _verify(entry, dataclasses.replace(run, out=Path(folder) / "runs", cases=cases or board.cases))


def _verify_in_season(entry: Entry, run: EntryRun, season: Season, by: str, key: Path) -> Verification:
    board, digest = run.board, run.digest(entry.spec.package_files)
    run = dataclasses.replace(run, out=run.out / f"verify-{board.name}-{entry.name}-{digest}-{run.seed:016x}")
    if run.shard != WHOLE:
        try:
            _drive_all(entry, run)
        except (MachineFault, Unfinished):
            raise
        except InputError:
            # A fault of the planner's is no end: `_verify` below drives the same cases, meets it again, and makes a
            # verdict of it, which says that the entry is refused.
            pass
    with lock_runs(run.out):
        entry = read_entry(entry.directory)
        _check_possible(entry, board, season)  # another process may be done
        found = _verify(entry, dataclasses.replace(run, shard=WHOLE), by, season.spec.name)
        write_verification(verification_folder(entry, season), found, board, run.out, key)
    shutil.rmtree(run.out, ignore_errors=True)
    return found


def _check_possible(entry: Entry, board: Board, season: Season | None) -> None:
    spec = entry.spec
    if spec.board != board.name:
        raise InputError(f"{entry.directory} is an entry of the board {spec.board}, not of {board.name}")
    if spec.board_digest != board.digest:
        raise InputError(
            f"{entry.directory} was made for other rules, scenarios or code of the board {board.name} "
            f"({spec.board_digest[:12]}) than these ({board.digest[:12]}): submit it again"
        )
    check_files_size(entry.directory)
    if season is None:
        return
    if not season.takes_part(board.name, entry.name, entry.digest):
        raise InputError(
            f"{entry.directory} takes no part in the season {season.spec.name}: it was not among the entries that were "
            "frozen, or was changed since"
        )
    if sandbox.level() == sandbox.PROCESS and not package(entry.spec.planner).startswith(f"{MAINTAINERS}=="):
        raise InputError(
            f"{entry.directory} cannot be verified in a season on this machine: without bubblewrap its planner could "
            "read the key that signs"
        )
    if is_verified(entry, board, season):
        raise InUse(f"{entry.directory} was verified in the season {season.spec.name} before, which is done once")


def is_verified(entry: Entry, board: Board, season: Season) -> bool:
    """Whether an entry has a verification in a season that counts."""
    try:
        return bool(read_verification(entry, board, season))
    except Unverified:
        return False


def _verify(entry: Entry, run: EntryRun, by: str = "", season: str = "") -> Verification:
    """Replay the public runs, run the planner on other cases, and compare."""
    seed = run.seed
    assert seed is not None  # as it is for public cases alone

    def report(verdict: Verdict, reason: str, **measured: Any) -> Verification:
        return Verification(
            by=by,
            on=datetime.datetime.now(datetime.UTC).date().isoformat(),
            board=run.board.name,
            board_digest=run.board.digest,
            entry=entry.name,
            entry_digest=entry.digest,
            season=season,
            seed=seed,
            level=sandbox.level(),
            verdict=verdict,
            reason=reason,
            **measured,
        )

    try:
        with limit_memory(MOST_MEMORY):
            difference = _find_difference(entry, run.board, run.progress)
    except MemoryError:
        difference = f"to replay its public runs takes more than {MOST_MEMORY / 1e9:g} GB of memory"
    if difference:
        return report(Verdict.NOT_REPRODUCED, difference)
    try:
        if change := describe_change(entry):
            return report(Verdict.REFUSED, change)
        failed = _drive_all(entry, run)
        if unexpected := [name for name in failed if name in entry.spec.reported]:
            return report(Verdict.REFUSED, f"{unexpected[0]}: {failed[unexpected[0]]}")
        others = network_runs(entry, run)
        method = summarize_method(run, others) if others else None
        speed = run.time_decisions()
    except MachineFault:
        raise
    except InputError as error:
        return report(Verdict.REFUSED, str(error))
    verdict, reason = _judge(entry, run)
    figures = {} if verdict == Verdict.REFUSED else read_figures(run.board, run.out)
    timed = {"untimed": speed} if isinstance(speed, str) else {"decision_time": speed}
    return report(verdict, reason, figures=figures, method=method, **timed)


def _find_difference(entry: Entry, board: Board, progress: Progress | None) -> str:
    """Return what the public runs of an entry say and their commands do not lead to; empty where all follows."""
    scenarios, driven = {scenario.name: scenario for scenario in board.load(None)}, set(entry.spec.reported)
    if not driven or driven != {path.name for path in entry.public.glob("*")} or not driven <= scenarios.keys():
        return "the scenarios of its reported figures are not those of its public runs, or not of this board"
    for name in driven_scenarios(board, entry.public):
        try:
            check_size(entry.public / name / COMMANDS, len(board.public_cases), scenarios[name].rules.max_steps)
            run = read_public_run(entry, board, scenarios[name])
            if not _are_means(entry.spec.reported[name], run.result["metrics"]):
                return f"{name}: the reported figures are not those of {EPISODES}"
            if differences := replay(run, scenarios[name], board.metrics, progress).differences:
                return f"{name}: {differences[0]}"
        except InputError as error:
            return f"{name}: {error}"
    return ""


def _are_means(reported: Mapping[str, float | None], metrics: Mapping[str, Mapping[str, Any]]) -> bool:
    """Check reported means, whose last digits depend on the version of NumPy."""
    if reported.keys() != metrics.keys():
        return False
    one, two = (np.array(each, float) for each in ([*reported.values()], [metrics[name]["mean"] for name in reported]))
    return np.allclose(one, two, rtol=1e-9, atol=0.0, equal_nan=True)


def _drive_all(entry: Entry, run: EntryRun) -> dict[str, str]:
    """Drive the planner of an entry, and the other networks of its method; returns and raises as `EntryRun.drive`.

    Raises:
        Unfinished: Runs are missing that other shards make.
    """
    failed = run.drive()
    others = network_runs(entry, run)
    for other in others:
        other.drive()
    for other in others:
        other.check_finished({})
    run.check_finished(failed)
    return failed


def _judge(entry: Entry, run: EntryRun) -> tuple[Verdict, str]:
    """The verdict on an entry whose planner has driven, and why."""
    for name in driven_scenarios(run.board, run.out):
        result = read_result(run.out / name)
        expected = entry.spec.facts_in(name), entry.spec.privileged
        if (result["run"]["planner"]["facts"], result["stated"]["privileged"]) != expected:
            return Verdict.REFUSED, f"{name}: the planner says other facts of itself than as entered"
    public, other = read_episodes(run.board, entry.public), read_episodes(run.board, run.out)
    if doubts := lower_than_claimed(public, {name: other[name] for name in public}):
        return Verdict.LOWER, "; ".join(doubts)
    missing = sandbox.MISSING[sandbox.level()]
    how = f"in a sandbox without network, which shows it its own files alone{missing and f', but {missing}'}"
    if sandbox.level() == sandbox.PROCESS:
        how = f"without a sandbox, {missing}"
    return Verdict.RERUN, f"the recorded commands lead to the reported figures; ran {how}"
