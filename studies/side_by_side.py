"""`[[tables]]`: planners side by side in every crowd, and the measures in which they differ."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench import Cases, simulated_scenarios
from crowdbench.metrics import info_of
from crowdbench.results import (
    LEAST_SHARED,
    PRIVILEGED,
    Comparison,
    MetricDifference,
    RunResult,
    RunTable,
    compare_results,
    estimate_grid,
    estimates,
    planner_label,
)
from crowdbench.runs import Replanning, Run, RunSpec, run_directory
from crowdbench.utils import Grid, Location, markdown
from studies.differences import difference_over_networks, gain_in_success
from studies.folder import load_runs
from studies.networks import estimate
from studies.pages import NOTES, SUCCESS, SUCCESS_RATE, values_of
from studies.schema import TableSpec

OVER_SOLVED = ("navigation_time", "discomfort", "jerk", "minimum_gap")
"""Metrics over cases that a planner solves, or that both planners of a pair solve."""

FAILURES = ("collision_rate", "at_fault_rate", "wall_collision_rate", "timeout_rate")
"""Metrics of failures."""

FAULTS = (0.05, 0.1, 0.2, 0.5)
"""Shares of the vehicle in a collision from which it counts as at fault, for a table of the effect of this choice."""


@dataclass(frozen=True)
class FilledCrowd:
    """All planners in one crowd, and all pairs of them.

    Attributes:
        scenario: The scenario, with its overrides.
        planners: Rows of the first table: the planner, and an estimate of each metric.
        at_fault: By planner, the share of cases in which it is at fault, by each of `FAULTS`.
        pairs: The planners compared with each other.
        blocks: The number of blocks of time of recorded pedestrians.
    """

    scenario: str
    planners: Sequence[Mapping[str, Any]]
    at_fault: Mapping[str, list[float]]
    pairs: list[Comparison]
    blocks: int | None

    @classmethod
    def of(cls, table: RunTable, networks: Sequence[int] | None = None) -> FilledCrowd:
        """Summarize and compare the runs of a scenario; `networks` are the numbers of runs of planners, if not 1."""
        ((scenario, runs),) = table.columns.items()
        each = iter(runs.values())
        rows = dict(_label([next(each) for _ in range(number)]) for number in networks or [1] * len(runs))
        # Collisions with walls are shown if there are any.
        walls = any(run.episodes.columns["wall_collision_rate"].any() for run in table.runs)
        infos = table.infos([SUCCESS_RATE, *(name for name in FAILURES if walls or "wall" not in name), *OVER_SOLVED])
        records = []
        for label, row in rows.items():
            found = estimates(row[0], infos, solved=True)
            if len(row) > 1:
                found = {name: estimate(name, [run.episodes for run in row]) for name in infos}
            records.append({"planner": label + " *" * bool(row[0].result["stated"]["privileged"]), **found})
        shares = {label: values_of("vehicle_share", [run.episodes for run in row]) for label, row in rows.items()}
        faults = {label: [float((share >= least).mean()) for least in FAULTS] for label, share in shares.items()}
        pairs = comparisons(rows)
        return cls(scenario, records, faults, pairs, table.runs[0].episodes.blocks.get("blocks"))

    def markdown(self) -> str:
        """Return its two tables under its heading: the measurements, and the differences of each pair."""
        of_time = "" if self.blocks is None else f", {self.blocks} blocks of time"
        grids = [self.grid(), *([verdict_grid(self.pairs)] if self.pairs else [])]
        return "\n\n".join([f"### {self.scenario}{of_time}", *(markdown(each.header, each.rows) for each in grids)])

    def grid(self) -> Grid:
        """Return the table of the measurements."""
        infos = {name: info_of(name) for name in self.planners[0] if name != "planner"}
        return estimate_grid(self.scenario, self.planners, infos, brief=FAILURES)


@dataclass(frozen=True)
class FilledCrowdsTable:
    """All crowds with their figures. `--format json` prints its fields."""

    title: str
    cases: str
    crowds: list[FilledCrowd]

    def markdown(self) -> str:
        """Return the tables in GitHub's Markdown, under their headings; success comes first if there are several
        crowds."""
        success = [self.success()] if len(self.crowds) > 1 else []
        parts = [f"Cases {self.cases}.", *success, self.faults(), *map(FilledCrowd.markdown, self.crowds)]
        return "\n\n".join([f"## {self.title}", *parts])

    def success(self) -> str:
        """Return success by planner and crowd in GitHub's Markdown.

        The planner with the highest mean comes first, and the highest success in each crowd is bold.
        """
        rates = np.array([[row[SUCCESS_RATE].mean for row in crowd.planners] for crowd in self.crowds])
        highest, rows = rates.max(axis=1), []
        for number in np.argsort(-rates.mean(axis=0), kind="stable").tolist():
            texts = map(SUCCESS.number, rates[:, number].tolist())
            is_best = rates[:, number] == highest
            cells = [f"**{text}**" if best else text for text, best in zip(texts, is_best, strict=True)]
            rows.append([self.crowds[0].planners[number]["planner"], *cells])
        return markdown([SUCCESS.heading, *(crowd.scenario for crowd in self.crowds)], rows)

    def faults(self) -> str:
        """Return the at-fault rate of each planner by threshold, over all crowds, the lowest first."""
        means = {name: np.mean([crowd.at_fault[name] for crowd in self.crowds], 0) for name in self.crowds[0].at_fault}
        header = ["at fault from a share of", *(f"{least:g}" for least in FAULTS)]
        ordered = sorted(means.items(), key=lambda row: row[1][1])
        return markdown(header, [[name, *map(SUCCESS.amount, shares.tolist())] for name, shares in ordered])

    def grids(self) -> list[Grid]:
        """Return its grids with a row for each planner."""
        return [crowd.grid() for crowd in self.crowds]

    def notes(self) -> list[str]:
        """Return the notes below the tables of a page, each once."""
        tests = len(self.crowds[0].pairs) * (1 + len(OVER_SOLVED))
        of_time = any(crowd.blocks is not None for crowd in self.crowds)
        test = "by a permutation test" if of_time else "by McNemar's exact test (p < 0.05)"
        least = f"{LEAST_SHARED} {'blocks' if of_time else 'such cases'}"
        paired = NOTES["paired"].format(test=test, tests=tests, least=least)
        notes = {
            NOTES["wilson"]: not of_time,
            NOTES["side_by_side"]: True,
            NOTES["trained"]: any(name.endswith(" networks") for name in self.crowds[0].at_fault),
            paired: tests > 0,
            NOTES["recorded"]: of_time,
            PRIVILEGED: any(row["planner"].endswith(" *") for crowd in self.crowds for row in crowd.planners),
        }
        return [note for note, applies in notes.items() if applies]


@dataclass(frozen=True)
class SideBySide:
    """Planners in scenarios, with the same cases for all. See `pages.Table`.

    Attributes:
        title: The title.
        cases: The cases.
        by_scenario: The runs of each scenario, one for each network of each planner.
        networks: The number of networks of each planner.
    """

    title: str
    cases: Cases
    by_scenario: list[list[Run]]
    networks: list[int]

    @classmethod
    def load(cls, spec: TableSpec, location: Location, data: Path | None = None) -> SideBySide:
        """Load the runs of a table.

        Args:
            spec: The table in the file.
            location: Its location in the file, for errors.
            data: The folder with the recorded tracks that its scenarios need.

        Raises:
            InputError: A planner or a scenario does not exist, or two planners have the same name and options.
        """
        scenarios = simulated_scenarios() if spec.scenarios == "all" else spec.scenarios
        replanning = Replanning(spec.replan_every, spec.look_first)
        base = RunSpec("", "", spec.cases, overrides=spec.overrides, replanning=replanning, record="none", data=data)
        with location.named():
            by_scenario = [load_runs(spec.planners, dataclasses.replace(base, scenario=name)) for name in scenarios]
        labels = [run.label for run in by_scenario[0]]
        if len(set(labels)) < len(labels):
            raise location.at("planners").wrong(repr(labels), "planners that differ in their names or options")
        return cls(spec.title, spec.cases, by_scenario, [len(planner.choices) for planner in spec.planners])

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return [run for runs in self.by_scenario for run in runs]

    def fill(self, out: Path) -> FilledCrowdsTable:
        """Fill the table from the runs in the folder `out`. Raises InputError if one is missing."""
        tables = [RunTable.read([run_directory(run, out) for run in runs]) for runs in self.by_scenario]
        return FilledCrowdsTable(self.title, str(self.cases), [FilledCrowd.of(each, self.networks) for each in tables])


def _label(runs: list[RunResult]) -> tuple[str, list[RunResult]]:
    """Return the name of a planner in its row, and its runs, one for each network."""
    planner = runs[0].result["run"]["planner"]
    options = {key: value for key, value in planner["options"].items() if key != "weights"}
    label = f"{planner_label(planner['name'], options)}, {len(runs)} networks" if len(runs) > 1 else runs[0].label
    return label, runs


def comparisons(rows: Mapping[str, Sequence[RunResult]]) -> list[Comparison]:
    """Compare each pair of planners in a scenario, by the runs of each, one for each network."""
    pairs = itertools.combinations(rows.items(), 2)
    return [
        compare_results(one[0], two[0], [SUCCESS_RATE, *OVER_SOLVED])
        if len(one) == len(two) == 1
        else _compare_networks((first, second), one, two)
        for (first, one), (second, two) in pairs
    ]


def _compare_networks(names: tuple[str, str], one: Sequence[RunResult], two: Sequence[RunResult]) -> Comparison:
    """Compare two planners, of which at least one has several networks."""
    networks = [[run.result["run"]["planner"]["options"].get("weights") for run in runs] for runs in (one, two)]
    runs, paired = [[run.episodes for run in row] for row in (one, two)], networks[0] == networks[1]
    solved = values_of(SUCCESS_RATE, [*runs[0], *runs[1]]).min(axis=0) > 0.0
    rows = {}
    for metric in (SUCCESS_RATE, *OVER_SOLVED):
        a, b = (values_of(metric, each) for each in runs)
        if metric == SUCCESS_RATE:
            found = gain_in_success(b, a, paired)
        else:
            found = difference_over_networks(b[:, solved], a[:, solved], paired)
        rows[metric] = MetricDifference(
            estimate(metric, runs[0]).mean, estimate(metric, runs[1]).mean, found, None, None
        )
    scenario, cases = one[0].result["scenario"]["name"], str(one[0].cases)
    return Comparison(scenario, names, len(solved), int(solved.sum()), rows, None, [], cases)


def verdict_grid(found: Sequence[Comparison]) -> Grid:
    """Return in which metrics the planner of a row is significantly better or worse than the planner of a column.

    Args:
        found: The return value of `comparisons` for two runs or more.
    """
    cells = {one.names: _verdict(one) for one in found}
    planners = list(dict.fromkeys(name for names in cells for name in names))
    rows = [[row, *(cells.get((column, row), "") for column in planners[:-1])] for row in planners[1:]]
    return Grid("pairs", ["significantly better or worse than", *planners[:-1]], rows, found)


def _verdict(found: Comparison) -> str:
    """Return the metrics in which the second of two planners is better or worse."""
    titles: dict[int, list[str]] = {1: [], -1: []}
    for name, row in found.rows.items():
        info = info_of(name)
        if row.is_significant and info.sign:
            titles[info.sign * (1 if row.difference.mean > 0.0 else -1)].append(info.title)
    words = [f"{how}: {', '.join(titles[sign])}" for how, sign in (("better", 1), ("worse", -1)) if titles[sign]]
    few = f" ({found.both_solved} solved by both)" if found.both_solved < LEAST_SHARED else ""
    return ("; ".join(words) or "no significant difference") + few
