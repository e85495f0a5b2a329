"""`[[crowds]]`: planners side by side in every crowd, and by which measures they differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crowdbench import catalog
from crowdbench.metrics import info_of
from crowdbench.runs.compare import Comparison
from crowdbench.runs.load import load_run
from crowdbench.runs.paired import LEAST_SHARED
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.runs.table import PRIVILEGED, RunTable, comparisons, estimate_grid, verdict_grid
from crowdbench.scenario.cases import Cases
from crowdbench.study.folder import run_directory
from crowdbench.study.measures import SUCCESS, SUCCESS_RATE
from crowdbench.study.schema import CrowdPlannerSpec, CrowdsSpec
from crowdbench.utils.tables import Grid, markdown
from crowdbench.utils.toml import Location

OVER_SOLVED = ("navigation_time", "discomfort", "jerk", "minimum_gap")
"""What is measured over solved cases: each planner's own, or those that both of a pair solve."""

FAILURES = ("collision_rate", "at_fault_rate", "wall_collision_rate", "timeout_rate")
"""Of the other cases."""

NOTES = (
    "Success has Wilson's 95 % interval. At fault are collisions in which the vehicle had a share of 0.1 or more. "
    "Time, discomfort (share of steps with a gap below 0.2 m), jerk and gap (the smallest of an episode) are means "
    "over the cases that the planner itself solves, with 95 % intervals of a bootstrap. The means of a planner that "
    "fails often are over easier cases."
)
RECORDED = (
    "Cases from the same block of recorded time are not independent. Where people were recorded, also where they "
    "react, intervals are those of a bootstrap over blocks, also of success, and success is compared by a permutation "
    "test that exchanges two planners block by block."
)
PAIRED = (
    "The second table of a crowd says in which measures the planner of the row is significantly better or worse than "
    "the planner of the column: in success by McNemar's exact test (p < 0.05), in the other measures by a paired "
    "bootstrap of the mean difference over the cases that both solve (its 95 % interval excludes 0, and there are at "
    f"least {LEAST_SHARED} such cases). The {{tests}} tests in a crowd are not corrected for their number: between "
    "planners that do not differ, about one test in twenty finds a difference."
)


@dataclass(frozen=True)
class FilledCrowd:
    """All planners in one crowd, and all pairs of them.

    Attributes:
        scenario: The scenario, with what is changed in it.
        planners: Rows of the first table: the planner, and an estimate of each metric.
        pairs: The planners compared with each other.
        blocks: The number of blocks of time of recorded people.
    """

    scenario: str
    planners: Sequence[Mapping[str, Any]]
    pairs: list[Comparison]
    blocks: int | None

    @classmethod
    def of(cls, table: RunTable) -> FilledCrowd:
        """Summarize and compare the runs of one scenario."""
        ((scenario, runs),) = table.columns.items()
        # Collisions with walls are shown where there are any.
        walls = any(run.episodes.columns["wall_collision_rate"].any() for run in table.runs)
        failures = [name for name in FAILURES if walls or name != "wall_collision_rate"]
        records = table.grid([SUCCESS_RATE, *failures, *OVER_SOLVED], solved=True).records
        pairs = comparisons(runs, [SUCCESS_RATE, *OVER_SOLVED])
        return cls(scenario, records, pairs, table.runs[0].episodes.blocks.get("blocks"))

    def markdown(self) -> str:
        """Its two tables under its heading: what was measured, and in what each pair differs."""
        of_time = "" if self.blocks is None else f", {self.blocks} blocks of time"
        grids = [self.grid(), *([verdict_grid(self.pairs)] if self.pairs else [])]
        return "\n\n".join([f"### {self.scenario}{of_time}", *(markdown(each.header, each.rows) for each in grids)])

    def grid(self) -> Grid:
        """What was measured."""
        infos = {name: info_of(name) for name in self.planners[0] if name != "planner"}
        return estimate_grid(self.scenario, self.planners, infos, brief=FAILURES)


@dataclass(frozen=True)
class FilledCrowdsTable:
    """All crowds with their figures. Its fields are what `--format json` prints."""

    title: str
    cases: str
    crowds: list[FilledCrowd]

    def markdown(self) -> str:
        """The tables as GitHub shows them, under their headings; success comes first where there are several crowds."""
        success = [self.success()] if len(self.crowds) > 1 else []
        return "\n\n".join(
            [f"## {self.title}", f"Cases {self.cases}.", *success, *map(FilledCrowd.markdown, self.crowds)]
        )

    def success(self) -> str:
        """Who succeeds where, a row for each crowd, as GitHub shows it; the highest of each row is bold."""
        rows = []
        for crowd in self.crowds:
            rates = [row[SUCCESS_RATE].mean for row in crowd.planners]
            texts = map(SUCCESS.number, rates)
            cells = [f"**{text}**" if rate == max(rates) else text for rate, text in zip(rates, texts, strict=True)]
            rows.append([crowd.scenario, *cells])
        return markdown([SUCCESS.heading, *(row["planner"] for row in self.crowds[0].planners)], rows)

    def grids(self) -> list[Grid]:
        """The parts of it that have a row for each planner."""
        return [crowd.grid() for crowd in self.crowds]

    def notes(self) -> list[str]:
        """What a page says below its tables, once for all that say the same."""
        tests = len(self.crowds[0].pairs) * (1 + len(OVER_SOLVED))
        notes = {
            NOTES: True,
            PAIRED.format(tests=tests): tests > 0,
            RECORDED: any(crowd.blocks is not None for crowd in self.crowds),
            PRIVILEGED: any(row["planner"].endswith(" *") for crowd in self.crowds for row in crowd.planners),
        }
        return [note for note, applies in notes.items() if applies]


def load_runs(planners: Sequence[CrowdPlannerSpec], base: RunSpec) -> list[Run]:
    """The runs of planners in one scenario, which is loaded once.

    Args:
        planners: The planners with their options.
        base: What all runs have in common.

    Raises:
        InputError: A planner or the scenario does not exist.
    """
    scenario = catalog.load_scenario(base.scenario, base.overrides, data=base.data)
    return [load_run(replace(base, planner=each.planner, options=each.options), scenario=scenario) for each in planners]


@dataclass(frozen=True)
class CrowdsTable:
    """Planners in crowds, the same cases for all; `by_scenario` has the runs of each scenario in a list."""

    title: str
    cases: Cases
    by_scenario: list[list[Run]]

    @classmethod
    def of(cls, spec: CrowdsSpec, location: Location, data: Path | None) -> CrowdsTable:
        """Plan the runs of a table.

        Args:
            spec: What the file says of the table.
            location: Where in the file.
            data: The folder with the recorded tracks that its scenarios need.

        Raises:
            InputError: A planner or a scenario does not exist, or two planners have the same name and options.
        """
        scenarios = catalog.simulated_scenarios() if spec.scenarios == "all" else spec.scenarios
        base = RunSpec("", "", spec.cases, overrides=spec.overrides, record="none", data=data)
        with location.named():
            by_scenario = [load_runs(spec.planners, replace(base, scenario=scenario)) for scenario in scenarios]
        labels = [run.label for run in by_scenario[0]]
        if len(set(labels)) < len(labels):
            raise location.at("planners").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec.title, spec.cases, by_scenario)

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for runs in self.by_scenario for run in runs]

    def fill(self, out: Path) -> FilledCrowdsTable:
        """The table with the figures of the runs in the folder `out`; raises InputError where one is not there."""
        tables = [RunTable.read([run_directory(run, out) for run in runs]) for runs in self.by_scenario]
        crowds = [FilledCrowd.of(table) for table in tables]
        return FilledCrowdsTable(self.title, str(self.cases), crowds)
