"""An entry's planner drives the scenarios of a board, in a process of its own, and its decisions are timed.

The time of a decision never changes a command. What a slower or faster machine would measure is estimated by a fixed
piece of work, the calibration kernel, that is timed on the same core.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import shutil
import statistics
import timeit
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import Timeout

from crowdbench.boards.board import Board
from crowdbench.boards.entry import PLANNER, DecisionTime, Figures, file_digests
from crowdbench.boards.planner_files import locate_named_files
from crowdbench.isolation.planner import IsolatedPlanner
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.decision_time import decision_seconds
from crowdbench.runs.manifest import code
from crowdbench.runs.results import EPISODES, Episodes, read_result
from crowdbench.runs.run import Run
from crowdbench.runs.shards import ENDING, WHOLE, Shard, is_finished, make_run
from crowdbench.runs.spec import Replanning, RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError, MachineFault

NO_RUNS = shutil.ignore_patterns("networks", f"*{ENDING}*")
"""What lies beside the finished runs of an entry: those of other networks, and parts of unfinished runs."""

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or machine of reference gets another name."""

REFERENCE_MS = 25.0
"""What the kernel takes on the machine of reference, by definition: about one core of a rented server of 2026."""

TIMED_CASES = Cases("val", 0, 11)
"""The cases that are timed, see `decision_seconds`; as many of them as there are where cars were recorded."""

Progress = Callable[[float], None]


class InUse(InputError):
    """Another process is making, or has made, the same runs."""


class Unfinished(InputError):
    """Runs are missing that other shards make."""


@dataclass(frozen=True)
class EntryRun:
    """The planner of an entry drives cases of every scenario of a board; those that have a run are not driven again.

    Attributes:
        board: The board.
        folder: The folder of the entry.
        planner: As `crowdbench run --planner` takes it; a file is relative to the folder.
        options: The planner's options; files are relative to the folder.
        out: The folder of the runs, a directory for each scenario.
        cases: The cases of each scenario.
        seed: The seed of the cases; None for the public ones, of which the commands are kept.
        hidden: Folders that the planner must not read; its own it may.
        shard: Which share of the batches is run.
        progress: Called after each step with what it added to the episodes, in parts of an episode.
    """

    board: Board
    folder: Path
    planner: str
    options: Mapping[str, Any]
    out: Path
    cases: Cases
    seed: int | None = None
    hidden: Sequence[Path] = ()
    shard: Shard = WHOLE
    progress: Progress | None = None

    def digest(self, package_files: Mapping[str, str]) -> str:
        """Twelve hexadecimal digits that change with all that the runs depend on, but for their seed.

        Args:
            package_files: The files of a planner that is built in or installed.
        """
        own = [file_digests(self.folder / PLANNER), dict(package_files)]
        text = json.dumps([self.board.digest, self.planner, self.options, own, code()], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def drive(self) -> dict[str, str]:
        """Make the runs.

        Returns:
            Scenarios that have no run, because the planner breaks its contract or a limit in them, with the reason.

        Raises:
            InputError: This is so in all scenarios.
            MachineFault: `out` cannot be written, or crowdbench has changed meanwhile.
            KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
        """
        failed: dict[str, InputError] = {}
        for number, scenario in enumerate(self.board.load(self.seed)):
            if is_finished(self.out / scenario.name):
                if self.progress is not None:
                    self.progress(len(self.cases))
                continue
            try:
                self._drive(scenario, self.shard.rotate(number))
            except MachineFault:
                raise
            except InputError as error:
                failed[scenario.name] = error
        if len(failed) == len(self.board.scenarios):
            raise next(iter(failed.values()))
        return {name: str(error) for name, error in failed.items()}

    def _drive(self, scenario: Scenario, shard: Shard) -> None:
        spec = RunSpec(
            self.planner,
            scenario.name,
            self.cases,
            dict(self.options),
            self.board.overrides(self.seed),
            replanning=self.board.replanning,
            record="commands" if self.seed is None else "none",
            batch=BATCH,
        )
        origin = {"board": self.board.name, "version": self.board.spec.version}
        with contextlib.closing(self._start_planner(scenario, [*self.hidden, self.out])) as planner:
            run = Run(spec, Driver(planner, planner.name), scenario, self.board.metrics, origin)
            make_run(run, self.out / scenario.name, shard=shard, progress=self.progress)

    def _start_planner(self, scenario: Scenario, hidden: Sequence[Path]) -> IsolatedPlanner:
        """The planner in a process of its own, which must not read the board's recorded tracks either."""
        return IsolatedPlanner(
            locate_named_files(self.planner, self.folder),
            locate_named_files(self.options, self.folder),
            hidden=[*hidden, *([self.board.data.resolve()] if self.board.data else [])],
            readable=[self.folder],
            folder=Path("/"),  # somewhere else, so that files which the entry lacks are missed
            scene=scenario.tracks.scene if scenario.tracks else None,
        )

    def check_finished(self, failed: Mapping[str, str]) -> None:
        """Raise Unfinished where runs are missing, but for scenarios in which the planner fails."""
        names = [name for name in self.board.scenarios if name not in failed]
        if missing := [name for name in names if not is_finished(self.out / name)]:
            raise Unfinished(f"batches of {missing[0]} are missing, which other shards make; whoever ends last goes on")

    def time_decisions(self) -> DecisionTime:
        """Time the decisions of the planner in the first scenario that it could drive, in one world, on one core.

        Raises:
            InputError: The planner breaks its contract or a limit.
        """
        first = driven_scenarios(self.board, self.out)[0]
        scenario = next(scenario for scenario in self.board.load(None) if scenario.name == first)
        with contextlib.closing(self._start_planner(scenario, self.hidden)) as planner:
            planner.process.pin()
            return time_decisions(planner, planner.name, scenario, self.board.replanning)


def time_decisions(planner: Planner, name: str, scenario: Scenario, replanning: Replanning) -> DecisionTime:
    """Time the decisions of a planner, one world at a time.

    Args:
        planner: The planner, on one core.
        name: What it is called in errors.
        scenario: The scenario.
        replanning: When it observes.

    Raises:
        InputError: See `decision_seconds`.
    """
    most = scenario.tracks.most_cases(TIMED_CASES.split) if scenario.tracks else None
    cases = TIMED_CASES if most is None else dataclasses.replace(TIMED_CASES, stop=min(TIMED_CASES.stop, most))
    before = kernel_seconds()
    seconds = decision_seconds(planner, name, scenario, replanning, cases)
    kernel_ms = 1e3 * (before + kernel_seconds()) / 2.0
    p99 = 1e3 * float(np.percentile(seconds, 99))
    calibrated = p99 * REFERENCE_MS / kernel_ms
    return DecisionTime(
        p99_ms=p99,
        kernel=KERNEL,
        kernel_ms=kernel_ms,
        calibrated_p99_ms=calibrated,
        is_real_time=calibrated <= 1e3 * scenario.rules.dt,
    )


def kernel_seconds() -> float:
    """The median time in seconds, of five tries, of the calibration kernel: a loop of Python, and sorting in NumPy."""

    def work() -> None:
        total = 0
        for number in range(300_000):
            total += number * number & 255
        values = np.random.Generator(np.random.Philox(1)).random(300_000)
        np.sort(values)

    return statistics.median(timeit.repeat(work, number=1, repeat=5))


@contextlib.contextmanager
def lock_runs(out: Path) -> Iterator[None]:
    """Keep other processes from making the same runs. Raises InUse where another process is making them."""
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        with files.hold_lock(out.with_name(f".{out.name}.lock"), 0):
            yield
    except Timeout:
        raise InUse(f"another process is making the runs of {out}") from None


def driven_scenarios(board: Board, out: Path) -> list[str]:
    """The names of the scenarios of a board of which there is a run in a folder."""
    return [name for name in board.scenarios if (out / name).is_dir()]


def read_episodes(board: Board, out: Path) -> dict[str, Episodes]:
    """The episodes of the runs in a folder, by scenario. Raises InputError where one is damaged."""
    return {name: Episodes.read(out / name / EPISODES) for name in driven_scenarios(board, out)}


def read_figures(board: Board, out: Path) -> Figures:
    """The means of the runs in a folder, by scenario and metric. Raises InputError where one is damaged."""
    results = {name: read_result(out / name)["metrics"] for name in driven_scenarios(board, out)}
    return {name: {metric: each["mean"] for metric, each in metrics.items()} for name, metrics in results.items()}
