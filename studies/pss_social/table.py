"""Tables of planners in one scene with several numbers of pedestrians, beside reported results.

Success means that the vehicle reaches its goal. A success without contact also has no negative gap; in the paper's
scene, contacts do not end an episode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from crowdbench import Cases, Episodes
from crowdbench.metrics import Estimate, range_over_networks, wilson
from crowdbench.runs import Run, RunSpec, load_run
from crowdbench.utils import Grid, Location, Name, Names, Text, TomlTable, Values, markdown
from studies.folder import read_episodes
from studies.pages import NOTES, SUCCESS, SUCCESS_RATE, values_of
from studies.schema import CasesText, StudyHead

MEASURES = ("success", "without contact")

Rates = Annotated[list[Annotated[float, Field(ge=0, le=1)]], Field(description="a list of shares from 0 to 1")]


class RowSpec(TomlTable):
    """A planner, with its networks and the reported rates by number of pedestrians; without a planner, only those."""

    label: Name
    planner: Text = ""
    weights: Names = Field(default=[])
    options: Values = Field(default={})
    success: Rates = Field(default=[])
    without_contact: Rates = Field(default=[])


class SceneSpec(TomlTable):
    """`[[scenes]]`: planners in one scenario, with each number of pedestrians or as it is."""

    title: Name
    scenario: Name
    cases: CasesText = Cases.parse("val:50")
    overrides: Values = Field(default={})
    pedestrians: list[int] = Field(default=[], description="a list of whole numbers")
    rows: list[RowSpec] = Field(min_length=1, description="one table or more")


class HostedStudy(StudyHead):
    """The file of the study."""

    scenes: list[SceneSpec] = Field(min_length=1, description="one table or more")


@dataclass(frozen=True)
class SceneRow:
    """A planner among one number of pedestrians.

    Attributes:
        label: Name of the planner.
        pedestrians: Their number; None for that of the scenario.
        reported: Reported rates of both measures, None where nothing is reported.
        runs: A run of each network, or one run without networks; none for a row that is only reported.
    """

    label: str
    pedestrians: int | None
    reported: tuple[float | None, float | None]
    runs: list[Run]

    def fill(self, out: Path) -> FilledSceneRow:
        """Return the row with its figures, from the runs in the folder `out`."""
        episodes = [read_episodes(run, out) for run in self.runs]
        measured = _rates(episodes) if episodes else None
        return FilledSceneRow(self.label, self.pedestrians, self.reported, measured, len(episodes))


def _rates(episodes: list[Episodes]) -> tuple[Estimate, Estimate]:
    """Return both measures over the networks."""
    success = values_of(SUCCESS_RATE, episodes).astype(bool)
    is_free = success & ~(values_of("minimum_gap", episodes) < 0.0)
    of_success, of_free = (
        wilson(values[0]) if len(values) == 1 else range_over_networks(values.astype(float))
        for values in (success, is_free)
    )
    return of_success, of_free


@dataclass(frozen=True)
class FilledSceneRow:
    """A row with its figures; `measured` is None for a row that is only reported."""

    label: str
    pedestrians: int | None
    reported: tuple[float | None, float | None]
    measured: tuple[Estimate, Estimate] | None
    networks: int

    @property
    def comparisons(self) -> list[bool]:
        """True for each reported rate within the measured interval; empty if nothing can be compared."""
        pairs = zip(self.reported, self.measured or (), strict=False)
        return [each.low <= rate <= each.high for rate, each in pairs if rate is not None]

    def cells(self) -> list[str]:
        """Return the cells of the row: planner, pedestrians, and both measures as reported and as measured."""
        cells = [self.label, "" if self.pedestrians is None else str(self.pedestrians)]
        for rate, each in zip(self.reported, self.measured or (None, None), strict=True):
            cells.append("" if rate is None else f"{100.0 * rate:.1f}")
            cells.append("" if each is None else SUCCESS.estimate(each))
        return cells


@dataclass(frozen=True)
class SceneTable:
    """Planners in one scene, and the runs of each."""

    spec: SceneSpec
    rows: list[SceneRow]

    @classmethod
    def of(cls, spec: SceneSpec, networks: Path, location: Location) -> SceneTable:
        """Plan the runs of a table.

        Args:
            spec: The table of the file.
            networks: The folder with the weights.
            location: Its location in the file, for errors.

        Raises:
            InputError: A planner, its weights or the scenario do not exist.
        """
        rows = []
        for i, row in enumerate(spec.rows):
            with location.at("rows", i).named():
                rows += [_plan_row(row, spec, number, networks) for number in range(max(1, len(spec.pedestrians)))]
        return cls(spec, rows)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for row in self.rows for run in row.runs]

    def fill(self, out: Path) -> FilledSceneTable:
        """Return the table with the figures of the runs in the folder `out`; raises InputError if one is missing."""
        return FilledSceneTable(self.spec, [row.fill(out) for row in self.rows])


def _plan_row(row: RowSpec, spec: SceneSpec, number: int, networks: Path) -> SceneRow:
    """Plan the runs of a row in the scene with one number of pedestrians, given by its index."""
    pedestrians = spec.pedestrians[number] if spec.pedestrians else None
    changes: dict[str, Any] = {} if pedestrians is None else {"pedestrians.number": pedestrians}
    base = RunSpec(row.planner, spec.scenario, spec.cases, overrides={**spec.overrides, **changes}, record="none")
    choices: list[dict[str, Any]] = [{"weights": str(networks / f"{name}.safetensors")} for name in row.weights]
    specs = [replace(base, options={**row.options, **choice}) for choice in choices or [{}]] if row.planner else []
    success, without_contact = (
        rates[number] if number < len(rates) else None for rates in (row.success, row.without_contact)
    )
    return SceneRow(row.label, pedestrians, (success, without_contact), [load_run(each) for each in specs])


@dataclass(frozen=True)
class FilledSceneTable:
    """A table with its figures. `--format json` prints its fields."""

    spec: SceneSpec
    rows: list[FilledSceneRow]

    def markdown(self) -> str:
        """Return the table in GitHub's Markdown, under its heading."""
        (grid,) = self.grids()
        changes = "".join(f", {key}={value}" for key, value in self.spec.overrides.items())
        networks = max(row.networks for row in self.rows)
        each = f", each of {networks} networks of a row" if networks > 1 else ""
        on = f"On {self.spec.scenario}{changes}, cases {self.spec.cases}{each}."
        parts = [f"## {self.spec.title}", on, markdown(grid.header, grid.rows)]
        compared = np.array([is_inside for row in self.rows for is_inside in row.comparisons], bool)
        if len(compared):
            parts.append(f"{compared.sum()} of {len(compared)} reported rates are within the measured intervals.")
        return "\n\n".join(parts)

    def grids(self) -> list[Grid]:
        """Return its only grid, without columns that are empty."""
        header = ["planner", "pedestrians"]
        for measure in MEASURES:
            header += [f"reported {measure}, %", f"{measure}, %"]
        columns = zip(header, *(row.cells() for row in self.rows), strict=True)
        titles, *rows = zip(*(column for column in columns if any(column[1:])), strict=True)
        return [Grid(self.spec.title, titles, rows, self.rows)]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page."""
        return [NOTES["networks"]]
