"""`[[seeds]]`: planners whose networks were trained several times, from different seeds."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.evaluate.results import Episodes, planner_label
from crowdbench.evaluate.summary import Estimate, bootstrap, wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.bootstrap import two_level
from crowdbench.study.networks import Variant, of_all, own_options, runs_with
from crowdbench.study.planned import Run
from crowdbench.study.tables import PRIVILEGED, SUCCESS, TIME, Filled, Table, grid, marked
from crowdbench.toml_section import Section

NOTES = (
    "Seeds are networks trained alike from different seeds. Success and time are means over them, with 95 % intervals "
    "of a bootstrap over seeds and cases; time is over the cases that are solved. An interval without width, where "
    "all solve everything, is no certainty."
)


@dataclass(frozen=True)
class Shipped:
    """What the shipped network alone does."""

    success_rate: Estimate
    navigation_time: Estimate

    @classmethod
    def of(cls, episodes: Episodes) -> Shipped:
        """Measured on one run."""
        times = episodes.columns[TIME.metric]
        return cls(wilson(episodes.columns[SUCCESS.metric]), bootstrap(times, np.ones(len(times))))

    def __str__(self) -> str:
        return f"{SUCCESS.number(self.success_rate.mean)}, {TIME.number(self.navigation_time.mean)}"


@dataclass(frozen=True)
class FilledRow:
    """A row with its numbers; `success_rates` has one for each of `weights`, the shipped ones first."""

    planner: str
    privileged: bool
    scenario: str
    replan_every: int
    weights: list[str]
    success_rates: list[float]
    success_rate: Estimate
    navigation_time: Estimate
    variant_success_rate: Estimate | None
    shipped_validation: Shipped
    shipped_test: Shipped
    reported: str

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)

    def cells(self) -> list[str]:
        """As `FilledSeeds` shows it."""
        return [
            self.name,
            self.scenario,
            str(len(self.weights)),
            SUCCESS.estimate(self.success_rate),
            TIME.estimate(self.navigation_time),
            *([] if self.variant_success_rate is None else [SUCCESS.estimate(self.variant_success_rate)]),
            str(self.shipped_validation),
            str(self.shipped_test),
            self.reported,
        ]

    def each_seed(self) -> str:
        """A line with the success of each network."""
        each = zip(self.weights, self.success_rates, strict=True)
        listed = ", ".join(f"{weights} {SUCCESS.number(rate)}" for weights, rate in each)
        return f"- {self.name} on {self.scenario}: {listed}"


@dataclass(frozen=True)
class FilledSeeds(Filled):
    """The table with its numbers."""

    title: str
    cases: str
    validation: str
    variant: str
    rows: list[FilledRow]

    def markdown(self) -> str:
        """See `Filled`."""
        header = ["planner", "scenario", "seeds", "success", "time"]
        header += [f"success, {self.variant}"] if self.variant else []
        header += [f"shipped, {self.validation}", f"shipped, {self.cases}", "reported"]
        each = "\n".join(row.each_seed() for row in self.rows)
        parts = [
            f"## {self.title}",
            grid(header, [row.cells() for row in self.rows]),
            f"Success of each network on {self.cases}, the shipped one first:",
            each,
            NOTES,
        ]
        if any(row.privileged for row in self.rows):
            parts.append(PRIVILEGED)
        return "\n\n".join(parts)


@dataclass(frozen=True)
class Row:
    """A planner on a scenario: the runs of each of its `weights`, and of the first on validation cases."""

    planner: str
    weights: list[str]
    reported: str
    test: list[Run]
    variant: list[Run]
    validation: Run

    def fill(self, out: Path) -> FilledRow:
        """Its numbers, from runs in `out`."""
        first = self.test[0]
        test = [run.episodes(out) for run in self.test]
        variant = [run.episodes(out) for run in self.variant]
        success = of_all(test, SUCCESS)
        return FilledRow(
            planner=self.planner,
            privileged=first.privileged,
            scenario=first.scenario.name,
            replan_every=first.replan_every,
            weights=self.weights,
            success_rates=success.mean(axis=1).tolist(),
            success_rate=two_level(success),
            navigation_time=two_level(of_all(test, TIME)),
            variant_success_rate=two_level(of_all(variant, SUCCESS)) if variant else None,
            shipped_validation=Shipped.of(self.validation.episodes(out)),
            shipped_test=Shipped.of(test[0]),
            reported=self.reported,
        )


@dataclass(frozen=True)
class Seeds(Table):
    """A table of such planners, on `cases`, and once more on a variant of the scenario where there is one."""

    title: str
    cases: Cases
    validation: Cases
    variant: Variant | None
    rows: list[Row]

    @classmethod
    def of(cls, section: Section) -> Seeds:
        """The table that a file describes. Raises InputError where something in it is wrong."""
        title = section.needed("title")
        with section.blamed():
            cases = Cases.parse(section.text("cases", "test:500"))
            validation = Cases.parse(section.text("validation", "val:1000"))
        variant = Variant.of(section)
        tables = section.tables("rows")
        if not tables:
            raise section.wrong("rows", "one table or more")
        section.close()
        return cls(title, cases, validation, variant, [_row(row, cases, validation, variant) for row in tables])

    @property
    def runs(self) -> list[Run]:
        """See `Table`."""
        return [run for row in self.rows for run in (*row.test, *row.variant, row.validation)]

    def fill(self, out: Path) -> FilledSeeds:
        """See `Table`."""
        rows = [row.fill(out) for row in self.rows]
        variant = self.variant.title if self.variant else ""
        return FilledSeeds(self.title, str(self.cases), str(self.validation), variant, rows)


def _row(section: Section, cases: Cases, validation: Cases, variant: Variant | None) -> Row:
    planner, weights, scenario = section.needed("planner"), section.texts("weights"), section.needed("scenario")
    options = own_options(section)
    replan_every = section.integer("replan_every", 1, 1, 1000)
    label, reported = section.text("label"), section.text("reported")
    section.close()
    with section.blamed():
        runs = functools.partial(runs_with, weights, planner, options, scenario, replan_every=replan_every)
        test = runs(cases)
        other = runs(cases, overrides=variant.overrides) if variant else []
        name = label or planner_label(test[0].planner, options, replan_every)
        return Row(name, weights, reported, test, other, runs(validation)[0])
