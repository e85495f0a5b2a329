"""One run: a planner drives the cases of a scenario, and what was measured is written to a directory."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import platform
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite.binding import get_host_cpu_name

from crowdbench.evaluate.directory import new_directory
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.results import EPISODES, RECORDING, RESULT, Episodes, planner_label, to_json
from crowdbench.evaluate.rollout import LogsTooLarge, rollout
from crowdbench.evaluate.seal import code, seal
from crowdbench.interrupts import Interrupts
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH, FIRST_RECORDED, MOST_FAILURES, WITH_EPISODES
from crowdbench.types import Outcome, Trace

MEMORY = 256e6
"""Bytes that the traces of a batch may take: long or crowded episodes run in smaller batches.

What planners log counts apart: see `rollout.LOG_MEMORY`.
"""


@dataclass(frozen=True)
class Finished:
    """What a run has written.

    Attributes:
        result: The contents of `result.json`.
        interrupted: Whether it was interrupted before its last case.
    """

    result: dict[str, Any]
    interrupted: bool


def run(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    out: Path,
    *,
    metrics: Mapping[str, Metric],
    about: Mapping[str, Any],
    asked: Mapping[str, Any] | None = None,
    replanning: Replanning = EVERY_STEP,
    record: str = "failures",
    batch: int = BATCH,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Finished:
    """Drive a planner through cases, measure, and write `result.json`, `episodes.csv` and what is recorded.

    What is recorded are the commands of all cases in `commands.parquet`, and episodes in `run.rrd`. At the end,
    `manifest.json` gets the sha256 of all these files: see `crowdbench.evaluate.seal`.

    An interrupt (Ctrl-C) keeps the batches that are finished. They are the first cases, so that their rates are not
    biased towards short episodes.

    Args:
        driver: Asks the planner for commands.
        scenario: The scenario of the cases.
        cases: The cases.
        out: The directory to write.
        metrics: What is measured, by name.
        about: More that `result.json` says of the run.
        asked: More that `manifest.json` says of what was asked for, such as the scenario's file.
        replanning: When the planner observes, as in `rollout`.
        record: What is recorded, one of `settings.RECORD`.
        batch: Cases that run in lock-step, fewer where their traces would take too much memory.
        overwrite: Whether an earlier run in `out` is replaced.
        progress: Called after each step with what it added to the episodes, in parts of an episode.

    Returns:
        The result, which is that of the finished batches where the run was interrupted.

    Raises:
        InputError: Planner, scenario or a metric break their contract, or `out` cannot be written. Nothing is kept.
        KeyboardInterrupt: Interrupted before the first batch was finished. Nothing is kept.
    """
    start = time.perf_counter()
    code()  # before somebody changes it
    label = planner_label(driver.name, about.get("options", {}), replanning.settings)
    with Interrupts() as interrupts, new_directory(out, overwrite) as directory:
        with (
            _recorder(record, directory / RECORDING, label, scenario, len(cases)) as keep,
            _command_writer(record, directory) as keep_commands,
        ):

            def drive(part: Cases) -> Trace:
                with interrupts.let_through():
                    logs = record in WITH_EPISODES
                    return rollout(driver, scenario, part, replanning=replanning, keep_logs=logs, progress=progress)

            def keep_all(trace: Trace, measured: Episodes) -> int:
                keep_commands(trace)
                return keep(trace, measured, int(trace.case[0]) - cases.start)

            traces = _traces(drive, driver, cases, fitting(batch, scenario))
            episodes, recorded = _measured(traces, metrics, keep_all)
        driven = Cases(cases.split, cases.start, cases.start + len(episodes))
        settings = {"replan_every": replanning.every, **replanning.settings}
        result = _result(driver, scenario, driven, episodes, settings | dict(about), recorded, start)
        episodes.write(directory / EPISODES)
        (directory / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        request = {"cases": str(cases), "metrics": list(metrics), **settings, "record": record}
        request |= {"decision_limit": driver.decision_limit, **(asked or {})}
        seal(directory, _manifest(about, request, interrupted=len(driven) < len(cases)))
    return Finished(result, interrupted=len(driven) < len(cases))


def _measured(
    traces: Iterator[Trace], metrics: Mapping[str, Metric], keep: Callable[[Trace, Episodes], int]
) -> tuple[Episodes, int]:
    """Measure and record traces, to the last one or to an interrupt.

    Args:
        traces: The traces.
        metrics: What is measured, by name.
        keep: Records a trace with its measured episodes, and returns the number of those in the recording.

    Returns:
        The measured episodes, and how many of them are recorded.

    Raises:
        KeyboardInterrupt: Interrupted before the first trace was finished.
    """
    parts: list[Episodes] = []
    recorded = 0
    try:
        for trace in traces:
            parts.append(Episodes.of(trace, metrics))
            recorded += keep(trace, parts[-1])
            del trace  # two traces at a time would take twice the memory
    except KeyboardInterrupt:
        if not parts:
            raise
    return Episodes.joined(parts), recorded


def _traces(drive: Callable[[Cases], Trace], driver: Driver, cases: Cases, batch: int) -> Iterator[Trace]:
    """The traces of all cases, batch by batch, in smaller ones where the planner's logs would take too much memory.

    Args:
        drive: Drives some cases, as `rollout` does.
        driver: The driver, whose time for a batch that was given up does not count.
        cases: The cases.
        batch: Cases that run in lock-step, at most.
    """
    start = cases.start
    while start < cases.stop:
        seconds = driver.seconds
        try:
            trace = drive(Cases(cases.split, start, min(start + batch, cases.stop)))
        except LogsTooLarge as error:
            batch, driver.seconds = error.fitting, seconds
            continue
        start += len(trace)
        yield trace
        del trace


def _result(
    driver: Driver,
    scenario: Scenario,
    cases: Cases,
    episodes: Episodes,
    about: Mapping[str, Any],
    recorded: int,
    start: float,
) -> dict[str, Any]:
    """The contents of `result.json`; `start` is when the run began, as `time.perf_counter` counts seconds."""
    return {
        "planner": driver.name,
        "privileged": driver.privileged,
        "planner_facts": driver.facts,
        **about,
        "scenario": {"name": scenario.name, "digest": scenario.digest, **scenario.table},
        "cases": str(cases),
        "recorded": recorded,
        "outcomes": episodes.counts(),
        "metrics": to_json(episodes.summary()),
        "rates": episodes.rates,
        "timing": {
            "decision_ms_per_step": 1e3 * driver.seconds / int(episodes.steps.sum()),
            "seconds": time.perf_counter() - start,
        },
        "versions": versions(),
    }


def _manifest(about: Mapping[str, Any], asked: Mapping[str, Any], interrupted: bool) -> dict[str, Any]:
    """What `manifest.json` says beside the digests of the run's files.

    Args:
        about: What `result.json` says of options, overrides and the planner's files.
        asked: What else was asked for.
        interrupted: Whether cases are missing at the end.
    """
    torch = {"torch": importlib.metadata.version("torch")} if "torch" in sys.modules else {}
    given = {name: about.get(name, {}) for name in ("options", "overrides")}
    return {
        "interrupted": interrupted,
        "asked": {**asked, **given},
        "planner_files": about.get("planner_files", {}),
        "versions": versions() | torch,
    }


def versions() -> dict[str, str]:
    """What the last bits of a result depend on: versions of packages, and the kind of the machine."""
    packages = {name: importlib.metadata.version(name) for name in ("crowdbench", "numpy", "numba", "scipy")}
    machine = f"{platform.system()} {platform.machine()} {get_host_cpu_name()}"
    return {"python": platform.python_version(), **packages, "machine": machine}


def directory_name(planner: str, scenario: str, cases: Cases, changes: Mapping[str, Any]) -> str:
    """The name of a run's directory, such as `orca-circle_crossing_5-500`.

    Args:
        planner: The planner's name.
        scenario: The scenario's name.
        cases: The cases.
        changes: Options and overrides; other ones give another name.
    """
    count = f"{cases.stop}" if cases.start == 0 else f"{cases.start}-{cases.stop}"
    parts = [planner, scenario, count if cases.split == "test" else f"{cases.split}-{count}"]
    parts += [f"{key}={value}" for key, value in changes.items()]
    # File systems allow 255 bytes, and the directory has a longer name while it is written.
    return re.sub(r"[^A-Za-z0-9_.=-]+", "_", "-".join(parts))[:200]


def fitting(batch: int, scenario: Scenario) -> int:
    """How many cases run in lock-step: `batch`, or fewer where their traces would take too much memory."""
    # Positions and velocities of every state, and as much again for what metrics make of them.
    each = 8 * 2 * 4 * (scenario.rules.max_steps + 1) * scenario.max_agents
    return max(1, min(batch, int(MEMORY / each)))


Keep = Callable[[Trace, Episodes, int], int]


@contextlib.contextmanager
def _recorder(record: str, path: Path, planner: str, scenario: Scenario, cases: int) -> Iterator[Keep]:
    """The recorder of a run: a function that records the wanted episodes of a batch and returns their number.

    The function is given the batch's trace, its measured episodes, and how many cases of the run came before it.

    Args:
        record: Which episodes are wanted, one of `settings.RECORD`.
        path: The recording.
        planner: The planner's name with its options.
        scenario: The scenario.
        cases: The number of cases of the run.
    """
    if record not in WITH_EPISODES:
        yield lambda trace, episodes, offset: 0
        return
    from crowdbench.record.write import Recorder

    with Recorder(
        path, planner=planner, scenario=scenario.name, scenario_digest=scenario.digest, cases=cases
    ) as recorder:
        failures = 0

        def keep(trace: Trace, episodes: Episodes, offset: int) -> int:
            nonlocal failures
            failed = trace.outcome != Outcome.SUCCESS
            wanted = failed & (failures + np.cumsum(failed) <= MOST_FAILURES) | (record == "all")
            wanted[: max(0, FIRST_RECORDED - offset)] = True
            failures += int(failed.sum())
            recorder.add(trace, np.flatnonzero(wanted), episodes.columns)
            return int(wanted.sum())

        yield keep


@contextlib.contextmanager
def _command_writer(record: str, directory: Path) -> Iterator[Callable[[Trace], None]]:
    """A function that keeps the commands of a batch in `directory`, unless nothing is recorded."""
    if record == "none":
        yield lambda trace: None
        return
    from crowdbench.evaluate.commands import COMMANDS, writing

    with writing(directory / COMMANDS) as write:
        yield write
