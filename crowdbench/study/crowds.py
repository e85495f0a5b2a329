"""`[[crowds]]`: planners side by side in every crowd, and by which measures they differ."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench import catalog
from crowdbench.evaluate.compare import mcnemar, sign_test
from crowdbench.evaluate.formats import Grid, markdown
from crowdbench.evaluate.results import Episodes
from crowdbench.evaluate.summary import CONFIDENCE, Estimate, bootstrap, rate
from crowdbench.scenario.cases import Cases
from crowdbench.study.measures import DISCOMFORT, GAP, JERK, LEAST_SHARED, SUCCESS, TIME
from crowdbench.study.planned import PlannedRun
from crowdbench.study.schema import CrowdsSpec
from crowdbench.study.tables import PRIVILEGED, FilledTable, PlannedTable, marked
from crowdbench.toml_file import Location

OVER_SOLVED = (TIME, DISCOMFORT, JERK, GAP)
"""What is measured over solved cases: each planner's own, or those that both of a pair solve."""

NOTES = (
    "Success has Wilson's 95 % interval. Time, discomfort (share of steps with a gap below 0.2 m), jerk and gap (the "
    "smallest of an episode) are means over the cases that the planner itself solves, with 95 % intervals of a "
    "bootstrap. The means of a planner that fails often are over easier cases."
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
    f"least {LEAST_SHARED} such cases)."
)


@dataclass(frozen=True)
class CrowdRow:
    """A planner in a crowd.

    Attributes:
        planner: Its name.
        privileged: Whether it uses what no vehicle could know.
        success_rate: Share of the cases that it solves.
        collision_rate: Share of the cases in which it collides, with a pedestrian or a wall.
        wall_collision_rate: Share of the cases in which it collides with a wall.
        timeout_rate: Share of the cases in which its time runs out.
        over_solved: The measures of `OVER_SOLVED` by metric, over the cases that it solves.
    """

    planner: str
    privileged: bool
    success_rate: Estimate
    collision_rate: float
    wall_collision_rate: float
    timeout_rate: float
    over_solved: dict[str, Estimate]

    @classmethod
    def of(cls, run: PlannedRun, episodes: Episodes) -> CrowdRow:
        """Summarize one run.

        Args:
            run: The run.
            episodes: Its episodes.

        Returns:
            The row of its planner.
        """
        success = episodes.columns[SUCCESS.metric]
        solved = episodes.take(np.flatnonzero(success))
        return cls(
            planner=run.planner,
            privileged=run.privileged,
            success_rate=rate(success, episodes.block),
            collision_rate=float(episodes.columns["collision_rate"].mean()),
            wall_collision_rate=float(episodes.columns["wall_collision_rate"].mean()),
            timeout_rate=float(episodes.columns["timeout_rate"].mean()),
            over_solved={
                each.metric: bootstrap(solved.columns[each.metric], np.ones(len(solved)), solved.block)
                for each in OVER_SOLVED
            },
        )

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)

    def cells(self, walls: bool) -> list[str]:
        """As `FilledCrowd` shows it; `walls` is whether the collisions with walls are shown."""
        rates = [self.collision_rate, *([self.wall_collision_rate] if walls else []), self.timeout_rate]
        failures = [SUCCESS.number(rate) for rate in rates]
        means = [each.estimate(self.over_solved[each.metric]) for each in OVER_SOLVED]
        return [self.name, SUCCESS.estimate(self.success_rate), *failures, *means]


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
        """Compare two planners case by case.

        Args:
            names: The names of the two planners.
            one: The episodes of the first.
            two: The episodes of the second, of the same cases.

        Returns:
            The comparison.
        """
        a, b = one.columns[SUCCESS.metric], two.columns[SUCCESS.metric]
        both = a & b
        ones, block = np.ones(both.sum()), None if one.block is None else one.block[both]
        differences = {
            each.metric: bootstrap(two.columns[each.metric][both] - one.columns[each.metric][both], ones, block)
            for each in OVER_SOLVED
        }
        p = mcnemar(a, b) if one.block is None else sign_test(a, b, one.block)
        better = {SUCCESS.metric: names[int(b.sum() > a.sum())]} if p < 1 - CONFIDENCE else {}
        for each in OVER_SOLVED:
            found = differences[each.metric]
            if found.n >= LEAST_SHARED and (found.low > 0 or found.high < 0):
                better[each.metric] = names[int(each.sign * found.mean > 0)]
        return cls(*names, int(both.sum()), p, differences, better)

    def cell(self) -> str:
        """In which measures `second`, whose row it is, is better or worse than `first`."""
        measures = [each for each in (SUCCESS, *OVER_SOLVED) if each.metric in self.better]
        better = [each.word for each in measures if self.better[each.metric] == self.second]
        worse = [each.word for each in measures if self.better[each.metric] == self.first]
        said = [f"{how}: {', '.join(words)}" for how, words in (("better", better), ("worse", worse)) if words]
        few = f" ({self.both_solved} solved by both)" if self.both_solved < LEAST_SHARED else ""
        return ("; ".join(said) or "no significant difference") + few


@dataclass(frozen=True)
class FilledCrowd:
    """All planners in one crowd, and all pairs of them; `blocks` is the number of blocks of time of recorded people."""

    scenario: str
    planners: list[CrowdRow]
    pairs: list[Pair]
    blocks: int | None = None

    @classmethod
    def of(cls, runs: list[PlannedRun], out: Path) -> FilledCrowd:
        """Summarize and compare the runs of one scenario.

        Args:
            runs: Runs of the same cases of one scenario.
            out: The folder with their results.

        Returns:
            The planners and their comparisons.
        """
        found = [(run.planner, run.episodes(out)) for run in runs]
        planners = [CrowdRow.of(run, episodes) for run, (_, episodes) in zip(runs, found, strict=True)]
        pairs = [Pair.of((a, b), one, two) for (a, one), (b, two) in itertools.combinations(found, 2)]
        changes = "".join(f", {key}={value}" for key, value in runs[0].spec.overrides.items())
        return cls(f"{runs[0].scenario.name}{changes}", planners, pairs, found[0][1].blocks.get("blocks"))

    def markdown(self) -> str:
        """Its two tables under its heading: what was measured, and in what each pair differs."""
        planners = self.grid()
        tables = [markdown(planners.header, planners.rows)]
        if self.pairs:
            tables.append(self._matrix())
        of_time = "" if self.blocks is None else f", {self.blocks} blocks of time"
        return "\n\n".join([f"### {self.scenario}{of_time}", *tables])

    def grid(self) -> Grid:
        """What was measured."""
        walls = any(row.wall_collision_rate > 0.0 for row in self.planners)
        failures = ["collision", *(["with a wall"] if walls else []), "time-out"]
        header = ["planner", "success", *failures, *(each.word for each in OVER_SOLVED)]
        return Grid(self.scenario, header, [row.cells(walls) for row in self.planners], self.planners)

    def _matrix(self) -> str:
        names = [row.name for row in self.planners]
        cells = {(pair.second, pair.first): pair.cell() for pair in self.pairs}
        rows = [
            [row.name] + [cells.get((row.planner, column.planner), "") for column in self.planners[:-1]]
            for row in self.planners[1:]
        ]
        return markdown(["significantly better or worse than", *names[:-1]], rows)


@dataclass(frozen=True)
class FilledCrowdsTable(FilledTable):
    """All crowds with their figures."""

    title: str
    cases: str
    crowds: list[FilledCrowd]

    def markdown(self) -> str:
        """See `FilledTable`."""
        return "\n\n".join([f"## {self.title}", f"Cases {self.cases}.", *(crowd.markdown() for crowd in self.crowds)])

    def grids(self) -> list[Grid]:
        """See `FilledTable`."""
        return [crowd.grid() for crowd in self.crowds]

    def notes(self) -> list[str]:
        """See `FilledTable`."""
        notes = [NOTES]
        if tests := len(self.crowds[0].pairs) * (1 + len(OVER_SOLVED)):
            notes.append(
                f"{PAIRED} The {tests} tests in a crowd are not corrected for their number: between planners that do "
                "not differ, about one test in twenty finds a difference."
            )
        if any(crowd.blocks is not None for crowd in self.crowds):
            notes.append(RECORDED)
        if any(row.privileged for crowd in self.crowds for row in crowd.planners):
            notes.append(PRIVILEGED)
        return notes


@dataclass(frozen=True)
class CrowdsTable(PlannedTable):
    """Planners in crowds, the same cases for all; `by_scenario` has the runs of each scenario in a list."""

    title: str
    cases: Cases
    by_scenario: list[list[PlannedRun]]

    @classmethod
    def of(cls, spec: CrowdsSpec, location: Location, data: Path | None = None) -> CrowdsTable:
        """Plan the runs of a table.

        Args:
            spec: What the file says of the table.
            location: Where in the file.
            data: The folder with the recorded tracks that its scenarios need.

        Raises:
            InputError: A planner or a scenario does not exist, or two planners have the same name.
        """
        scenarios = catalog.simulated_scenarios() if spec.scenarios == "all" else spec.scenarios
        with location.named():
            by_scenario = [
                [
                    PlannedRun.of(planner, {}, scenario, spec.cases, overrides=spec.overrides, data=data)
                    for planner in spec.planners
                ]
                for scenario in scenarios
            ]
        if len({run.planner for run in by_scenario[0]}) < len(spec.planners):
            raise location.at("planners").wrong(repr(spec.planners), "planners of different names")
        return cls(spec.title, spec.cases, by_scenario)

    @property
    def runs(self) -> list[PlannedRun]:
        """See `PlannedTable`."""
        return [run for runs in self.by_scenario for run in runs]

    def fill(self, out: Path) -> FilledCrowdsTable:
        """See `PlannedTable`."""
        crowds = [FilledCrowd.of(runs, out) for runs in self.by_scenario]
        return FilledCrowdsTable(self.title, str(self.cases), crowds)
