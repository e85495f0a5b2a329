"""`[[measured]]`: planners in one crowd, what is reported of them beside what is measured, and claims about them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.evaluate.results import Episodes, planner_label, replanning
from crowdbench.evaluate.summary import Estimate, wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.bootstrap import two_level
from crowdbench.study.claims import MEASURES, Claim, Judged, claims_grid
from crowdbench.study.claims import NOTES as CLAIM_NOTES
from crowdbench.study.networks import Variant, of_all, own_options, runs_with
from crowdbench.study.planned import Run
from crowdbench.study.tables import PRIVILEGED, SUCCESS, Filled, Measure, Table, grid, marked
from crowdbench.toml_section import Section

NOTES = (
    "Means over the networks of a row, each on the same cases, with 95 % intervals: of a bootstrap over networks and "
    "cases, and Wilson's for the success of a single network. All but success is over the cases that are solved. Two "
    "networks say little of how networks differ, and an interval without width is no certainty."
)


@dataclass(frozen=True)
class FilledRow:
    """A row with its numbers, by metric: what is `reported`, and what its networks do.

    `variant_success_rate` is that of the first network alone.
    """

    planner: str
    privileged: bool
    weights: list[str]
    reported: dict[str, float]
    measured: dict[str, Estimate]
    variant_success_rate: Estimate | None

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)


@dataclass(frozen=True)
class FilledMeasured(Filled):
    """The table with its numbers."""

    title: str
    scenario: str
    replan_every: int
    cases: str
    variant: str
    rows: list[FilledRow]
    claims: list[Judged]

    def markdown(self) -> str:
        """See `Filled`."""
        return "\n\n".join([self.grids(), *notes([self])])

    def grids(self) -> str:
        """The table and its claims under their heading, without the notes."""
        columns = list(zip(*self._columns(), strict=True))
        every = "".join(f", {key}={value}" for key, value in replanning(self.replan_every).items())
        parts = [f"## {self.title}", f"On {self.scenario}{every}, cases {self.cases}.", grid(columns[0], columns[1:])]
        return "\n\n".join([*parts, claims_grid(self.claims)] if self.claims else parts)

    def _columns(self) -> list[list[str]]:
        """Each column, its heading first; what nothing is reported of has no column for it."""
        columns = [["planner", *(row.name for row in self.rows)]]
        columns.append(["networks", *(str(len(row.weights)) if row.weights else "" for row in self.rows)])
        for metric, measure in MEASURES.items():
            if any(metric in row.reported for row in self.rows):
                reported = [measure.given(row.reported.get(metric)) for row in self.rows]
                columns.append([f"{measure.word}, reported", *reported])
            columns.append([measure.word, *(measure.estimate(row.measured[metric]) for row in self.rows)])
        if self.variant:
            rates = [row.variant_success_rate for row in self.rows]
            columns.append([f"success, {self.variant}", *(SUCCESS.estimate(rate) for rate in rates if rate)])
        return columns


def notes(tables: Sequence[FilledMeasured]) -> list[str]:
    """What has to be said of tables of this kind, once for all of them."""
    said = [NOTES]
    if any(row.privileged for table in tables for row in table.rows):
        said.append(PRIVILEGED)
    return [*said, CLAIM_NOTES] if any(table.claims for table in tables) else said


@dataclass(frozen=True)
class Row:
    """A planner: the runs with each of its `weights`, or its one run, and that of the first under another rule."""

    label: str
    weights: list[str]
    reported: dict[str, float]
    test: list[Run]
    variant: Run | None

    @property
    def networks(self) -> list[str]:
        """What tells its runs apart: their weights, or nothing where there is one without."""
        return self.weights or [""]

    def first(self, cases: Cases) -> Row:
        """The first network alone, on other cases."""
        variant = self.variant and dataclasses.replace(self.variant, cases=cases)
        return dataclasses.replace(
            self, weights=self.weights[:1], test=[dataclasses.replace(self.test[0], cases=cases)], variant=variant
        )

    def episodes(self, out: Path) -> dict[str, Episodes]:
        """What its runs left in `out`, by their networks."""
        return {name: run.episodes(out) for name, run in zip(self.networks, self.test, strict=True)}

    def fill(self, episodes: Mapping[str, Episodes], out: Path) -> FilledRow:
        """Its numbers, from its episodes and the run of its variant in `out`."""
        variant = wilson(self.variant.episodes(out).columns[SUCCESS.metric]) if self.variant else None
        solved = of_all(episodes.values(), SUCCESS).astype(bool)
        return FilledRow(
            planner=self.label,
            privileged=self.test[0].privileged,
            weights=self.weights,
            reported=self.reported,
            measured={
                metric: _measured(of_all(episodes.values(), measure), measure, solved)
                for metric, measure in MEASURES.items()
            },
            variant_success_rate=variant,
        )


@dataclass(frozen=True)
class Measured(Table):
    """Planners on the `cases` of one scenario; `quick` are those for a quick look."""

    title: str
    cases: Cases
    quick: Cases
    variant: str
    rows: list[Row]
    claims: list[Claim]

    @classmethod
    def of(cls, section: Section) -> Measured:
        """The table that a file describes. Raises InputError where something in it is wrong."""
        title, scenario = section.needed("title"), section.needed("scenario")
        replan_every = section.integer("replan_every", 1, 1, 1000)
        with section.blamed():
            cases, quick = Cases.parse(section.text("cases", "test:500")), Cases.parse(section.text("quick", "test:40"))
        variant = Variant.of(section)
        tables, claims = section.tables("rows"), section.tables("claims")
        if not tables:
            raise section.wrong("rows", "one table or more")
        section.close()
        rows = [_row(row, scenario, replan_every, cases, variant) for row in tables]
        networks = {row.label: row.networks for row in rows}
        if len(networks) < len(rows):
            raise section.wrong("rows", "rows of different labels")
        judged = [Claim.of(claim, networks) for claim in claims]
        return cls(title, cases, quick, variant.title if variant else "", rows, judged)

    @property
    def runs(self) -> list[Run]:
        """See `Table`."""
        return [run for row in self.rows for run in (*row.test, *([row.variant] if row.variant else []))]

    def quickly(self) -> Measured:
        """The same table for a quick look: the first network of each row, on few cases."""
        return dataclasses.replace(self, cases=self.quick, rows=[row.first(self.quick) for row in self.rows])

    def fill(self, out: Path) -> FilledMeasured:
        """See `Table`."""
        episodes = {row.label: row.episodes(out) for row in self.rows}
        run = self.rows[0].test[0]
        return FilledMeasured(
            title=self.title,
            scenario=run.scenario.name,
            replan_every=run.replan_every,
            cases=str(self.cases),
            variant=self.variant,
            rows=[row.fill(episodes[row.label], out) for row in self.rows],
            claims=[claim.judge(episodes) for claim in self.claims],
        )


def _row(section: Section, scenario: str, replan_every: int, cases: Cases, variant: Variant | None) -> Row:
    planner, label, options = section.needed("planner"), section.text("label"), own_options(section)
    weights = [] if section.read("weights", None) is None else section.texts("weights")
    table = section.section("reported")
    numbers = {metric: table.number(metric, 0.0, least=0.0, below=1000.0) for metric in MEASURES}
    reported = {metric: number for metric, number in numbers.items() if metric in table.table}
    table.close()
    section.close()
    with section.blamed():
        runs = functools.partial(
            runs_with, planner=planner, options=options, scenario=scenario, replan_every=replan_every
        )
        test = runs(weights, cases=cases)
        other = runs(weights[:1], cases=cases, overrides=variant.overrides)[0] if variant else None
        return Row(label or planner_label(test[0].planner, options), weights, reported, test, other)


def _measured(
    values: Float[np.ndarray, "seed case"], measure: Measure, solved: Bool[np.ndarray, "seed case"]
) -> Estimate:
    if measure is not SUCCESS:
        return two_level(np.where(solved, values, np.nan))
    return wilson(solved[0]) if len(solved) == 1 else two_level(values)
