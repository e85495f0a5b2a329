"""Runs an entry again and compares.

First every public case is simulated again from its recorded commands, in this process, which never loads the planner.
Then the planner drives cases that it cannot know, in a process of its own. What no replay can see is in
`docs/boards.md`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from crowdbench.boards.believable import unbelievable
from crowdbench.boards.board import FILE, ROOT, Board
from crowdbench.boards.driving import (
    Entrant,
    Progress,
    check_finished,
    drive,
    episodes,
    figures,
    made,
    timed,
)
from crowdbench.boards.entry import (
    PUBLIC,
    DecisionTime,
    Entry,
    Figures,
    Method,
    Verdict,
)
from crowdbench.boards.method import claims, drive_others, measured, method_cases
from crowdbench.boards.packaged import changed
from crowdbench.errors import InputError, MachineFault
from crowdbench.evaluate.replay import RunFiles, replay
from crowdbench.evaluate.results import read_result
from crowdbench.evaluate.shard import WHOLE, Shard
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


def entrant_of(entry: Entry) -> Entrant:
    """What drives for an entry."""
    return Entrant(entry.directory, entry.spec.planner, entry.spec.options)


def cases_of_season(entry: Entry, board: Board) -> Cases:
    """The cases of each scenario that an entry drives in a season.

    Args:
        entry: The entry.
        board: Its board.

    Raises:
        InputError: Its public runs are damaged.
    """
    results = [read_result(entry.directory / PUBLIC / name) for name in made(board, entry.directory / PUBLIC)]
    try:
        seconds = sum(float(result["timing"]["seconds"]) for result in results)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{entry.directory / PUBLIC} has a run that does not say how many seconds it took") from None
    return board.cases_at(seconds / (len(board.public_cases) * max(len(results), 1)))


def cases_of(entry: Entry, board: Board, cases: Cases | None = None) -> int:
    """How many cases a verification replays and drives.

    Args:
        entry: The entry.
        board: Its board.
        cases: The cases of each scenario, if not those of a season.
    """
    driven = cases or cases_of_season(entry, board)
    own = (len(driven) + board.spec.public_cases) * len(board.scenarios)
    others = len(entry.spec.networks) if claims(board, entry.spec.networks) else 0
    return own + others * len(method_cases(driven))


def found(entry: Entry, board: Board, seed: int, cases: Cases, kept: Path, progress: Progress | None) -> Found:
    """Replay the public runs, run the planner on other cases, and compare.

    Args:
        entry: The entry.
        board: Its board.
        seed: The seed of the cases.
        cases: The cases of each scenario.
        kept: The folder of the runs. Those that are there are not made again.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        What was found.

    Raises:
        MachineFault: The runs cannot be written, or crowdbench has changed meanwhile.
        KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
    """
    differs = next(_differences(entry, board, progress), None)
    if differs:
        return Found(Verdict.NOT_REPRODUCED, differs, {})
    try:
        if difference := changed(entry.spec):
            return Found(Verdict.REFUSED, difference, {})
        failed = drive_all(entry, board, seed, cases, kept, WHOLE, progress)
        if unexpected := [name for name in failed if name in entry.spec.reported]:
            return Found(Verdict.REFUSED, f"{unexpected[0]}: {failed[unexpected[0]]}", {})
        networks = entry.spec.networks
        method = measured(board, networks, kept, method_cases(cases)) if claims(board, networks) else None
        speed = timed(board, entrant_of(entry), kept, _hidden(entry, kept))
    except MachineFault:
        raise
    except InputError as error:
        return Found(Verdict.REFUSED, str(error), {})
    verdict, reason = _judged(entry, board, kept)
    return Found(verdict, reason, {} if verdict == Verdict.REFUSED else figures(board, kept), speed, method)


def drive_all(
    entry: Entry, board: Board, seed: int, cases: Cases, kept: Path, shard: Shard, progress: Progress | None
) -> dict[str, str]:
    """Drive the planner of an entry, and the other networks of its method.

    Args:
        entry: The entry.
        board: Its board.
        seed: The seed of the cases.
        cases: The cases of each scenario.
        kept: The folder of the runs.
        shard: Which share of the batches is run.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        Scenarios that have no run, because the planner breaks its contract or a limit in them, with the reason.

    Raises:
        InputError: This is so in all scenarios, or in a run of another network.
        MachineFault: The runs cannot be written, or crowdbench has changed meanwhile.
        Unfinished: Runs are missing that other shards make.
        KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
    """
    entrant, others = entrant_of(entry), entry.spec.networks
    hidden = _hidden(entry, kept)
    failed = drive(board, entrant, kept, cases=cases, seed=seed, hidden=hidden, shard=shard, progress=progress)
    if claims(board, others):
        shared = method_cases(cases)
        drive_others(
            board, entrant, others, kept, cases=shared, seed=seed, hidden=hidden, shard=shard, progress=progress
        )
    check_finished(board, kept, failed)
    return failed


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
            found = replay(files, scenario, board.metrics, progress)
        except InputError as error:
            yield f"{scenario.name}: {error}"
            continue
        yield from (f"{scenario.name}: {difference}" for difference in found.differences)
    try:
        if entry.spec.reported != figures(board, entry.directory / PUBLIC):
            yield "the reported figures of entry.json are not those of its runs"
    except InputError as error:
        yield str(error)
