"""The runs that a study needs, and the making of those that are not there yet."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crowdbench.evaluate import run as runs
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.kept import read_run
from crowdbench.evaluate.parts import Parts
from crowdbench.evaluate.replanning import EVERY_STEP, Replanning
from crowdbench.evaluate.results import EPISODES, RESULT, Episodes, planner_label
from crowdbench.evaluate.seal import MANIFEST, code
from crowdbench.evaluate.shard import WHOLE, Shard
from crowdbench.evaluate.wanted import Wanted
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.spec import RunSpec


@dataclass(frozen=True)
class PlannedRun:
    """One run that a study needs: its planner and its scenario are loaded, its directory may not exist yet.

    Attributes:
        spec: The run as the study's file writes it.
        wanted: The same, loaded.
    """

    spec: RunSpec
    wanted: Wanted

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
        data: Path | None = None,
    ) -> PlannedRun:
        """Load the planner and the scenario of a run.

        Args:
            planner: As `crowdbench run --planner` takes it.
            options: The planner's options by name.
            scenario: As `--scenario` takes it.
            cases: The cases to run.
            overrides: Other values for keys of the scenario, by dotted key.
            replanning: When the planner observes.
            data: The folder with the recorded tracks that the scenario needs.

        Raises:
            InputError: The planner or the scenario does not exist, or does not take these options or overrides.
        """
        spec = RunSpec(
            planner, scenario, cases, options, overrides or {}, replanning=replanning, record="none", data=data
        )
        return cls(spec, spec.load())

    def on(self, cases: Cases) -> PlannedRun:
        """The same on other cases."""
        return PlannedRun(replace(self.spec, cases=cases), replace(self.wanted, cases=cases))

    @property
    def driver(self) -> Driver:
        """What asks the planner."""
        return self.wanted.driver

    @property
    def scenario(self) -> Scenario:
        """The scenario, overrides included."""
        return self.wanted.scenario

    @property
    def cases(self) -> Cases:
        """The cases to run."""
        return self.spec.cases

    @property
    def replanning(self) -> Replanning:
        """When the planner observes."""
        return self.spec.replanning

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
        changes = "".join(f", {key}={value}" for key, value in self.spec.overrides.items())
        planner = planner_label(self.planner, self.spec.options, self.replanning.settings)
        return f"{planner} on {self.scenario.name}{changes}, cases {self.cases}"

    @property
    def directory(self) -> str:
        """The name of its directory: a part for people, and a digest of all that its figures depend on.

        Of what a plug-in's file imports, the files in its folder count.
        """
        text = json.dumps(
            {
                "planner": self.planner,
                "planner_files": self.wanted.about["planner_files"],
                "planner_facts": self.driver.facts,
                "options": self.spec.options,
                "scenario": self.scenario.digest,
                "cases": str(self.cases),
                "replanning": self.replanning.settings,
                "crowdbench": code(),
                "versions": {name: importlib.metadata.version(name) for name in ("numba", "numpy", "torch")},
            },
            sort_keys=True,
        )
        changes = {**self.spec.options, **self.spec.overrides, **self.replanning.settings}
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

    def parts(self, out: Path) -> Parts:
        """The parts that it is made of, in the folder `out`."""
        return runs.parts_of(self.wanted, out / self.directory)

    def make(self, out: Path, progress: Callable[[float], None] | None = None, *, wait: bool = True) -> bool:
        """Make the run. After an interrupt its finished parts are kept, and it goes on with them next time.

        Args:
            out: The folder in which it gets its directory.
            progress: Called as by `crowdbench.evaluate.run.run`.
            wait: Whether to wait for other processes that are making parts of it.

        Returns:
            Whether it is there.

        Raises:
            InputError: As `crowdbench.evaluate.run.run` does.
            KeyboardInterrupt: Somebody interrupted it.
        """
        if self.is_in(out):  # another process may have made it meanwhile
            return True
        finished = runs.make(self.wanted, out / self.directory, overwrite=True, wait=wait, progress=progress)
        return finished.result is not None

    def episodes(self, out: Path) -> Episodes:
        """The episodes that it left in `out`. Raises InputError where it has not been made."""
        return Episodes.read(out / self.directory / EPISODES)


def missing(wanted: Iterable[PlannedRun], out: Path, shard: Shard = WHOLE) -> list[PlannedRun]:
    """The runs that still have to be made.

    Args:
        wanted: The runs that are needed, some perhaps twice.
        out: The folder of runs.
        shard: Which share of the runs is looked at. It is the same whichever of them are there.

    Returns:
        The runs that are not in the folder, each once.
    """
    each = list({run.directory: run for run in wanted}.values())
    return [run for run in shard.own(each) if not run.is_in(out)]
