"""An entry's planner drives the scenarios of a board, in a process of its own."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import Timeout

from crowdbench.boards.board import Board
from crowdbench.boards.decision_time import time_decisions
from crowdbench.boards.entry import PLANNER, file_digests
from crowdbench.boards.kept_runs import driven_scenarios
from crowdbench.boards.planner_files import imported_code, locate_named_files
from crowdbench.boards.verdict import DecisionTime
from crowdbench.isolation.planner import IsolatedPlanner, Limits
from crowdbench.planners.driver import Driver
from crowdbench.runs.load import identify
from crowdbench.runs.recording import COMMANDS, read_commands
from crowdbench.runs.rollout import rollout
from crowdbench.runs.run import Run
from crowdbench.runs.shards import WHOLE, Shard, is_finished, make_run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils import files
from crowdbench.utils.defaults import BATCH
from crowdbench.utils.errors import InputError, MachineFault

Progress = Callable[[float], None]

LIMITS = Limits(total=7200.0)
"""What a planner may take for the cases of one scenario."""

PACE, SAMPLED = 20, 4
"""Number of cases whose duration is measured, and of scenarios, spread over the board."""


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
        seed: The seed of the cases; None for the public ones.
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
    shard: Shard = WHOLE
    progress: Progress | None = None

    def digest(self, package_files: Mapping[str, str]) -> str:
        """Twelve hexadecimal digits that change with all that the runs depend on, but for their seed.

        Args:
            package_files: The files of a planner that is built in or installed.
        """
        code = imported_code(self.planner, self.options, self.folder)
        own = [file_digests(self.folder / PLANNER), dict(package_files), code]
        text = json.dumps([self.board.digest, self.planner, self.options, own], sort_keys=True)
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
            record="commands",
            batch=BATCH,
        )
        with contextlib.closing(self._start_planner(scenario)) as planner:
            driver = Driver(planner, planner.name)
            located, options = (locate_named_files(each, self.folder) for each in (self.planner, self.options))
            identity = identify(located, options, driver, self.options)
            run = Run(spec, driver, scenario, self.board.metrics, identity)
            make_run(run, self.out / scenario.name, shard=shard, progress=self.progress)

    def _start_planner(self, scenario: Scenario) -> IsolatedPlanner:
        """The planner in a process of its own, which can read what is frozen with its entry and nothing else of it."""
        return IsolatedPlanner(
            locate_named_files(self.planner, self.folder),
            locate_named_files(self.options, self.folder),
            LIMITS,
            readable=filter(Path.exists, [self.folder / PLANNER]),
            folder=Path("/"),  # somewhere else, so that files which the entry lacks are missed
            scene=scenario.tracks.scene if scenario.tracks else None,
        )

    def check_finished(self, failed: Mapping[str, str]) -> None:
        """Raise Unfinished where runs are missing, but for scenarios in which the planner fails."""
        names = [name for name in self.board.scenarios if name not in failed]
        if missing := [name for name in names if not is_finished(self.out / name)]:
            raise Unfinished(f"batches of {missing[0]} are missing, which other shards make; the last shard goes on")

    def seconds_per_case(self) -> float:
        """Measure how long a public case takes here, in seconds, without scenarios that the planner cannot drive."""
        known = self.board.load(None)
        sampled = known[:: math.ceil(len(known) / SAMPLED)]
        cases = Cases("test", 0, min(PACE // len(sampled), self.board.spec.public_cases))
        seconds = []
        for scenario in sampled:
            try:
                seconds.append(self._seconds_in(scenario, cases))
            except MachineFault:
                raise
            except InputError:
                continue
        return sum(seconds) / max(len(seconds), 1)

    def _seconds_in(self, scenario: Scenario, cases: Cases) -> float:
        with contextlib.closing(self._start_planner(scenario)) as planner:
            driver = Driver(planner, planner.name)
            # One case comes before, which does not count: what a planner does once is no cost of a case.
            for driven in (Cases("test", 0, 1), cases):
                start = time.perf_counter()
                rollout(driver, scenario, driven, replanning=self.board.replanning, undisturbed=False)
            return (time.perf_counter() - start) / len(cases)

    def time_decisions(self) -> DecisionTime | str:
        """Time its decisions in the first scenario that it could drive; returns and raises as `time_decisions`."""
        first = driven_scenarios(self.board, self.out)[0]
        scenario = next(scenario for scenario in self.board.load(self.seed) if scenario.name == first)
        ranked = read_commands(self.out / first / COMMANDS)
        with contextlib.closing(self._start_planner(scenario)) as planner:
            return time_decisions(planner, scenario, self.board.replanning, self.cases, ranked)


@contextlib.contextmanager
def lock_runs(out: Path) -> Iterator[None]:
    """Keep other processes from making the same runs. Raises InUse where another process is making them."""
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        with files.hold_lock(out.with_name(f".{out.name}.lock"), 0):
            yield
    except Timeout:
        raise InUse(f"another process is making the runs of {out}") from None
