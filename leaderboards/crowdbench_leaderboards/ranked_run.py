"""The ranked run of an entry: one world at a time, in a process of its own, with every decision timed.

Each scenario has a fresh process. The order of its cases is drawn with the seed, so that a planner knows neither the
next case nor which decisions count for its time: all do. A run keeps a physical core to itself. It writes a line for
each finished case to its log, and continues with the log after a kill.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from filelock import Timeout
from jaxtyping import Float, Int

from crowdbench import Cases, Driver, Episodes, InputError, Observation, load_planner, rollout
from crowdbench.cli import say
from crowdbench.isolation import usable_cores
from crowdbench.metrics import UNDISTURBED, info_of
from crowdbench.planners import AheadPlanner
from crowdbench.runs import Progress, code
from crowdbench.utils import Executor, MachineFault, hold_lock, write_whole
from crowdbench_leaderboards.board import others_in
from crowdbench_leaderboards.board_runs import CaseSet, EntryPlanner, InUse
from crowdbench_leaderboards.episode_table import episodes_of

HARD_LIMIT = 20
"""Number of time steps after which a decision is stopped, except in the first case, in which code may be compiled."""

MIN_IN_TIME = 0.99
"""Smallest share of decisions below the time step of a real-time planner."""


@dataclass(frozen=True)
class RankedTask:
    """The ranked cases of a scenario.

    Attributes:
        planner: The planner.
        case_set: The cases of the board, with their seed.
        scenario: The name of the scenario.
        entry: The digest of the entry.
        log: The file of finished cases.
    """

    planner: EntryPlanner
    case_set: CaseSet
    scenario: str
    entry: str
    log: Path

    @property
    def header(self) -> dict[str, Any]:
        """The facts on which the cases in the log depend."""
        board, cases, seed = self.case_set.board, self.case_set.cases, self.case_set.seed
        return {"entry": self.entry, "board": board.digest, "cases": str(cases), "seed": seed, "code": code()}

    @property
    def order(self) -> list[int]:
        """The cases in the order in which they are driven."""
        words = [self.case_set.seed or 0, *self.scenario.encode()]
        return np.random.default_rng(words).permutation(self.case_set.cases.indices).tolist()

    def lines(self) -> list[dict[str, Any]]:
        """Return the lines of the log, without one that a kill has cut; none if the log is of another run."""
        lines = []
        with contextlib.suppress(OSError, ValueError):
            for line in self.log.read_text().splitlines():
                lines.append(json.loads(line))
        return lines[1:] if lines and lines[0] == self.header else []

    def count(self) -> int:
        """Return the number of finished cases."""
        return sum("case" in line for line in self.lines())


class RankedRun(NamedTuple):
    """The result of a ranked run.

    Attributes:
        episodes: The episodes in the order of their cases; None if the planner failed.
        seconds: The time of each decision.
        planner: Facts of the planner: `facts`, `privileged` and `raw`.
        failed: The sentence with which the planner failed; otherwise empty.
    """

    episodes: Episodes | None
    seconds: list[float]
    planner: dict[str, Any]
    failed: str


class _TimedPlanner(AheadPlanner):
    """Planner that measures the time of each decision of a driver.

    The time of a decision is the time until the answer, or the processor time of the planner and of all that it has
    started since its last answer, if that is more.

    Args:
        driver: The driver of the planner.
        processor: Returns the processor time of the planner so far.
    """

    native = True  # the driver has converted velocities to commands

    def __init__(self, driver: Driver, processor: Callable[[], float]) -> None:
        self.driver, self.processor = driver, processor
        self.privileged, self.raw = driver.privileged, driver.raw
        self.seconds: list[float] = []
        self.taken = processor()

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.driver.reset(rows)

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        """See `AheadPlanner`."""
        start = time.perf_counter()
        commands = self.driver.decide(obs)[:, None] if steps == 1 else self.driver.decide_ahead(obs, steps)
        seconds, before = time.perf_counter() - start, self.taken
        self.taken = self.processor()
        self.seconds.append(max(seconds, self.taken - before))
        return commands


def drive_ranked(task: RankedTask, progress: Progress | None = None) -> None:
    """Drive the ranked cases of a scenario that are not in its log.

    Args:
        task: The cases.
        progress: Called after each case with 1.

    Raises:
        InUse: Another process drives them.
        MachineFault: The log cannot be written, or crowdbench has changed meanwhile.
    """
    report = progress or (lambda done: None)
    task.log.parent.mkdir(parents=True, exist_ok=True)
    try:
        with hold_lock(task.log.with_suffix(".lock"), 0), _own_core() as core:
            lines = task.lines()
            report(sum("case" in line for line in lines))
            done = {line.get("case") for line in lines}
            missing = [case for case in task.order if case not in done]
            if not missing or any("failed" in line for line in lines):
                return
            with write_whole(task.log) as partial:
                _write_log(partial, [task.header, *lines])
            try:
                _drive(task, missing, core, report)
            except MachineFault:
                raise
            except InputError as error:
                _write_log(task.log, [{"failed": str(error)}])
    except Timeout:
        raise InUse(f"another process drives the cases of {task.log}") from None
    except OSError as error:
        raise MachineFault(f"{task.log} cannot be written: {error.strerror or error}") from None


def _drive(task: RankedTask, cases: Sequence[int], core: Sequence[int], report: Progress) -> None:
    """Drive cases one after the other, and write a line for each."""
    board = task.case_set.board
    scenario = next(each for each in task.case_set.scenarios if each.name == task.scenario)
    undisturbed = any(UNDISTURBED in info_of(name).needs for name in board.metrics)
    others = load_planner(others_in(scenario.name)) if others_in(scenario.name) else None
    settings: dict[str, Any] = {"others": others, "replanning": board.replanning, "undisturbed": undisturbed}
    with task.planner.start(scenario, core) as isolated:
        driver = Driver(isolated, isolated.name)
        raw = driver.raw and scenario.rules.sensor.detector is not None
        about = {"facts": driver.facts, "privileged": driver.privileged, "raw": raw}
        _write_log(task.log, [{"planner": about}])
        timed = _TimedPlanner(driver, isolated.process.usage.seconds)
        for case in cases:
            timed.seconds = []
            only = Cases(task.case_set.cases.split, case, case + 1)
            trace = rollout(timed, scenario, only, **settings)
            timed.driver.decision_limit = HARD_LIMIT * scenario.rules.dt
            episodes = Episodes.of(trace, board.metrics)
            rows = [*(episodes.of_first_vehicle() if others else episodes)]
            seconds = [round(each, 6) for each in timed.seconds]
            _write_log(task.log, [{"case": case, "episodes": rows, "seconds": seconds}])
            report(1)


def _write_log(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    with path.open("a", encoding="utf-8") as file:
        file.writelines(json.dumps(line) + "\n" for line in lines)


def read_ranked(task: RankedTask) -> RankedRun:
    """Read the result of a finished ranked run."""
    lines = task.lines()
    planner: dict[str, Any] = next((line["planner"] for line in lines if "planner" in line), {})
    cases = sorted((line for line in lines if "case" in line), key=lambda line: line["case"])
    failed = next((line["failed"] for line in lines if "failed" in line), "")
    rows, seconds = ([each for line in cases for each in line[name]] for name in ("episodes", "seconds"))
    if failed or len(cases) < len(task.case_set.cases):
        return RankedRun(None, seconds, planner, failed or "its ranked run is not finished")
    return RankedRun(episodes_of(pa.Table.from_pylist(rows), task.case_set.board), seconds, planner, "")


def drive_all(tasks: Sequence[RankedTask], progress: Progress, executor: Executor | None = None) -> None:
    """Drive the ranked cases of several scenarios, on workers if there are any.

    Raises the first error after all others are finished; `InUse` if another process drives some of the cases.
    """
    if executor is None:
        for task in tasks:
            drive_ranked(task, progress)
        return
    running = {executor.submit(_drive_on_worker, task) for task in tasks}
    futures, reported = list(running), 0
    while running:
        _, running = wait(running, 1.0)
        done = sum(task.count() for task in tasks)
        progress(max(done - reported, 0))
        reported = max(done, reported)
    if errors := [error for future in futures if (error := future.result())]:
        raise errors[0]


def _drive_on_worker(task: RankedTask) -> InputError | None:
    try:
        drive_ranked(task)
    except InputError as error:
        return error
    return None


@contextlib.contextmanager
def _own_core() -> Iterator[list[int]]:
    """Keep this process on a physical core that no other ranked run uses, and wait for one if all are in use.

    Yields:
        The core; an empty list if the system does not report any.
    """
    usable = usable_cores()
    cores = sorted({min(set(_siblings(core)) & set(usable), default=core) for core in usable})
    if not cores:
        yield []
        return
    with contextlib.ExitStack() as stack:
        core = _wait_for_core(cores, stack)
        os.sched_setaffinity(0, [core])
        try:
            yield [core]
        finally:
            os.sched_setaffinity(0, usable)


def _wait_for_core(cores: Sequence[int], stack: contextlib.ExitStack) -> int:
    """Return a core whose lock the stack holds."""
    user = os.getuid() if hasattr(os, "getuid") else 0
    told = False
    while True:
        for core in cores:
            lock = Path(tempfile.gettempdir()) / f"crowdbench-{user}-core-{core}.lock"
            with contextlib.suppress(Timeout):
                stack.enter_context(hold_lock(lock, 0))
                return core
        if not told:
            say("waiting for a core: other ranked runs use all of them")
            told = True
        time.sleep(0.2)


@functools.cache
def _siblings(core: int) -> tuple[int, ...]:
    """Return the processors that share a physical core with a processor, itself included."""
    with contextlib.suppress(OSError, ValueError):
        text = Path(f"/sys/devices/system/cpu/cpu{core}/topology/thread_siblings_list").read_text()
        spans = [[*map(int, span.split("-"))] for span in text.split(",")]
        return tuple(each for span in spans for each in range(span[0], span[-1] + 1))
    return (core,)
