"""`[[crowds]]`: planners side by side in every crowd, and which of them a paired test can tell apart."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench import catalog
from crowdbench.evaluate.compare import mcnemar
from crowdbench.evaluate.results import Episodes
from crowdbench.evaluate.summary import CONFIDENCE, Estimate, bootstrap, wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.planned import Run
from crowdbench.study.tables import (
    DISCOMFORT,
    GAP,
    JERK,
    LEAST_SHARED,
    PRIVILEGED,
    SUCCESS,
    TIME,
    Filled,
    Table,
    grid,
    marked,
)
from crowdbench.toml_section import Section

OVER_SOLVED = (TIME, DISCOMFORT, JERK, GAP)
"""What is measured over solved cases: each planner's own, or those that both of a pair solve."""

NOTES = (
    "Success has Wilson's 95 % interval. Time, discomfort (share of steps with a gap below 0.2 m), jerk and gap (the "
    "smallest of an episode) are means over the cases that the planner itself solves, with 95 % intervals of a "
    "bootstrap: those of planners that fail often are over easier cases."
)
PAIRED = (
    "Told apart are pairs that differ in success by McNemar's exact test (p < 0.05), or in a mean over the cases that "
    f"both solve by a paired bootstrap (its 95 % interval excludes 0; at least {LEAST_SHARED} such cases). + means "
    "that the planner of the row is better, - that it is worse, none that no test tells the two apart."
)


@dataclass(frozen=True)
class Entrant:
    """A planner in a crowd; what is measured `over_solved` is over the cases that it solves."""

    planner: str
    privileged: bool
    success_rate: Estimate
    collision_rate: float
    timeout_rate: float
    over_solved: dict[str, Estimate]

    @classmethod
    def of(cls, run: Run, episodes: Episodes) -> Entrant:
        """Measured on one run."""
        success = episodes.columns[SUCCESS.metric]
        solved = episodes.take(np.flatnonzero(success))
        return cls(
            planner=run.planner,
            privileged=run.privileged,
            success_rate=wilson(success),
            collision_rate=float(episodes.columns["collision_rate"].mean()),
            timeout_rate=float(episodes.columns["timeout_rate"].mean()),
            over_solved={
                each.metric: bootstrap(solved.columns[each.metric], np.ones(len(solved))) for each in OVER_SOLVED
            },
        )

    @property
    def name(self) -> str:
        """The planner, marked where it is privileged."""
        return marked(self.planner, self.privileged)

    def cells(self) -> list[str]:
        """As `FilledCrowd` shows it."""
        failures = [SUCCESS.number(self.collision_rate), SUCCESS.number(self.timeout_rate)]
        means = [each.estimate(self.over_solved[each.metric]) for each in OVER_SOLVED]
        return [self.name, SUCCESS.estimate(self.success_rate), *failures, *means]


@dataclass(frozen=True)
class Pair:
    """Two planners case by case. `better` names the better one in every metric that tells them apart.

    `p` is McNemar's, of their success; `differences` are `second` minus `first`, over the `both_solved` cases.
    """

    first: str
    second: str
    both_solved: int
    p: float
    differences: dict[str, Estimate]
    better: dict[str, str]

    @classmethod
    def of(cls, names: tuple[str, str], one: Episodes, two: Episodes) -> Pair:
        """Compare two runs of the same cases."""
        a, b = one.columns[SUCCESS.metric], two.columns[SUCCESS.metric]
        both = a & b
        ones = np.ones(both.sum())
        differences = {
            each.metric: bootstrap(two.columns[each.metric][both] - one.columns[each.metric][both], ones)
            for each in OVER_SOLVED
        }
        p = mcnemar(a, b)
        better = {SUCCESS.metric: names[int(b.sum() > a.sum())]} if p < 1 - CONFIDENCE else {}
        for each in OVER_SOLVED:
            found = differences[each.metric]
            if found.n >= LEAST_SHARED and (found.low > 0 or found.high < 0):
                better[each.metric] = names[int(each.sign * found.mean > 0)]
        return cls(*names, int(both.sum()), p, differences, better)

    def cell(self) -> str:
        """In which measures the second, whose row it is, is better (+) or worse (-)."""
        signs = {metric: "+" if name == self.second else "-" for metric, name in self.better.items()}
        told = [f"{each.word} {signs[each.metric]}" for each in (SUCCESS, *OVER_SOLVED) if each.metric in signs]
        few = f" ({self.both_solved} solved by both)" if self.both_solved < LEAST_SHARED else ""
        return (", ".join(told) or "none") + few


@dataclass(frozen=True)
class FilledCrowd:
    """All planners in one crowd, and all pairs of them."""

    scenario: str
    planners: list[Entrant]
    pairs: list[Pair]

    @classmethod
    def of(cls, runs: list[Run], out: Path) -> FilledCrowd:
        """Measured on runs of one scenario in `out`."""
        found = [(run.planner, run.episodes(out)) for run in runs]
        planners = [Entrant.of(run, episodes) for run, (_, episodes) in zip(runs, found, strict=True)]
        pairs = [Pair.of((a, b), one, two) for (a, one), (b, two) in itertools.combinations(found, 2)]
        return cls(runs[0].scenario.name, planners, pairs)

    def markdown(self) -> str:
        """Its two tables under its heading: what was measured, and who is told apart."""
        header = ["planner", "success", "collision", "time-out", *(each.word for each in OVER_SOLVED)]
        tables = [grid(header, [entrant.cells() for entrant in self.planners])]
        if self.pairs:
            tables.append(self._matrix())
        return "\n\n".join([f"### {self.scenario}", *tables])

    def _matrix(self) -> str:
        names = [entrant.name for entrant in self.planners]
        cells = {(pair.second, pair.first): pair.cell() for pair in self.pairs}
        rows = [
            [row.name] + [cells.get((row.planner, column.planner), "") for column in self.planners[:-1]]
            for row in self.planners[1:]
        ]
        return grid(["told apart from", *names[:-1]], rows)


@dataclass(frozen=True)
class FilledCrowds(Filled):
    """The tables with their numbers."""

    title: str
    cases: str
    crowds: list[FilledCrowd]

    def markdown(self) -> str:
        """See `Filled`."""
        tests = len(self.crowds[0].pairs) * (1 + len(OVER_SOLVED))
        notes = [f"Cases {self.cases}. {NOTES}"]
        if tests:
            notes.append(
                f"{PAIRED} The {tests} tests in a crowd are not corrected for their number: of tests between planners "
                "that do not differ, one in twenty tells them apart."
            )
        if any(entrant.privileged for crowd in self.crowds for entrant in crowd.planners):
            notes.append(PRIVILEGED)
        return "\n\n".join([f"## {self.title}", *(crowd.markdown() for crowd in self.crowds), *notes])


@dataclass(frozen=True)
class Crowds(Table):
    """Planners in crowds, the same cases for all; `by_scenario` has the runs of each scenario in a list."""

    title: str
    cases: Cases
    by_scenario: list[list[Run]]

    @classmethod
    def of(cls, section: Section) -> Crowds:
        """The table that a file describes. Raises InputError where something in it is wrong."""
        title, planners, scenarios = section.needed("title"), section.texts("planners"), _scenarios(section)
        wanted = section.text("cases", "test:500")
        section.close()
        with section.blamed():
            cases = Cases.parse(wanted)
            by_scenario = [[Run.of(planner, {}, scenario, cases) for planner in planners] for scenario in scenarios]
        if len({run.planner for run in by_scenario[0]}) < len(planners):
            raise section.wrong("planners", "planners of different names")
        return cls(title, cases, by_scenario)

    @property
    def runs(self) -> list[Run]:
        """See `Table`."""
        return [run for runs in self.by_scenario for run in runs]

    def fill(self, out: Path) -> FilledCrowds:
        """See `Table`."""
        crowds = [FilledCrowd.of(runs, out) for runs in self.by_scenario]
        return FilledCrowds(self.title, str(self.cases), crowds)


def _scenarios(section: Section) -> list[str]:
    """A list of scenarios; "all" stands for all built-in ones."""
    given = section.read("scenarios", None)
    if given == "all":
        return [name for name, _ in catalog.scenarios()]
    if isinstance(given, str):
        raise section.wrong("scenarios", '"all" or a list of scenarios')
    return section.texts("scenarios")
