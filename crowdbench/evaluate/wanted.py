"""What a run was asked for, and the making of it, or of a part of its cases, in a directory."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from crowdbench.evaluate.directory import new_directory
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import Metric
from crowdbench.evaluate.recording import command_writer, recorder
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.results import EPISODES, RECORDING, RESULT, Episodes, planner_label, to_json
from crowdbench.evaluate.rollout import LogsTooLarge, rollout
from crowdbench.evaluate.seal import code, seal
from crowdbench.interrupts import Interrupts
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH, RECORD, WITH_EPISODES
from crowdbench.types import Trace

MEMORY = 256e6
"""Bytes that the traces of a batch may take: long or crowded episodes run in smaller batches.

What planners log counts apart: see `rollout.LOG_MEMORY`.
"""


@dataclass(frozen=True)
class Wanted:
    """What a run was asked for, loaded.

    Attributes:
        driver: Asks the planner for commands.
        scenario: The scenario of the cases.
        cases: The cases of the whole run.
        metrics: What is measured, by name.
        about: More that `result.json` says of the run.
        asked: More that `manifest.json` says of what was asked for, such as the scenario's file.
        replanning: When the planner observes, as in `rollout`.
        record: What is recorded, one of `settings.RECORD`.
        batch: Cases that run in lock-step, fewer where their traces would take too much memory.
    """

    driver: Driver
    scenario: Scenario
    cases: Cases
    metrics: Mapping[str, Metric]
    about: Mapping[str, Any]
    asked: Mapping[str, Any]
    replanning: Replanning = EVERY_STEP
    record: str = RECORD[0]
    batch: int = BATCH

    @property
    def settings(self) -> dict[str, Any]:
        """When the planner observes, as results say it."""
        return {"replan_every": self.replanning.every, **self.replanning.settings}

    @property
    def request(self) -> dict[str, Any]:
        """What a manifest says of what was asked for."""
        asked = {"cases": str(self.cases), "metrics": list(self.metrics), **self.settings, "record": self.record}
        return {**asked, "decision_limit": self.driver.decision_limit, **self.asked}

    @property
    def depends(self) -> dict[str, Any]:
        """All that the figures depend on."""
        planner = {"planner": self.driver.name, "privileged": self.driver.privileged, "facts": self.driver.facts}
        # What an isolated planner has used differs from run to run.
        about = {key: value for key, value in self.about.items() if key != "isolation"}
        return {**planner, **self.request, **about, "scenario": self.scenario.digest, "code": code()}

    @property
    def identity(self) -> str:
        """What tells the run from others, whoever makes it and where: a digest of what the figures depend on."""
        return hashlib.sha256(json.dumps(self.depends, sort_keys=True).encode()).hexdigest()[:8]

    def drive(self, part: Cases, directory: Path, progress: Callable[[float], None] | None = None) -> bool:
        """Make the run of some of the cases.

        Args:
            part: The cases.
            directory: The directory to write; an earlier run there is replaced.
            progress: As `rollout` calls it.

        Returns:
            Whether somebody interrupted it when all was done but the writing.

        Raises:
            InputError: Planner, scenario or a metric break their contract, or the directory cannot be written.
            KeyboardInterrupt: Somebody interrupted it.
        """
        start = time.perf_counter()
        self.driver.seconds = 0.0
        label = planner_label(self.driver.name, self.about.get("options", {}), self.replanning.settings)
        with Interrupts() as interrupts, new_directory(directory, overwrite=True) as folder:
            with (
                recorder(
                    self.record,
                    folder / RECORDING,
                    label,
                    self.scenario,
                    self.cases,
                    self.metrics,
                    options=self.about.get("options", {}),
                    identity=self.identity,
                ) as keep,
                command_writer(self.record, folder) as keep_commands,
            ):

                def keep_all(trace: Trace, measured: Episodes) -> int:
                    keep_commands(trace)
                    return keep(trace, measured)

                drive = self._rollout(interrupts, progress)
                traces = _traces(drive, self.driver, part, fitting(self.batch, self.scenario))
                episodes, recorded = _measured(traces, self.metrics, keep_all)
            about = self.settings | dict(self.about)
            result = _result(self.driver, self.scenario, part, episodes, about, recorded, start)
            episodes.write(folder / EPISODES)
            (folder / RESULT).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
            seal(folder, _manifest(self.about, self.request))
        return interrupts.asked

    def _rollout(self, interrupts: Interrupts, progress: Callable[[float], None] | None) -> Callable[[Cases], Trace]:
        def drive(cases: Cases) -> Trace:
            with interrupts.let_through():
                return rollout(
                    self.driver,
                    self.scenario,
                    cases,
                    replanning=self.replanning,
                    keep_logs=self.record in WITH_EPISODES,
                    progress=progress,
                )

        return drive


def _measured(
    traces: Iterator[Trace], metrics: Mapping[str, Metric], keep: Callable[[Trace, Episodes], int]
) -> tuple[Episodes, int]:
    """Measure and record traces.

    Args:
        traces: The traces.
        metrics: What is measured, by name.
        keep: Records a trace with its measured episodes, and returns the number of those in the recording.

    Returns:
        The measured episodes, and how many of them are recorded.
    """
    measured: list[Episodes] = []
    recorded = 0
    for trace in traces:
        measured.append(Episodes.of(trace, metrics))
        recorded += keep(trace, measured[-1])
        del trace  # two traces at a time would take twice the memory
    return Episodes.joined(measured), recorded


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
        **episodes.blocks,
        "rates": episodes.rates,
        "timing": {
            "decision_ms_per_step": 1e3 * driver.seconds / int(episodes.steps.sum()),
            "seconds": time.perf_counter() - start,
        },
        "versions": versions(),
    }


def _manifest(about: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """What `manifest.json` says beside the digests of the run's files.

    Args:
        about: What `result.json` says of options, overrides and the planner's files.
        asked: What else was asked for.
    """
    torch = {"torch": importlib.metadata.version("torch")} if "torch" in sys.modules else {}
    given = {name: about.get(name, {}) for name in ("options", "overrides")}
    return {
        "interrupted": False,
        "asked": {**asked, **given},
        "planner_files": about.get("planner_files", {}),
        "versions": versions() | torch,
    }


def versions() -> dict[str, str]:
    """What the last bits of a result depend on: versions of packages, and the kind of the machine."""
    packages = {name: importlib.metadata.version(name) for name in ("crowdbench", "numpy", "numba", "scipy")}
    machine = f"{platform.system()} {platform.machine()} {get_host_cpu_name()}"
    return {"python": platform.python_version(), **packages, "machine": machine}


def fitting(batch: int, scenario: Scenario) -> int:
    """How many cases run in lock-step: fewer than asked where their traces would take too much memory.

    Args:
        batch: How many are asked for.
        scenario: The scenario.
    """
    # Positions and velocities of every state, and as much again for what metrics make of them.
    each = 8 * 2 * 4 * (scenario.rules.max_steps + 1) * scenario.max_agents
    return max(1, min(batch, int(MEMORY / each)))
