"""An entry's planner drives the scenarios of a board, in a process of its own."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from crowdbench import plugins
from crowdbench.boards.board import Board
from crowdbench.boards.decision_time import decision_time
from crowdbench.boards.entry import PLANNER, DecisionTime, Figures, file_digests
from crowdbench.errors import InputError, MachineFault
from crowdbench.evaluate import run as runs
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.parts import ENDING, is_made
from crowdbench.evaluate.results import EPISODES, Episodes, read_result
from crowdbench.evaluate.seal import code
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.isolation.planner import IsolatedPlanner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH

NO_RUNS = shutil.ignore_patterns("networks", f"*{ENDING}*")
"""What lies beside the finished runs of an entry: those of other networks, and parts of unfinished runs."""

Progress = Callable[[float], None]


class InUse(InputError):
    """Another process is making, or has made, the same runs."""


class Unfinished(InputError):
    """Runs are missing that other shards make."""


@dataclass(frozen=True)
class Entrant:
    """The planner of an entry.

    Attributes:
        folder: The folder of the entry.
        planner: As `crowdbench run --planner` takes it; a file is relative to the folder.
        options: Its options; files are relative to the folder.
    """

    folder: Path
    planner: str
    options: Mapping[str, Any]

    @contextlib.contextmanager
    def started(self, board: Board, scenario: Scenario, hidden: Sequence[Path]) -> Iterator[IsolatedPlanner]:
        """The planner in a process of its own.

        Args:
            board: The board, whose recorded tracks it must not read.
            scenario: The scenario that it will drive in.
            hidden: Folders that it must not read; its own it may.

        Raises:
            InputError: It cannot be made.
        """
        options = {name: _located(self.folder, value) for name, value in self.options.items()}
        spec = _located(self.folder, self.planner)
        # Somewhere else, so that files which the entry lacks are missed.
        apart = IsolatedPlanner(
            spec,
            options,
            hidden=[*hidden, *([board.data.resolve()] if board.data else [])],
            shown=[self.folder],
            folder=Path("/"),
            scene=scenario.tracks.scene if scenario.tracks else None,
        )
        with contextlib.closing(apart):
            yield apart


def _located(folder: Path, value: Any) -> Any:
    """A value of an option whose files are relative to a folder, with their full paths."""
    if isinstance(value, Mapping):
        return {name: _located(folder, each) for name, each in value.items()}
    if isinstance(value, list):
        return [_located(folder, each) for each in value]
    if not isinstance(value, str):
        return value
    file, function = plugins.file_and_function(value)
    path = folder.resolve() / (file or value)
    if "/" not in value or not path.is_file():
        return value
    return f"{path}:{function}" if function else str(path)


def drive(
    board: Board,
    entrant: Entrant,
    out: Path,
    *,
    cases: Cases,
    seed: int | None,
    hidden: Sequence[Path] = (),
    shard: Shard = WHOLE,
    progress: Progress | None = None,
) -> dict[str, str]:
    """Make the runs of an entry, a directory for each scenario of its board. Those that are there are not made again.

    Args:
        board: The board.
        entrant: The planner.
        out: The folder of the runs.
        cases: The cases of each scenario.
        seed: The seed of the cases; None for the public ones, of which the commands are kept.
        hidden: Folders that the planner must not read.
        shard: Which share of the batches is run.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        Scenarios that have no run, because the planner breaks its contract or a limit in them, with the reason.

    Raises:
        InputError: This is so in all scenarios.
        MachineFault: `out` cannot be written, or crowdbench has changed meanwhile.
        KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
    """
    failed: dict[str, InputError] = {}
    for number, (_, scenario) in enumerate(board.load(seed)):
        directory = out / scenario.name
        if is_made(directory):
            if progress is not None:
                progress(len(cases))
            continue
        try:
            with entrant.started(board, scenario, [*hidden, out]) as planner:
                _run(board, entrant, planner, scenario, cases, directory, seed, shard.rotated(number), progress)
        except MachineFault:
            raise
        except InputError as error:
            # Without what is kept of other batches, of which nothing comes: this planner would fail again.
            failed[scenario.name] = error.__cause__ if isinstance(error.__cause__, InputError) else error
    if len(failed) == len(board.scenarios):
        raise next(iter(failed.values()))
    return {name: str(error) for name, error in failed.items()}


def _run(
    board: Board,
    entrant: Entrant,
    planner: IsolatedPlanner,
    scenario: Scenario,
    cases: Cases,
    directory: Path,
    seed: int | None,
    shard: Shard,
    progress: Progress | None,
) -> None:
    runs.run(
        Driver(planner, planner.name),
        scenario,
        cases,
        directory,
        metrics=board.metrics,
        about={"options": dict(entrant.options), "overrides": board.overrides(seed)},
        asked={"board": board.name, "version": board.spec.version},
        replanning=board.replanning,
        record="commands" if seed is None else "none",
        batch=BATCH,
        shard=shard,
        progress=progress,
    )


def check_finished(board: Board, out: Path, failed: Mapping[str, str]) -> None:
    """Raise Unfinished where runs are missing.

    Args:
        board: The board.
        out: The folder of the runs.
        failed: The scenarios that have no run because the planner fails in them.
    """
    names = [scenario.name for scenario in board.scenarios if scenario.name not in failed]
    if missing := [name for name in names if not is_made(out / name)]:
        raise Unfinished(f"batches of {missing[0]} are missing, which other shards make; whoever ends last goes on")


def run_digest(board: Board, entrant: Entrant, package_files: Mapping[str, str]) -> str:
    """Twelve hexadecimal digits that change with all that the runs of an entry depend on, but for their seed.

    Args:
        board: The board.
        entrant: The planner.
        package_files: The files of a planner that is built in or installed.
    """
    files = [file_digests(entrant.folder / PLANNER), dict(package_files)]
    text = json.dumps([board.digest, entrant.planner, entrant.options, files, code()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


@contextlib.contextmanager
def locked(kept: Path) -> Iterator[None]:
    """Keep other processes from making the same runs.

    Args:
        kept: The folder of the runs.

    Raises:
        InputError: Another process is making them.
    """
    kept.parent.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(kept.with_name(f".{kept.name}.lock"), timeout=0):
            yield
    except Timeout:
        raise InUse(f"another process is making the runs of {kept}") from None


def timed(board: Board, entrant: Entrant, out: Path, hidden: Sequence[Path]) -> DecisionTime:
    """Time the decisions of an entry's planner, in the first scenario that it can drive.

    Args:
        board: The board.
        entrant: The planner.
        out: The folder of its runs.
        hidden: Folders that the planner must not read.

    Raises:
        InputError: The planner breaks its contract or a limit.
    """
    first = made(board, out)[0]
    scenario = next(scenario for each, scenario in board.load(None) if each.name == first)
    with entrant.started(board, scenario, hidden) as planner:
        planner.process.pin()
        return decision_time(planner, planner.name, scenario, board.replanning)


def figures(board: Board, out: Path) -> Figures:
    """The means of the metrics of runs.

    Args:
        board: The board.
        out: The folder of its runs.

    Returns:
        Means by metric, by scenario.

    Raises:
        InputError: A run is damaged.
    """
    results = {name: read_result(out / name)["metrics"] for name in made(board, out)}
    return {name: {metric: each["mean"] for metric, each in metrics.items()} for name, metrics in results.items()}


def episodes(board: Board, out: Path) -> dict[str, Episodes]:
    """The episodes of runs.

    Args:
        board: The board.
        out: The folder of its runs.

    Returns:
        Episodes by scenario.

    Raises:
        InputError: A run is damaged.
    """
    return {name: Episodes.read(out / name / EPISODES) for name in made(board, out)}


def made(board: Board, out: Path) -> list[str]:
    """The scenarios of a board of which there is a run.

    Args:
        board: The board.
        out: The folder of its runs.

    Returns:
        Their names.
    """
    return [scenario.name for scenario in board.scenarios if (out / scenario.name).is_dir()]
