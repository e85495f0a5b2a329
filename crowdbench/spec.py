"""A run as a user writes it: names, files and values, which another process can load."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from crowdbench import catalog, plugins
from crowdbench.errors import plugin_errors
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.wanted import Wanted
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH, DECISION_LIMIT, RECORD


@dataclass(frozen=True)
class RunSpec:
    """A run that is not loaded yet. Its fields are what the options of `crowdbench run` say.

    Attributes:
        planner: The name or the file of the planner.
        scenario: The name or the file of the scenario.
        cases: The cases.
        options: The planner's options by name.
        overrides: Other values for keys of the scenario, by dotted key.
        pedestrians: The name or the file of the policy that moves all pedestrians.
        metrics: Files with metrics of the user's own.
        replanning: When the planner observes.
        record: What is recorded, one of `settings.RECORD`.
        batch: Cases that run in lock-step.
        isolated: Whether the planner runs in a process of its own.
        decision_limit: Seconds that the planner may take for a decision.
        data: The folder with recorded tracks.
    """

    planner: str
    scenario: str
    cases: Cases
    options: Mapping[str, Any] = field(default_factory=dict)
    overrides: Mapping[str, Any] = field(default_factory=dict)
    pedestrians: str | None = None
    metrics: tuple[str, ...] = ()
    replanning: Replanning = EVERY_STEP
    record: str = RECORD[0]
    batch: int = BATCH
    isolated: bool = False
    decision_limit: float = DECISION_LIMIT
    data: Path | None = None

    @property
    def changes(self) -> dict[str, Any]:
        """What is changed in the scenario, as results say it."""
        return {**self.overrides} | ({"pedestrians": self.pedestrians} if self.pedestrians else {})

    @contextlib.contextmanager
    def loaded(self) -> Iterator[Wanted]:
        """Load the run, and end the planner's own process afterwards if it has one.

        Raises:
            InputError: Something that it names does not exist, or does not take these options or overrides.
        """
        if not self.isolated:
            yield self.load()
            return
        from crowdbench.isolation.planner import IsolatedPlanner, Limits

        limits, scenario = Limits(decision=self.decision_limit), self._scenario()
        scene = scenario.tracks.scene if scenario.tracks else None
        with contextlib.closing(IsolatedPlanner(self.planner, self.options, limits, scene=scene)) as apart:
            about = {"planner_files": self._files, "isolation": apart.usage}
            yield self._wanted(Driver(apart, apart.name, self.decision_limit), scenario, about)

    def load(self, made: Planner | None = None) -> Wanted:
        """Load the run with its planner in this process.

        Args:
            made: The planner where it was made in Python, and the spec only says what it is called.

        Raises:
            InputError: As `loaded` raises it.
        """
        scenario = self._scenario()
        name, planner = (self.planner, made) if made else catalog.load_planner(self.planner, self.options)
        if scenario.tracks:
            with plugin_errors(f"planner {name} raised", " in unseen()"):
                planner = planner.unseen(scenario.tracks.scene)
        files = {} if made else self._files
        return self._wanted(Driver(planner, name, self.decision_limit), scenario, {"planner_files": files})

    def _scenario(self) -> Scenario:
        return catalog.load_scenario(self.scenario, self.overrides, self.pedestrians, self.data)

    @property
    def _files(self) -> dict[str, dict[str, str]]:
        """The files of the planner, see `catalog.planner_files`."""
        return catalog.planner_files(self.planner, self.options)

    def _wanted(self, driver: Driver, scenario: Scenario, more: Mapping[str, Any]) -> Wanted:
        return Wanted(
            driver,
            scenario,
            self.cases,
            catalog.load_metrics(self.metrics),
            about={"options": self.options, **more, "overrides": self.changes},
            asked={
                "planner": self.planner,
                "scenario": self.scenario,
                "pedestrians": self.pedestrians,
                "own_metrics": {spec: plugins.source(spec) for spec in self.metrics},
            },
            replanning=self.replanning,
            record=self.record,
            batch=self.batch,
        )
