"""`[[crowds]]`: planners side by side in every crowd, and by which measures they differ."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int, Shaped

from crowdbench import catalog
from crowdbench.metrics.summary import CONFIDENCE, Estimate, bootstrap, rate
from crowdbench.runs.load import load_run
from crowdbench.runs.paired import mcnemar, sign_test
from crowdbench.runs.results import Episodes
from crowdbench.runs.run import Run
from crowdbench.runs.spec import RunSpec
from crowdbench.scenario.cases import Cases
from crowdbench.study.folder import describe_scenario, read_episodes
from crowdbench.study.measures import DISCOMFORT, GAP, JERK, LEAST_SHARED, PRIVILEGED, SUCCESS, TIME, Row
from crowdbench.study.schema import CrowdPlannerSpec, CrowdsSpec
from crowdbench.utils.tables import Grid, markdown
from crowdbench.utils.toml import Location

OVER_SOLVED = (TIME, DISCOMFORT, JERK, GAP)
"""What is measured over solved cases: each planner's own, or those that both of a pair solve."""

FAILURES = {
    "collision_rate": "collision",
    "at_fault_rate": "at fault",
    "wall_collision_rate": "with a wall",
    "timeout_rate": "time-out",
}
"""Of the other cases: rates, and their headings."""

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
class CrowdRow(Row):
    """A planner in a crowd.

    Attributes:
        success_rate: Share of the cases that it solves.
        collision_rate: Share of the cases in which it collides, with a pedestrian or a wall.
        at_fault_rate: Share of the cases in which it is at fault for a collision.
        wall_collision_rate: Share of the cases in which it collides with a wall.
        timeout_rate: Share of the cases in which its time runs out.
        over_solved: The measures of `OVER_SOLVED` by metric, over the cases that it solves.
    """

    success_rate: Estimate
    collision_rate: float
    at_fault_rate: float
    wall_collision_rate: float
    timeout_rate: float
    over_solved: dict[str, Estimate]

    @classmethod
    def of(cls, run: Run, episodes: Episodes) -> CrowdRow:
        """Summarize the episodes of a run."""
        success = episodes.columns[SUCCESS.metric]
        failures = {name: float(episodes.columns[name].mean()) for name in FAILURES}
        over_solved = _over_solved(episodes.columns, success, episodes.block)
        succeeds = rate(success, episodes.block)
        return cls(run.label, run.driver.privileged, succeeds, **failures, over_solved=over_solved)


@dataclass(frozen=True)
class Pair:
    """Two planners, compared case by case.

    Attributes:
        first: The name of one.
        second: The name of the other.
        both_solved: The number of cases that both solve.
        p: McNemar's p-value of their success.
        differences: `second` minus `first` by metric, over the cases that both solve.
        better: The name of the better one, by every metric in which they differ significantly.
    """

    first: str
    second: str
    both_solved: int
    p: float
    differences: dict[str, Estimate]
    better: dict[str, str]

    @classmethod
    def of(cls, names: tuple[str, str], one: Episodes, two: Episodes) -> Pair:
        """Compare two planners.

        Args:
            names: The names of the two planners.
            one: The episodes of the first.
            two: The episodes of the second, of the same cases.
        """
        a, b = one.columns[SUCCESS.metric], two.columns[SUCCESS.metric]
        both = a & b
        changes = {each.metric: two.columns[each.metric] - one.columns[each.metric] for each in OVER_SOLVED}
        differences = _over_solved(changes, both, one.block)
        p = mcnemar(a, b) if one.block is None else sign_test(a, b, one.block)
        better = {SUCCESS.metric: names[int(b.sum() > a.sum())]} if p < 1 - CONFIDENCE else {}
        for each in OVER_SOLVED:
            found = differences[each.metric]
            if found.n >= LEAST_SHARED and (found.low > 0 or found.high < 0):
                better[each.metric] = names[int(each.sign * found.mean > 0)]
        return cls(*names, int(both.sum()), p, differences, better)

    def cell(self) -> str:
        """In which measures `second`, whose row it is, is better or worse than `first`."""
        verdicts = []
        for how, winner in (("better", self.second), ("worse", self.first)):
            words = [each.word for each in (SUCCESS, *OVER_SOLVED) if self.better.get(each.metric) == winner]
            verdicts += [f"{how}: {', '.join(words)}"] if words else []
        few = f" ({self.both_solved} solved by both)" if self.both_solved < LEAST_SHARED else ""
        return ("; ".join(verdicts) or "no significant difference") + few


def _over_solved(
    columns: Mapping[str, Shaped[np.ndarray, "case"]],
    solved: Bool[np.ndarray, "case"],
    block: Int[np.ndarray, "case"] | None,
) -> dict[str, Estimate]:
    """The means of `OVER_SOLVED` over the solved cases."""
    ones, block = np.ones(solved.sum()), None if block is None else block[solved]
    return {each.metric: bootstrap(columns[each.metric][solved], ones, block) for each in OVER_SOLVED}


@dataclass(frozen=True)
class FilledCrowd:
    """All planners in one crowd, and all pairs of them; `blocks` is the number of blocks of time of recorded people."""

    scenario: str
    planners: list[CrowdRow]
    pairs: list[Pair]
    blocks: int | None = None

    @classmethod
    def of(cls, runs: list[Run], out: Path) -> FilledCrowd:
        """Summarize and compare the runs of one scenario that are in the folder `out`, all of the same cases."""
        found = [(run.label, read_episodes(run, out)) for run in runs]
        planners = [CrowdRow.of(run, episodes) for run, (_, episodes) in zip(runs, found, strict=True)]
        pairs = [Pair.of((a, b), one, two) for (a, one), (b, two) in itertools.combinations(found, 2)]
        return cls(describe_scenario(runs[0]), planners, pairs, found[0][1].blocks.get("blocks"))

    def markdown(self) -> str:
        """Its two tables under its heading: what was measured, and in what each pair differs."""
        of_time = "" if self.blocks is None else f", {self.blocks} blocks of time"
        planners = self.grid()
        tables = [markdown(planners.header, planners.rows)]
        if self.pairs:
            columns = self.planners[:-1]
            cells = {(pair.second, pair.first): pair.cell() for pair in self.pairs}
            rows = [
                [row.name, *(cells.get((row.planner, each.planner), "") for each in columns)] for row in self.planners
            ]
            tables.append(markdown(["significantly better or worse than", *(each.name for each in columns)], rows[1:]))
        return "\n\n".join([f"### {self.scenario}{of_time}", *tables])

    def grid(self) -> Grid:
        """What was measured; collisions with walls are shown where there are any."""
        failures = dict(FAILURES)
        if not any(row.wall_collision_rate > 0.0 for row in self.planners):
            del failures["wall_collision_rate"]
        rows = [
            [
                row.name,
                SUCCESS.estimate(row.success_rate),
                *(SUCCESS.number(getattr(row, name)) for name in failures),
                *(each.estimate(row.over_solved[each.metric]) for each in OVER_SOLVED),
            ]
            for row in self.planners
        ]
        header = ["planner", "success", *failures.values(), *(each.word for each in OVER_SOLVED)]
        return Grid(self.scenario, header, rows, self.planners)


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
            rates = [row.success_rate.mean for row in crowd.planners]
            texts = map(SUCCESS.number, rates)
            cells = [f"**{text}**" if rate == max(rates) else text for rate, text in zip(rates, texts, strict=True)]
            rows.append([crowd.scenario, *cells])
        return markdown(["success", *(row.name for row in self.crowds[0].planners)], rows)

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
            PRIVILEGED: any(row.privileged for crowd in self.crowds for row in crowd.planners),
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
        crowds = [FilledCrowd.of(runs, out) for runs in self.by_scenario]
        return FilledCrowdsTable(self.title, str(self.cases), crowds)
