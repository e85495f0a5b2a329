"""The runs that a study needs, and the making of those that are not there yet."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.evaluate import run as runs
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.kept import read_run
from crowdbench.evaluate.metrics import METRICS
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.results import EPISODES, RESULT, Episodes, planner_label
from crowdbench.evaluate.seal import MANIFEST, code
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario


@dataclass(frozen=True)
class PlannedRun:
    """One run that a study needs: its planner and its scenario are loaded, its directory may not exist yet.

    Attributes:
        driver: The planner.
        scenario: The scenario, overrides included.
        cases: The cases to run.
        replanning: When the planner observes.
        about: What the result says of options, overrides and the planner's files.
        asked: How the study calls the planner and the scenario.
    """

    driver: Driver
    scenario: Scenario
    cases: Cases
    replanning: Replanning
    about: Mapping[str, Any]
    asked: Mapping[str, Any]

    @classmethod
    def of(
        cls,
        planner: str,
        options: Mapping[str, Any],
        scenario: str,
        cases: Cases,
        *,
        overrides: Mapping[str, Any] | None = None,
        replanning: Replanning = EVERY_STEP,
    ) -> PlannedRun:
        """Load the planner and the scenario of a run.

        Args:
            planner: As `crowdbench run --planner` takes it.
            options: The planner's options by name.
            scenario: As `--scenario` takes it.
            cases: The cases to run.
            overrides: Other values for keys of the scenario, by dotted key.
            replanning: When the planner observes.

        Raises:
            InputError: The planner or the scenario does not exist, or does not take these options or overrides.
        """
        name, made = catalog.load_planner(planner, options)
        files = catalog.planner_files(planner, options)
        about = {"options": options, "planner_files": files, "overrides": overrides or {}}
        asked = {"planner": planner, "scenario": scenario}
        return cls(Driver(made, name), catalog.load_scenario(scenario, overrides), cases, replanning, about, asked)

    @property
    def planner(self) -> str:
        """The planner's name."""
        return self.driver.name

    @property
    def privileged(self) -> bool:
        """Whether the planner uses what no vehicle could know."""
        return self.driver.privileged

    @property
    def title(self) -> str:
        """What it is, for people."""
        changes = "".join(f", {key}={value}" for key, value in self.about["overrides"].items())
        planner = planner_label(self.planner, self.about["options"], self.replanning.settings)
        return f"{planner} on {self.scenario.name}{changes}, cases {self.cases}"

    @property
    def directory(self) -> str:
        """The name of its directory: a part for people, and a digest of all that its figures depend on.

        Of what a plug-in's file imports, the files in its folder count.
        """
        text = json.dumps(
            {
                "planner": self.planner,
                "planner_files": self.about["planner_files"],
                "planner_facts": self.driver.facts,
                "options": self.about["options"],
                "scenario": self.scenario.digest,
                "cases": str(self.cases),
                "replanning": self.replanning.settings,
                "crowdbench": code(),
                "versions": {name: importlib.metadata.version(name) for name in ("numba", "numpy", "torch")},
            },
            sort_keys=True,
        )
        changes = {**self.about["options"], **self.about["overrides"], **self.replanning.settings}
        name = runs.directory_name(self.planner, self.scenario.name, self.cases, changes)
        return f"{name[:180]}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"

    def is_in(self, out: Path) -> bool:
        """Whether it has been made, to the last case, and can be checked.

        Raises InputError where its directory holds something else, or other files than it wrote.
        """
        directory = out / self.directory
        if not (directory / RESULT).exists() and not (directory / MANIFEST).exists():
            return False
        kept = read_run(directory)
        return kept.manifest is not None and kept.result["cases"] == str(self.cases)

    def make(self, out: Path, progress: Callable[[float], None]) -> None:
        """Make the run. After an interrupt its finished parts are kept, and it goes on with them next time.

        Args:
            out: The folder in which it gets its directory.
            progress: Called as by `crowdbench.evaluate.run.run`.

        Raises:
            InputError: As `crowdbench.evaluate.run.run` does.
            KeyboardInterrupt: Somebody interrupted it.
        """
        runs.run(
            self.driver,
            self.scenario,
            self.cases,
            out / self.directory,
            metrics=METRICS,
            about=self.about,
            asked=self.asked,
            replanning=self.replanning,
            record="none",
            overwrite=True,
            progress=progress,
        )

    def episodes(self, out: Path) -> Episodes:
        """The episodes that it left in `out`. Raises InputError where it has not been made."""
        return Episodes.read(out / self.directory / EPISODES)


def missing(wanted: Iterable[PlannedRun], out: Path) -> list[PlannedRun]:
    """The runs that still have to be made.

    Args:
        wanted: The runs that are needed, some perhaps twice.
        out: The folder of runs.

    Returns:
        The runs that are not in the folder, each once.
    """
    each = {run.directory: run for run in wanted}
    return [run for run in each.values() if not run.is_in(out)]
