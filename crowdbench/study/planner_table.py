"""`[[tables]]`: planners on the same cases, each with one network or several, beside what others report of them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.evaluate.replanning import Replanning
from crowdbench.evaluate.results import Episodes, planner_label
from crowdbench.evaluate.summary import Estimate, wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.claims import assess, check_claim
from crowdbench.study.filled_planner_table import FilledPlannerRow, FilledPlannerTable, SecondReading
from crowdbench.study.intervals import mean_over_networks
from crowdbench.study.measures import PLANNER_MEASURES, SUCCESS, TIME, Measure
from crowdbench.study.planned import PlannedRun
from crowdbench.study.schema import PlannersSpec, RowSpec
from crowdbench.study.tables import PlannedTable
from crowdbench.toml_file import Location


@dataclass(frozen=True)
class PlannerRow:
    """A planner, and the runs of its row.

    Attributes:
        label: What the table calls the planner.
        weights: The weights of its networks, or its seeds; none for a planner without a choice of them.
        reported: What others report, by metric.
        runs: A run with each of the weights, or the one run without any.
        variant: Runs under the table's variant, with all the weights or the first; none where there is no variant.
        second_reading: The run with the first weights on the cases of the second reading, if the row has one.
    """

    label: str
    weights: list[str]
    reported: dict[str, float]
    runs: list[PlannedRun]
    variant: list[PlannedRun]
    second_reading: PlannedRun | None

    @property
    def networks(self) -> list[str]:
        """The network of each run: its weights, their digest where they are the planner's own, or "" without any."""
        return self.weights or [self.runs[0].driver.facts.get("weights", "")]

    @property
    def all_runs(self) -> list[PlannedRun]:
        """All runs that the row needs."""
        return [*self.runs, *self.variant, *([self.second_reading] if self.second_reading else [])]

    def first(self, cases: Cases) -> PlannerRow:
        """The first network alone, on other cases."""
        run, *variant = (run.on(cases) for run in (self.runs[0], *self.variant[:1]))
        return PlannerRow(self.label, self.weights[:1], self.reported, [run], variant, None)

    def episodes(self, out: Path) -> dict[str, Episodes]:
        """What `runs` left in the folder `out`, by their networks."""
        return {name: run.episodes(out) for name, run in zip(self.networks, self.runs, strict=True)}

    def fill(self, episodes: Mapping[str, Episodes], measures: Sequence[str], out: Path) -> FilledPlannerRow:
        """The row with its figures.

        Args:
            episodes: What `episodes` gives.
            measures: Metrics of `PLANNER_MEASURES` to show.
            out: The folder that holds the runs.
        """
        runs = list(episodes.values())
        variant = [run.episodes(out) for run in self.variant]
        return FilledPlannerRow(
            planner=self.label,
            privileged=self.runs[0].privileged,
            weights=self.weights,
            networks=sum(map(bool, self.networks)),
            reported=self.reported,
            measured={metric: _estimate(PLANNER_MEASURES[metric], runs) for metric in measures},
            success_rates=SUCCESS.of(runs).mean(axis=1).tolist(),
            variant_success_rate=_estimate(SUCCESS, variant) if variant else None,
            second_reading=self._second_reading(runs[0], out),
        )

    def _second_reading(self, episodes: Episodes, out: Path) -> SecondReading | None:
        if self.second_reading is None:
            return None
        of_both = ([episodes], [self.second_reading.episodes(out)])
        first, second = ({each.metric: _estimate(each, run) for each in (SUCCESS, TIME)} for run in of_both)
        return SecondReading(str(self.second_reading.cases), first, second)


@dataclass(frozen=True)
class PlannerTable(PlannedTable):
    """Planners on `cases`, which are those of the file, or those for a quick look."""

    spec: PlannersSpec
    cases: Cases
    rows: list[PlannerRow]

    @classmethod
    def of(cls, spec: PlannersSpec, location: Location) -> PlannerTable:
        """Plan the runs of a table.

        Args:
            spec: What the file says of the table.
            location: Where in the file.

        Raises:
            InputError: A planner, its weights or the scenario do not exist, two rows have the same label, or a claim is
                about no two rows that can be compared.
        """
        rows = [_row(row, spec, location.at("rows", i)) for i, row in enumerate(spec.rows)]
        networks = {row.label: row.networks for row in rows}
        if len(networks) < len(rows):
            raise location.at("rows").wrong(", ".join(row.label for row in rows), "rows of different labels")
        for i, claim in enumerate(spec.claims):
            check_claim(claim, networks, location.at("claims", i))
        return cls(spec, spec.cases, rows)

    @property
    def runs(self) -> list[PlannedRun]:
        """See `PlannedTable`."""
        return [run for row in self.rows for run in row.all_runs]

    def quick_look(self) -> PlannerTable:
        """The same table with the first network of each row alone, on the few cases for a quick look."""
        return PlannerTable(self.spec, self.spec.quick, [row.first(self.spec.quick) for row in self.rows])

    def fill(self, out: Path) -> FilledPlannerTable:
        """See `PlannedTable`."""
        episodes = {row.label: row.episodes(out) for row in self.rows}
        run, variant = self.rows[0].runs[0], self.spec.variant
        of_first = " (first network)" if variant and variant.networks == "first" else ""
        return FilledPlannerTable(
            title=self.spec.title,
            scenario=run.scenario.name,
            replanning=run.replanning.settings,
            cases=str(self.cases),
            variant=variant.title + of_first if variant else "",
            rows=[row.fill(episodes[row.label], self.spec.measures, out) for row in self.rows],
            claims=[assess(claim, episodes) for claim in self.spec.claims],
        )


def _row(row: RowSpec, spec: PlannersSpec, location: Location) -> PlannerRow:
    if "weights" in row.options:
        raise location.at("options").wrong(repr(row.options), "without weights: they have a key of their own")
    if row.seeds and row.weights:
        raise location.at("seeds").wrong(repr(row.seeds), "left out where there are weights, which have their own")
    each: list[dict[str, Any]] = [{"weights": name} for name in row.weights]
    each += [{"seed": seed} for seed in row.seeds] or ([] if each else [{}])
    names = row.weights or [f"seed {seed}" for seed in row.seeds]
    plan = functools.partial(_runs, row, spec)
    with location.named():
        runs = plan(each, spec.cases)
        variant: list[PlannedRun] = []
        if spec.variant:
            chosen = each if spec.variant.networks == "all" else each[:1]
            variant = plan(chosen, spec.cases, spec.variant.overrides)
        second = plan(each[:1], row.second_reading)[0] if row.second_reading else None
    if row.second_reading and set(row.second_reading.indices) & set(spec.cases.indices):
        wrong = str(row.second_reading)
        raise location.at("second_reading").wrong(wrong, f"cases that are not among {spec.cases}, those of the table")
    label = row.label or planner_label(runs[0].planner, row.options)
    return PlannerRow(label, names, row.reported.model_dump(exclude_none=True), runs, variant, second)


def _runs(
    row: RowSpec,
    spec: PlannersSpec,
    each: Sequence[Mapping[str, Any]],
    cases: Cases,
    overrides: Mapping[str, Any] | None = None,
) -> list[PlannedRun]:
    """A run with each of these options beside those of the row."""
    replanning = Replanning(spec.replan_every, spec.look_first)
    return [
        PlannedRun.of(
            row.planner, {**row.options, **one}, spec.scenario, cases, overrides=overrides, replanning=replanning
        )
        for one in each
    ]


def _estimate(measure: Measure, runs: Sequence[Episodes]) -> Estimate:
    """A measure over several networks; all but success is over the cases that are solved."""
    solved = SUCCESS.of(runs).astype(bool)
    if measure is not SUCCESS:
        return mean_over_networks(np.where(solved, measure.of(runs), np.nan))
    # Where all values are the same, the interval would have no width. The networks drive the same cases, and count as
    # one then: the interval is rather too wide than too narrow.
    if solved.all() or not solved.any() or len(solved) == 1:
        return wilson(solved[0])
    found = mean_over_networks(SUCCESS.of(runs))
    return dataclasses.replace(found, low=max(found.low, 0.0), high=min(found.high, 1.0))
