"""`[[networks]]`: planners on the same cases, each with one network or several, beside published results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from crowdbench import Cases, Episodes
from crowdbench.metrics import Estimate, info_of, mean_over_networks, range_over_networks, wilson
from crowdbench.results import PRIVILEGED, planner_label
from crowdbench.runs import LOOK_FIRST, Replanning, Run, RunSpec, load_run
from crowdbench.utils import (
    Grid,
    Location,
    Name,
    Names,
    Text,
    TomlTable,
    Values,
    choice,
    integer,
    markdown,
    number,
    table,
)
from studies.folder import read_episodes
from studies.pages import NOTES, SUCCESS, SUCCESS_RATE, values_of
from studies.schema import CasesText

SHOWN = (SUCCESS_RATE, "navigation_time", "max_velocity_change", "jerk")
"""Default metrics of a table."""

PLANNER_MEASURES = {name: info_of(name) for name in (*SHOWN, "stopped_time", "success_path_length")}
"""Metrics that a table may show."""

SECOND_READING = (SUCCESS_RATE, "navigation_time")
"""The metrics of a second reading."""

ALONE = "The networks of a row differ only in the seed of their training."


def _known(measures: list[str]) -> list[str]:
    if not set(measures) <= set(PLANNER_MEASURES):
        raise ValueError
    return measures


class ReportedSpec(TomlTable):
    """`reported`: published results, by metric, in the units of the metrics."""

    success_rate: float | None = number(None, least=0.0, below=1000.0)
    navigation_time: float | None = number(None, least=0.0, below=1000.0)
    max_velocity_change: float | None = number(None, least=0.0, below=1000.0)
    jerk: float | None = number(None, least=0.0, below=1000.0)


class RowSpec(TomlTable):
    """`[[networks.rows]]`: a planner, with each of several networks or without any, and its label.

    The first network, which is the shipped one, is run on the cases of `second_reading` too, if there are any: held-out
    cases, while the cases of the table have been evaluated often.
    """

    label: Text = ""
    planner: Name
    weights: Names = Field(default=[])
    options: Values = Field(default={})
    reported: ReportedSpec = table("reported")
    second_reading: CasesText | None = None


class VariantSpec(TomlTable):
    """`variant`: the same runs under another rule of the scenario, with all networks of a row or its first."""

    title: Name
    overrides: Values = Field(default={})
    networks: str = choice(("all", "first"), default="all")


class NetworksSpec(TomlTable):
    """`[[networks]]`: planners on the cases of one scenario."""

    title: Name
    scenario: Name
    replan_every: int = integer(1, least=1, most=1000)
    look_first: int = integer(LOOK_FIRST, least=1, most=1000)
    cases: CasesText = Cases.parse("test:500")
    measures: Annotated[Names, AfterValidator(_known)] = Field(
        default=[*SHOWN],
        description=f"a list of some of {', '.join(PLANNER_MEASURES)}, none of them twice",
    )
    variant: VariantSpec | None = Field(default=None, description="a table with a title and overrides")
    rows: list[RowSpec] = Field(min_length=1, description="one table or more")


@dataclass(frozen=True)
class PlannerRow:
    """A planner, and the runs of its row.

    Attributes:
        label: Name of the planner in the table.
        weights: The weights of its networks; none for a planner without a choice of them.
        reported: Published results, by metric.
        runs: A run with each of the weights, or the one run without any.
        variant: Runs under the table's variant, with all the weights or the first; none without a variant.
        second_reading: The run with the first weights on the cases of the second reading, if the row has one.
    """

    label: str
    weights: list[str]
    reported: dict[str, float]
    runs: list[Run]
    variant: list[Run]
    second_reading: Run | None

    @classmethod
    def of(cls, row: RowSpec, table: NetworksSpec, location: Location) -> PlannerRow:
        """Plan the runs of a row; raises InputError as `NetworksTable.of` does."""
        if "weights" in row.options:
            raise location.at("options").wrong(repr(row.options), "without weights: they have a key of their own")
        choices = [{"weights": weights} for weights in row.weights] or [{}]
        replanning = Replanning(table.replan_every, table.look_first)
        base = RunSpec(row.planner, table.scenario, table.cases, replanning=replanning, record="none")

        def load(choices: Sequence[Mapping[str, Any]], **changes: Any) -> list[Run]:
            return [load_run(replace(base, options={**row.options, **choice}, **changes)) for choice in choices]

        variant: list[Run] = []
        with location.named():
            runs = load(choices)
            if table.variant:
                of_variant = choices if table.variant.networks == "all" else choices[:1]
                variant = load(of_variant, overrides=table.variant.overrides)
            second = load(choices[:1], cases=row.second_reading)[0] if row.second_reading else None
        if row.second_reading and set(row.second_reading.indices) & set(table.cases.indices):
            right = f"cases that are not among {table.cases}, the cases of the table"
            raise location.at("second_reading").wrong(str(row.second_reading), right)
        label = row.label or planner_label(runs[0].driver.name, row.options)
        return cls(label, row.weights, row.reported.model_dump(exclude_none=True), runs, variant, second)

    @property
    def networks(self) -> list[str]:
        """The network of each run: its weights, their digest if the planner has fixed ones, or "" without any."""
        return self.weights or [self.runs[0].driver.facts.get("weights", "")]

    @property
    def all_runs(self) -> list[Run]:
        """All runs that the row needs."""
        return [*self.runs, *self.variant, *([self.second_reading] if self.second_reading else [])]

    def episodes(self, out: Path) -> dict[str, Episodes]:
        """Return the episodes of `runs` in the folder `out`, by network."""
        return {name: read_episodes(run, out) for name, run in zip(self.networks, self.runs, strict=True)}

    def fill(self, episodes: Mapping[str, Episodes], measures: Sequence[str], out: Path) -> FilledPlannerRow:
        """Return the row with its figures.

        Args:
            episodes: The return value of `episodes`.
            measures: Metrics of `PLANNER_MEASURES` to show.
            out: The folder that holds the runs.
        """
        runs, variant = list(episodes.values()), [read_episodes(run, out) for run in self.variant]
        second = None
        if self.second_reading is not None:
            both = runs[0], read_episodes(self.second_reading, out)
            figures = [{name: estimate(name, [run]) for name in SECOND_READING} for run in both]
            second = SecondReading(str(self.second_reading.spec.cases), *figures)
        return FilledPlannerRow(
            planner=self.label,
            privileged=self.runs[0].driver.privileged,
            weights=self.weights,
            networks=sum(map(bool, self.networks)),
            reported=self.reported,
            measured={metric: estimate(metric, runs) for metric in measures},
            success_rates=values_of(SUCCESS_RATE, runs).mean(axis=1).tolist(),
            variant_success_rate=estimate(SUCCESS_RATE, variant) if variant else None,
            second_reading=second,
        )


@dataclass(frozen=True)
class NetworksTable:
    """Planners on the same cases, and the runs of each."""

    spec: NetworksSpec
    rows: list[PlannerRow]

    @classmethod
    def of(cls, spec: NetworksSpec, location: Location) -> NetworksTable:
        """Plan the runs of a table.

        Args:
            spec: The table of the file.
            location: Its location in the file, for errors.

        Raises:
            InputError: A planner, its weights or the scenario do not exist, two rows have the same label, or a claim is
                about no two rows that can be compared.
        """
        rows = [PlannerRow.of(row, spec, location.at("rows", i)) for i, row in enumerate(spec.rows)]
        networks = {row.label: row.networks for row in rows}
        if len(networks) < len(rows):
            raise location.at("rows").wrong(", ".join(row.label for row in rows), "rows of different labels")
        return cls(spec, rows)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs, possibly with duplicates."""
        return [run for row in self.rows for run in row.all_runs]

    def fill(self, out: Path) -> FilledNetworksTable:
        """Return the table with the figures of the runs in the folder `out`; raises InputError if one is missing."""
        episodes = {row.label: row.episodes(out) for row in self.rows}
        run, variant = self.rows[0].runs[0], self.spec.variant
        of_first = " (first network)" if variant and variant.networks == "first" else ""
        return FilledNetworksTable(
            title=self.spec.title,
            scenario=run.scenario.name,
            replanning=run.spec.replanning.settings,
            cases=str(self.spec.cases),
            variant=variant.title + of_first if variant else "",
            rows=[row.fill(episodes[row.label], self.spec.measures, out) for row in self.rows],
        )


@dataclass(frozen=True)
class SecondReading:
    """Success rate and navigation time of only the first network of a row, on the table's cases and on others.

    Attributes:
        cases: The other cases.
        first: Its results on the table's cases, by metric.
        second: Its results on the other cases.
    """

    cases: str
    first: dict[str, Estimate]
    second: dict[str, Estimate]


@dataclass(frozen=True)
class FilledPlannerRow:
    """A row with its figures.

    Attributes:
        planner: Name of the planner in the table.
        privileged: True if it uses information that no vehicle can measure.
        weights: The weights of its networks, if it was given any.
        networks: Number of its networks; 0 for a planner without any.
        reported: Published results, by metric.
        measured: Results of the networks, by metric.
        success_rates: The success rate of each network.
        variant_success_rate: The success rate under the table's variant.
        second_reading: Results of the first network on other cases, if the row has them.
    """

    planner: str
    privileged: bool
    weights: list[str]
    networks: int
    reported: dict[str, float]
    measured: dict[str, Estimate]
    success_rates: list[float]
    variant_success_rate: Estimate | None
    second_reading: SecondReading | None

    @property
    def name(self) -> str:
        """The planner, with an asterisk if it is privileged."""
        return f"{self.planner} *" if self.privileged else self.planner


@dataclass(frozen=True)
class FilledNetworksTable:
    """A table of planners with its figures. `--format json` prints its fields.

    The metrics of `with_maximum` have a column with the maximum over networks and cases, beside their mean.
    """

    with_maximum: ClassVar[tuple[str, ...]] = ()
    title: str
    scenario: str
    replanning: dict[str, int]
    cases: str
    variant: str
    rows: list[FilledPlannerRow]

    def markdown(self) -> str:
        """Return the table in GitHub's Markdown, under its heading."""
        (planners,) = self.grids()
        every = "".join(f", {key}={value}" for key, value in self.replanning.items())
        on = f"On {self.scenario}{every}, cases {self.cases}."
        parts = [f"## {self.title}", on, markdown(planners.header, planners.rows)]
        if each := [_each_network(row) for row in self.rows if len(row.weights) > 1]:
            parts += ["Success of each network:", "\n".join(each)]
        again = [_both_readings(row, row.second_reading, self.cases) for row in self.rows if row.second_reading]
        if again:
            parts += ["Second reading, of the first network on other cases:", "\n".join(again)]
        return "\n\n".join(parts)

    def grids(self) -> list[Grid]:
        """Return its only grid, with a row for each planner."""
        columns = [
            ["planner", *(row.name for row in self.rows)],
            ["networks", *(str(row.networks) if row.networks else "" for row in self.rows)],
        ]
        for metric in self.rows[0].measured:
            info = PLANNER_MEASURES[metric]
            if any(metric in row.reported for row in self.rows):
                # With as many digits as in the publication.
                numbers = (row.reported.get(metric) for row in self.rows)
                reported = ["" if number is None else f"{info.factor * number:.6g}" for number in numbers]
                columns.append([f"reported {info.heading}", *reported])
            columns.append([info.heading, *(info.estimate(row.measured[metric]) for row in self.rows)])
            if metric in self.with_maximum:
                largest = (info.number(row.measured[metric].max) for row in self.rows)
                columns.append([f"{info.title} in any case, {info.unit}", *largest])
        if self.variant:
            rates = [row.variant_success_rate for row in self.rows]
            columns.append([f"{SUCCESS.heading}, {self.variant}", *(SUCCESS.estimate(rate) for rate in rates if rate)])
        header, *rows = zip(*columns, strict=True)
        return [Grid(self.title, header, rows, self.rows)]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page, each once."""
        notes = {
            NOTES["networks"]: True,
            NOTES["solved"]: True,
            ALONE: any(len(row.weights) > 1 for row in self.rows),
            PRIVILEGED: any(row.privileged for row in self.rows),
        }
        return [note for note, applies in notes.items() if applies]


def _each_network(row: FilledPlannerRow) -> str:
    """Return a line with the success of each network."""
    each = zip(row.weights, row.success_rates, strict=True)
    return f"- {row.name}: " + ", ".join(f"{weights} {SUCCESS.amount(rate)}" for weights, rate in each)


def _both_readings(row: FilledPlannerRow, reading: SecondReading, cases: str) -> str:
    """Return a line with the second reading beside the first one on `cases`."""
    second, first = (
        " in ".join(PLANNER_MEASURES[name].estimate(found[name], with_unit=True) for name in SECOND_READING)
        for found in (reading.second, reading.first)
    )
    network = f" with {row.weights[0]}" if row.weights else ""
    return f"- {row.name}{network}: {second} on {reading.cases}; {first} on {cases}"


def estimate(metric: str, runs: Sequence[Episodes]) -> Estimate:
    """Return a metric over several networks; all but rates are over the cases that each network solves."""
    values = values_of(metric, runs)
    if metric not in runs[0].rates:
        return mean_over_networks(np.where(values_of(SUCCESS_RATE, runs).astype(bool), values, np.nan))
    return wilson(values[0].astype(bool)) if len(values) == 1 else range_over_networks(values)
