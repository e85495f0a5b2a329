"""Runs an entry again and says whether it holds.

First every public case is simulated again from its recorded commands, in this process, which never loads the planner.
Then the planner drives cases that it cannot know, in a process of its own. What no replay can see is in
`docs/boards.md`.
"""

from __future__ import annotations

import datetime
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from crowdbench.boards.believable import unbelievable
from crowdbench.boards.board import FILE, ROOT, Board
from crowdbench.boards.driving import (
    BOARD_METRICS,
    NO_RUNS,
    Entrant,
    InUse,
    Progress,
    drive,
    episodes,
    figures,
    locked,
    made,
    run_digest,
    timed,
)
from crowdbench.boards.entry import (
    PUBLIC,
    SEASONS,
    DecisionTime,
    Entry,
    Figures,
    Method,
    Verdict,
    Verification,
    file_digests,
    read_entry,
    write_entry,
)
from crowdbench.boards.method import claims, measured, method_cases
from crowdbench.boards.packaged import changed
from crowdbench.boards.season import Season
from crowdbench.errors import InputError, NotWritten
from crowdbench.evaluate.replay import RunFiles, replay
from crowdbench.evaluate.results import read_result
from crowdbench.evaluate.seal import code
from crowdbench.isolation import sandbox
from crowdbench.scenario.cases import Cases


@dataclass(frozen=True)
class Found:
    """What a verification has found so far.

    Attributes:
        verdict: The verdict.
        reason: Why, in a sentence.
        figures: What was measured.
        decision_time: How long decisions took.
        method: What holds of its method.
    """

    verdict: Verdict
    reason: str
    figures: Figures
    decision_time: DecisionTime | None = None
    method: Method | None = None


def verify(
    entry: Entry,
    board: Board,
    *,
    by: str,
    work: Path,
    season: Season | None = None,
    cases: Cases | None = None,
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
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What was found.

    Raises:
        NotWritten: `work` or the entry cannot be written.
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
    digest = run_digest(board, _entrant(entry), entry.spec.package_files)
    kept = work / f"verify-{board.name}-{entry.name}-{digest}-{seed:016x}"
    with locked(kept):
        _check_possible(read_entry(entry.directory, check_files=False), board, season)  # another process may be done
        # Of a process that was killed between writing its runs and its verdict.
        shutil.rmtree(entry.directory / SEASONS / season.spec.name, ignore_errors=True)
        entry = read_entry(entry.directory)
        found = _verified(entry, board, by, seed, cases, kept, progress)
        verification = found.model_copy(update={"season": season.spec.name})
        _record(entry, verification, kept)
    shutil.rmtree(kept, ignore_errors=True)
    return verification


def cases_of_season(entry: Entry, board: Board) -> Cases:
    """The cases of each scenario that an entry drives in a season.

    Args:
        entry: The entry.
        board: Its board.

    Raises:
        InputError: Its public runs are damaged.
    """
    results = [read_result(entry.directory / PUBLIC / name) for name in made(board, entry.directory / PUBLIC)]
    seconds = sum(float(result["timing"]["seconds"]) for result in results)
    return board.cases_at(seconds / (len(board.public_cases) * max(len(results), 1)))


def cases_of(entry: Entry, board: Board, cases: Cases | None = None) -> int:
    """How many cases a verification replays and drives.

    Args:
        entry: The entry.
        board: Its board.
        cases: The cases of each scenario, if not those of a season.
    """
    own = (len(cases or cases_of_season(entry, board)) + board.spec.public_cases) * len(board.scenarios)
    others = len(entry.spec.networks) if claims(board, entry.spec.networks) else 0
    return own + others * len(method_cases(board))


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


def _entrant(entry: Entry) -> Entrant:
    return Entrant(entry.directory, entry.spec.planner, entry.spec.options)


def _verified(
    entry: Entry, board: Board, by: str, seed: int, cases: Cases, kept: Path, progress: Progress | None
) -> Verification:
    """Run an entry again on the cases of a seed, and say what was found, outside any season."""
    found = _found(entry, board, seed, cases, kept, progress)
    return Verification(
        by=by,
        on=datetime.datetime.now(datetime.UTC).date().isoformat(),
        season="",
        seed=seed,
        code=code(),
        level=sandbox.level(),
        verdict=found.verdict,
        reason=found.reason,
        figures=found.figures,
        decision_time=found.decision_time,
        method=found.method,
    )


def _found(entry: Entry, board: Board, seed: int, cases: Cases, kept: Path, progress: Progress | None) -> Found:
    """Replay the public runs, run the planner on other cases, and compare."""
    entrant = _entrant(entry)
    differs = next(_differences(entry, board, progress), None)
    if differs:
        return Found(Verdict.NOT_REPRODUCED, differs, {})
    hidden = _hidden(entry, kept)
    try:
        if difference := changed(entry.spec):
            return Found(Verdict.REFUSED, difference, {})
        failed = drive(board, entrant, kept, cases=cases, seed=seed, hidden=hidden, progress=progress)
        if unexpected := [name for name in failed if name in entry.spec.reported]:
            return Found(Verdict.REFUSED, f"{unexpected[0]}: {failed[unexpected[0]]}", {})
        method = None
        if claims(board, entry.spec.networks):
            method = measured(board, entrant, entry.spec.networks, kept, seed=seed, hidden=hidden, progress=progress)
        speed = timed(board, entrant, kept, hidden)
    except NotWritten:
        raise
    except InputError as error:
        return Found(Verdict.REFUSED, str(error), {})
    verdict, reason = _judged(entry, board, kept)
    return Found(verdict, reason, {} if verdict == Verdict.REFUSED else figures(board, kept), speed, method)


def _judged(entry: Entry, board: Board, kept: Path) -> tuple[Verdict, str]:
    """The verdict on an entry whose planner has driven, and why."""
    for name in made(board, kept):
        said = read_result(kept / name)
        if (said.get("planner_facts"), said.get("privileged")) != (entry.spec.facts, entry.spec.privileged):
            return Verdict.REFUSED, f"{name}: the planner says other facts of itself than as entered"
    public, other = episodes(board, entry.directory / PUBLIC), episodes(board, kept)
    if doubts := unbelievable(public, {name: other[name] for name in public}):
        return Verdict.LOWER, "; ".join(doubts)
    level = {sandbox.BUBBLEWRAP: "in a sandbox without network and without our files"}
    how = level.get(sandbox.level(), "in a process of its own, which could read files and the network")
    return Verdict.RERUN, f"the recorded commands lead to the reported figures; ran {how}"


def _hidden(entry: Entry, kept: Path) -> list[Path]:
    """What an entry's planner must not read: the boards with their seeds, other entries, and the runs."""
    around = entry.directory.resolve().parents
    roots = [ROOT, around[2]] if len(around) > 2 and (around[2] / entry.spec.board / FILE).exists() else [ROOT]
    return [*roots, kept.parent]


def _differences(entry: Entry, board: Board, progress: Progress | None) -> Iterator[str]:
    """What the public runs of an entry say and their commands do not lead to, sentence by sentence."""
    for _, scenario in board.load(None):
        directory = entry.directory / PUBLIC / scenario.name
        if not directory.exists():
            continue
        try:
            files = RunFiles.read(directory)
            asked = {
                "cases": str(board.public_cases),
                "replan_every": board.replanning.every,
                "options": entry.spec.options,
                "privileged": entry.spec.privileged,
                "planner_facts": entry.spec.facts,
            }
            for key, value in {**asked, **board.replanning.settings}.items():
                if files.result.get(key) != value:
                    yield f"{scenario.name}: {key} is {files.result.get(key)!r}, but must be {value!r}"
            found = replay(files, scenario, BOARD_METRICS, progress)
        except InputError as error:
            yield f"{scenario.name}: {error}"
            continue
        yield from (f"{scenario.name}: {difference}" for difference in found.differences)
    try:
        if entry.spec.reported != figures(board, entry.directory / PUBLIC):
            yield "the reported figures of entry.json are not those of its runs"
    except InputError as error:
        yield str(error)


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
