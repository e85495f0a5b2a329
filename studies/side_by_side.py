"""`[[tables]]`: planners side by side in every crowd, and the measures in which they differ."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crowdbench.metrics import info_of
from crowdbench.runs.compare import Comparison, compare_results
from crowdbench.runs.paired import LEAST_SHARED
from crowdbench.runs.run import Run
from crowdbench.runs.store import RunResult
from crowdbench.runs.table import PRIVILEGED, RunTable, estimate_grid
from crowdbench.study.folder import run_directory
from crowdbench.study.study import StudyTable
from crowdbench.utils.tables import Grid, markdown
from studies.pages import NOTES, SUCCESS, SUCCESS_RATE

OVER_SOLVED = ("navigation_time", "discomfort", "jerk", "minimum_gap")
"""What is measured over solved cases: each planner's own, or those that both of a pair solve."""

FAILURES = ("collision_rate", "at_fault_rate", "wall_collision_rate", "timeout_rate")
"""Of the other cases."""


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
            NOTES["side_by_side"]: True,
            NOTES["paired"].format(tests=tests, least=LEAST_SHARED): tests > 0,
            NOTES["recorded"]: any(crowd.blocks is not None for crowd in self.crowds),
            PRIVILEGED: any(row["planner"].endswith(" *") for crowd in self.crowds for row in crowd.planners),
        }
        return [note for note, applies in notes.items() if applies]


@dataclass(frozen=True)
class SideBySide:
    """The page of a table of a study. `fill` and `runs` are as `pages.Table` says."""

    table: StudyTable

    @property
    def runs(self) -> list[Run]:
        """All runs that it needs."""
        return self.table.runs

    def fill(self, out: Path) -> FilledCrowdsTable:
        """Fill the table from the runs in the folder `out`. Raises InputError where one is not there."""
        tables = [RunTable.read([run_directory(run, out) for run in runs]) for runs in self.table.by_scenario]
        return FilledCrowdsTable(self.table.title, str(self.table.cases), list(map(FilledCrowd.of, tables)))


def comparisons(runs: Mapping[str, RunResult], metrics: Sequence[str]) -> list[Comparison]:
    """Compare each pair of runs of a scenario."""
    return [compare_results(*pair, metrics) for pair in itertools.combinations(runs.values(), 2)]


def verdict_grid(found: Sequence[Comparison]) -> Grid:
    """Return in which metrics the planner of a row is significantly better or worse than that of a column.

    Args:
        found: What `comparisons` returns for two runs or more.
    """
    cells = {one.names: _verdict(one) for one in found}
    planners = list(dict.fromkeys(name for names in cells for name in names))
    rows = [[row, *(cells.get((column, row), "") for column in planners[:-1])] for row in planners[1:]]
    return Grid("pairs", ["significantly better or worse than", *planners[:-1]], rows, found)


def _verdict(found: Comparison) -> str:
    """In which metrics the second of two planners is better or worse."""
    titles: dict[int, list[str]] = {1: [], -1: []}
    for name, row in found.rows.items():
        info = info_of(name)
        if row.is_significant and info.sign:
            titles[info.sign * (1 if row.difference.mean > 0.0 else -1)].append(info.title)
    words = [f"{how}: {', '.join(titles[sign])}" for how, sign in (("better", 1), ("worse", -1)) if titles[sign]]
    few = f" ({found.both_solved} solved by both)" if found.both_solved < LEAST_SHARED else ""
    return ("; ".join(words) or "no significant difference") + few
