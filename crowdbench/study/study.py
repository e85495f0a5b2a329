"""A study: the runs that a TOML file lists, planners in scenarios, and the table of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from crowdbench import catalog
from crowdbench.metrics import MAIN
from crowdbench.runs.load import load_run
from crowdbench.runs.run import Run
from crowdbench.runs.spec import Replanning, RunSpec
from crowdbench.runs.table import PRIVILEGED, RunTable
from crowdbench.scenario.cases import Cases
from crowdbench.study.folder import run_directory
from crowdbench.study.schema import PlannerSpec, StudySpec, TableSpec
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid, markdown, printed_by
from crowdbench.utils.toml import Location, parse_table, read_toml

FILE = "study.toml"
"""The name of a file that has a folder of its own, whose name is that of the study."""


def load_runs(planners: Sequence[PlannerSpec], base: RunSpec) -> list[Run]:
    """Load the runs of planners in one scenario, which is loaded once.

    Args:
        planners: The planners with their options.
        base: The common part of all runs.

    Raises:
        InputError: A planner or the scenario does not exist.
    """
    scenario = catalog.load_scenario(base.scenario, base.overrides, data=base.data)
    specs = [dataclasses.replace(base, planner=each.planner, options=its) for each in planners for its in each.choices]
    return [load_run(spec, scenario=scenario) for spec in specs]


@dataclass(frozen=True)
class StudyTable:
    """Planners in scenarios, with the same cases for all.

    Attributes:
        title: The title.
        cases: The cases.
        by_scenario: The runs of each scenario, one for each planner.
    """

    title: str
    cases: Cases
    by_scenario: list[list[Run]]

    @classmethod
    def load(cls, spec: TableSpec, location: Location, data: Path | None = None) -> StudyTable:
        """Load the runs of a table.

        Args:
            spec: The table in the file.
            location: Where in the file.
            data: The folder with the recorded tracks that its scenarios need.

        Raises:
            InputError: A planner or a scenario does not exist, or two planners have the same name and options.
        """
        scenarios = catalog.simulated_scenarios() if spec.scenarios == "all" else spec.scenarios
        replanning = Replanning(spec.replan_every, spec.look_first)
        base = RunSpec("", "", spec.cases, {}, spec.overrides, replanning=replanning, record="none", data=data)
        with location.named():
            by_scenario = [load_runs(spec.planners, dataclasses.replace(base, scenario=name)) for name in scenarios]
        labels = [run.label for run in by_scenario[0]]
        if len(set(labels)) < len(labels):
            raise location.at("planners").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec.title, spec.cases, by_scenario)

    @property
    def runs(self) -> list[Run]:
        """All runs that it lists."""
        return [run for runs in self.by_scenario for run in runs]

    def grid(self, out: Path) -> Grid:
        """Return the main metrics of the runs in the folder `out`. Raises InputError where one is not there."""
        table = RunTable.read([run_directory(run, out) for run in self.runs])
        return dataclasses.replace(table.grid(MAIN), title=self.title)


@dataclass(frozen=True)
class Study:
    """The contents of a file.

    Attributes:
        name: The name of the file without its ending, or of its folder if it is called study.toml.
        description: The subject of the study, in Markdown; it stands at the top of the page.
        tables: Its tables, with the runs that they list.
        sources: The full references of its page, in Markdown.
    """

    name: str
    description: str
    tables: list[StudyTable]
    sources: list[str]

    @property
    def runs(self) -> list[Run]:
        """All runs that its tables list, some perhaps twice."""
        return [run for table in self.tables for run in table.runs]

    def page(self, grids: Sequence[Grid], command: str) -> str:
        """Return the study's page in Markdown: its tables, then the references.

        Args:
            grids: The `grid` of each table.
            command: The command that prints the page.
        """
        parts = [printed_by(command), *([self.description] if self.description else [])]
        for table, grid in zip(self.tables, grids, strict=True):
            parts += [f"## {table.title}", f"Cases {table.cases}.", markdown(grid.header, grid.rows)]
        privileged = [PRIVILEGED] if any(run.driver.privileged for run in self.runs) else []
        return "\n\n".join([*parts, *privileged, *self.sources])


def read_study(path: Path, data: Path | None = None) -> Study:
    """Read the study that a file describes.

    Args:
        path: The file.
        data: The folder with the recorded tracks that its scenarios need.

    Raises:
        InputError: It cannot be read, or something in it is wrong; the file and the key are named. That includes
            planners, weights and scenarios that do not exist, so that nobody learns of them hours later.
    """
    location = Location(path.name)
    spec = parse_table(StudySpec, read_toml(path, "study"), location)
    if not spec.tables:
        raise InputError(f"{path.name} has no table: a study needs [[tables]]")
    tables = [StudyTable.load(table, location.at("tables", i), data) for i, table in enumerate(spec.tables)]
    study = Study(study_name(path), spec.description, tables, spec.sources)
    check_data_used(study.runs, path, data)
    return study


def study_name(path: Path) -> str:
    """Return the name of the study in a file."""
    return path.absolute().parent.name if path.name == FILE else path.stem


def check_data_used(runs: Sequence[Run], path: Path, data: Path | None) -> None:
    """Raise InputError where a folder of recorded tracks is given, but no run of a study needs it."""
    if data is not None and not any(run.scenario.tracks for run in runs):
        raise InputError(f"--data does not go with {path.name}, none of whose scenarios has a table [tracks]")
