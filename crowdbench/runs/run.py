"""A loaded run, and the loop that drives all or some of its cases and writes a directory."""

from __future__ import annotations

import functools
import importlib.metadata
import platform
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from llvmlite.binding import get_host_cpu_name

from crowdbench.catalog import PLANNERS
from crowdbench.core.types import Trace, World
from crowdbench.metrics.registry import METRICS, Metric, need_undisturbed
from crowdbench.metrics.user_metrics import measure
from crowdbench.planners.driver import Driver
from crowdbench.results.episodes import RECORDING, Episodes, planner_label
from crowdbench.results.run_result import write_run
from crowdbench.results.stored_commands import COMMANDS, write_commands
from crowdbench.runs.identity import PlannerId, RunId, code, source_of
from crowdbench.runs.recording import RunRecorder, open_recorder, units_of
from crowdbench.runs.rollout import LogsTooLarge, Progress, rollout
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.defaults import WITH_EPISODES
from crowdbench.utils.errors import InputError, Interrupted
from crowdbench.utils.files import new_directory
from crowdbench.utils.interrupts import Interrupts

MEMORY = 256e6
"""Largest size in bytes of the traces of a batch: long or crowded episodes run in smaller batches.

Logs of planners have a separate limit, `rollout.LOG_MEMORY`.
"""


@dataclass(frozen=True)
class Run:
    """A run that is loaded.

    Attributes:
        spec: The specification of the run.
        driver: The driver of the planner.
        scenario: The scenario of the cases.
        metrics: The metrics, by name.
        planner: The identity of the planner.
        others: The driver and the identity of the planner of all vehicles but the first, if it is another one.
        isolation: Resource usage of an isolated planner, updated while it drives; None if it is not isolated.
        foresee: Called with the worlds before each step, for planners that measure the value of foresight.
        is_named: True if any process can load the same run from its specification, see `load_run`.
        failed: The errors of the user's metrics that failed, by name. Their columns are missing in the run.
        lost: The errors of recordings that could not be written.
    """

    spec: RunSpec
    driver: Driver
    scenario: Scenario
    metrics: Mapping[str, Metric]
    planner: PlannerId
    others: tuple[Driver, PlannerId] | None = None
    isolation: Mapping[str, Any] | None = None
    foresee: Callable[[World], None] | None = None
    is_named: bool = False
    failed: dict[str, str] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)

    def drive(self, part: Cases, directory: Path, progress: Progress | None = None) -> None:
        """Drive some of the cases, measure and record them, and write the directory of a run of these cases.

        Args:
            part: The cases.
            directory: The directory, which is replaced if it exists.
            progress: Called after each step with its progress, summed over the episodes, in fractions of an episode.

        Raises:
            InputError: The planner or the scenario breaks its contract. A metric of the user that fails is noted in
                `failed`.
            NotWritten: The directory cannot be written.
            Interrupted: The user interrupted the run. If all cases were driven already, the part was written.
        """
        start = time.perf_counter()
        self.driver.seconds = 0.0
        with Interrupts() as interrupts, new_directory(directory, overwrite=True) as folder:
            measured: list[Episodes] = []
            people = self.scenario.crowd.number[1]
            with open_recorder(self.spec.record, folder, self.spec.cases, people, self.header) as recorder:
                for trace in self._traces(part, interrupts, progress):
                    episodes = self._measure(trace)
                    recorder.add(trace, episodes, first_only=self.others is not None)
                    measured.append(episodes.of_first_vehicle() if self.others else episodes)
                    del trace  # two traces at a time would take twice the memory
            episodes = Episodes.join([each.without(self.failed) for each in measured])
            seconds = time.perf_counter() - start
            try:
                self._write(folder, part, episodes, recorder, seconds)
            except OSError as error:
                if not recorder.number:
                    raise
                (folder / RECORDING).unlink()
                recorder.drop(f"the recording {RECORDING} was removed to keep the results: {error.strerror or error}")
                self._write(folder, part, episodes, recorder, seconds)
            if recorder.lost:
                self.lost.append(recorder.lost)
        if interrupts.pending and part != self.spec.cases:
            raise Interrupted

    def _measure(self, trace: Trace) -> Episodes:
        """Measure a batch. A metric of the user that fails is left out from then on, so that the run goes on."""
        columns = {}
        for name, metric in self.metrics.items():
            if name in self.failed:
                continue
            try:
                columns[name] = measure(name, metric, trace)
            except InputError as error:
                if name in METRICS:
                    raise
                self.failed[name] = str(error)
        return Episodes(trace.case, trace.outcome, trace.steps, columns, trace.block, trace.vehicle)

    def _traces(self, cases: Cases, interrupts: Interrupts, progress: Progress | None) -> Iterator[Trace]:
        """Yield the traces of all cases, batch by batch. Batches are smaller if the planner's logs would take too much
        memory."""
        with_episodes = self.spec.record in WITH_EPISODES
        start, batch = cases.start, fit_batch(self.spec.batch, self.scenario)
        while start < cases.stop:
            seconds = self.driver.seconds
            try:
                with interrupts.let_through():
                    trace = rollout(
                        self.driver,
                        self.scenario,
                        Cases(cases.split, start, min(start + batch, cases.stop)),
                        others=self.others[0] if self.others else None,
                        replanning=self.spec.replanning,
                        keep_logs=with_episodes,
                        undisturbed=need_undisturbed(self.metrics),
                        progress=progress,
                        watch=self.foresee,
                    )
            except LogsTooLarge as error:
                batch, self.driver.seconds = error.fitting, seconds
                continue
            start += len(trace) // self.scenario.rules.vehicles
            yield trace
            del trace

    @property
    def label(self) -> str:
        """The planner's name with its settings, for display."""
        return planner_label(self.driver.name, {**self.spec.options, **self.spec.replanning.settings, **self.spec.team})

    @property
    def header(self) -> dict[str, Any]:
        """The properties of the run for a recording."""
        return {
            "planner": self.label,
            "scenario": self.scenario.name,
            "scenario_digest": self.scenario.digest,
            "options": self.spec.options,
            "units": units_of(self.metrics),
            "identity": self.id.digest[:8],
        }

    @functools.cached_property
    def id(self) -> RunId:
        """The identity of the run."""
        spec, scenario = self.spec, self.scenario
        # Only built-in planners without weights are known to return the same commands in batches of any size.
        planners = {spec.planner: self.planner} | ({str(spec.others): self.others[1]} if self.others else {})
        is_exact = all(
            not planner.facts and not planner.key and name in PLANNERS.built_in() for name, planner in planners.items()
        )
        return RunId(
            planner=self.planner,
            scenario=scenario.digest,
            cases=str(spec.cases),
            replanning=spec.replanning.settings,
            batch=None if is_exact else spec.batch,
            metrics={name: source_of(metric) for name, metric in self.metrics.items()},
            decision_limit=self.driver.decision_limit,
            code=code(),
            others=self.others[1] if self.others else None,
        )

    @property
    def is_divisible(self) -> bool:
        """True if parts smaller than a batch give the same results: commands are not the outputs of shipped networks.

        The last bits of such outputs depend on the number of cases in lock-step. A choice among actions by their values
        does not, unless two values are the same to seven digits.
        """
        if not self.driver.facts and not (self.others and self.others[0].facts):
            return True
        from crowdbench.planners.lookahead import ValuePlanner  # imports torch

        return isinstance(self.driver.planner, ValuePlanner)

    def _write(self, folder: Path, part: Cases, episodes: Episodes, recorder: RunRecorder, seconds: float) -> None:
        """Write the files of a run of some of the cases, apart from the recording."""
        if recorder.commands is not None:
            write_commands(recorder.commands, folder / COMMANDS)
        decision_ms = 1e3 * self.driver.seconds / int(episodes.steps.sum())
        torch = {"torch": importlib.metadata.version("torch")} if "torch" in sys.modules else {}
        stated = {
            "privileged": self.driver.privileged,
            "raw": self.driver.raw and self.scenario.rules.sensor.detector is not None,
            "overrides": self.spec.changes,
            "record": self.spec.record,
            "timing": {"decision_ms_per_step": decision_ms, "seconds": seconds},
            "versions": read_versions() | torch,
        }
        if self.isolation is not None:
            stated["isolation"] = dict(self.isolation)
        metrics = {name: digest for name, digest in self.id.metrics.items() if name not in self.failed}
        run = self.id.parts | {"cases": str(part), "metrics": metrics}
        scenario = {"name": self.scenario.name, **self.scenario.table}
        write_run(folder, episodes, run=run, scenario=scenario, recorded=recorder.number, stated=stated)


def read_versions() -> dict[str, str]:
    """Return facts that influence the last bits of a result: versions of packages, and the type of the machine."""
    packages = {name: importlib.metadata.version(name) for name in ("crowdbench", "numpy", "numba", "scipy")}
    machine = f"{platform.system()} {platform.machine()} {get_host_cpu_name()}"
    return {"python": platform.python_version(), **packages, "machine": machine}


def fit_batch(batch: int, scenario: Scenario) -> int:
    """Return the number of cases that run in lock-step: fewer than requested if their traces would take too much
    memory."""
    # Positions and velocities of every state, and the same amount for intermediate results of metrics.
    size_of_case = 8 * 2 * 4 * (scenario.rules.max_steps + 1) * scenario.max_agents * scenario.rules.vehicles
    return max(1, min(batch, int(MEMORY / size_of_case)))
