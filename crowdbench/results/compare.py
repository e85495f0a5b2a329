"""Runs of the same cases, compared case by case, in one scenario or in several."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.core.types import Outcome
from crowdbench.metrics.registry import MAIN, info_of
from crowdbench.results.episodes import EPISODES
from crowdbench.results.paired import LEAST_SHARED, MetricDifference, Paired, compare_metric, holm
from crowdbench.results.run_result import RunResult
from crowdbench.scenario.cases import Cases
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid, flatten, markdown

DIFFERENCE = "difference (95 % interval)"
"""Heading of a column."""

SIGNIFICANT = " *"
"""Mark of a significant difference."""

CASES = (
    "n: the number of cases of a row. Rates (p: McNemar's exact test) and metrics that include failures are over all "
    "shared cases in which they are defined, the others over the cases that both runs solve. Intervals are of the "
    "paired difference, and go with p."
)
MARKED = "Marked with *: significant, by p < 0.05, or without p by an interval that excludes 0."
CORRECTED = (
    "p corrected: for the number of tests of a metric (Holm 1979), separately for all scenarios together. The mark "
    "goes by it."
)
NO_INTERVAL = (
    f"No interval: fewer than {LEAST_SHARED} independent cases of a scenario, in which a difference of the same sign "
    "in every case is likely by chance."
)

POOLED_SCENARIOS = "all {} scenarios"
"""Name of several scenarios that are pooled in one comparison."""


@dataclass(frozen=True, repr=False)
class Comparison:
    """Result of `compare`.

    Attributes:
        scenario: The name of the scenario, or `POOLED_SCENARIOS`.
        names: Names of the runs A and B.
        cases: The number of cases that both runs contain. Rates, and means that count failures, are over these.
        both_solved: The number of cases that both have solved. Other means are over these.
        rows: The comparison of each metric, by name.
        changed: Case, outcome in A and outcome in B, of every case in which the outcomes differ; None for several
            scenarios.
        warnings: Reasons why the runs may not be comparable, a sentence each.
        shared: The cases that both runs contain, such as `test:0:500`.
    """

    scenario: str
    names: tuple[str, str]
    cases: int
    both_solved: int
    rows: dict[str, MetricDifference]
    changed: list[tuple[int, int, int]] | None
    warnings: list[str]
    shared: str

    def list_changed_cases(self) -> list[str]:
        """Return a line with the cases for each pair of different outcomes; none for several scenarios."""
        groups: dict[tuple[int, int], list[int]] = {}
        for case, a, b in self.changed or []:
            groups.setdefault((a, b), []).append(case)
        lines = []
        for outcomes, cases in sorted(groups.items()):
            labels = (f"{name} {Outcome(code).label}" for name, code in zip(self.names, outcomes, strict=True))
            lines.append(f"{', '.join(labels)} ({len(cases)}): {', '.join(map(str, cases))}")
        return lines or ([] if self.changed is None else [f"no case ends differently in {self.names[1]}"])

    def _repr_markdown_(self) -> str:
        """Return the Markdown that Jupyter shows."""
        return repr(self)

    def __repr__(self) -> str:
        """Return a table with the metrics of both runs, and their differences."""
        grid = comparison_grid([self])
        return f"{grid.title}\n\n{markdown(grid.header, grid.rows)}\n\n{grid.note}"


def compare(a: Path, b: Path) -> Comparison:
    """Compare two runs, case by case.

    Args:
        a: The directory of run A.
        b: The directory of run B.

    Raises:
        InputError: A file is not the one that its run wrote, or the runs have different scenarios or no case in common.
    """
    return compare_results(RunResult.read(a, tables_only=True), RunResult.read(b, tables_only=True))


def compare_to(reference: Path, others: Sequence[Path]) -> list[Comparison]:
    """Compare runs with a reference run, case by case, in each scenario and over all scenarios.

    With several scenarios, each run is compared with the run of the reference planner in the same scenario. Results
    over all scenarios, with equal weights, come last. The p-values of a metric are corrected for multiple testing,
    separately for single scenarios and for results over all scenarios.

    Args:
        reference: The directory of the reference run.
        others: The directories of the other runs.

    Raises:
        InputError: As in `compare`; or, with several scenarios, a planner has no run, or two runs, in one of them.
    """
    runs = [RunResult.read(run, tables_only=True) for run in (reference, *others)]
    if len(runs) == 2 or len(set(map(_scenario, runs))) == 1:
        return correct([compare_results(runs[0], run) for run in runs[1:]])
    by_scenario = _group(runs)
    single = [compare_results(of_scenario[0], run) for of_scenario in by_scenario for run in of_scenario[1:]]
    pooled = []
    first, *planners = zip(*by_scenario, strict=True)
    for of_planner in planners:
        strata = list(map(_pair, first, of_planner))
        names = first[0].label, of_planner[0].label
        pooled.append(_summarize(POOLED_SCENARIOS.format(len(strata)), names, strata, []))
    return [*correct(single), *correct(pooled)]


def comparison_grid(comparisons: Sequence[Comparison], metrics: Sequence[str] = ()) -> Grid:
    """Return a table of runs and their reference run, with a row for each metric, scenario and run.

    Args:
        comparisons: The return value of `compare_to`.
        metrics: Names of metrics. If empty: all shared metrics of two runs, or the metrics in `MAIN` for more runs.

    Raises:
        InputError: A run has no such metric.
    """
    first, single = comparisons[0], len(comparisons) == 1
    shared = [name for name in first.rows if all(name in comparison.rows for comparison in comparisons)]
    if lacking := [name for name in metrics if name not in shared]:
        raise InputError(f"not all runs have a metric {lacking[0]}; they have {', '.join(shared)}")
    main = [name for name in MAIN if name in shared]
    chosen = [name for name in shared if first.rows[name].difference.n] if single else main
    a, b = first.names if single else (first.names[0], "the run")
    if single:
        labels = []
        title = f"{a} and {b}: {first.cases} shared cases ({first.shared}), {first.both_solved} solved by both"
    else:
        labels = ["scenario", "run"] if len({comparison.scenario for comparison in comparisons}) > 1 else ["run"]
        cases = ", ".join(dict.fromkeys(f"{comparison.cases} ({comparison.shared})" for comparison in comparisons))
        title = f"Compared with {a}; shared cases: {cases}"
    rows, records = [], []
    for name, comparison in itertools.product(metrics or chosen, comparisons):
        row, info = comparison.rows[name], info_of(name, first.rows[name].p is not None)
        record = {"metric": name, "scenario": comparison.scenario, "reference": a, "run": comparison.names[1]}
        tests = ["" if p is None else f"{p:.2g}" for p in ([row.p] if single else [row.p, row.corrected])]
        difference = info.estimate(row.difference) + SIGNIFICANT * row.is_significant
        values = [info.number(row.a), info.number(row.b), difference, *tests, str(row.difference.n)]
        rows.append([info.heading, *(record[label] for label in labels), *values])
        facts = {"n": row.difference.n, "significant": row.is_significant}
        records.append({**record, "cases": comparison.cases, **vars(row), **facts})
    header = ["metric", *labels, a, b, DIFFERENCE, "p", *([] if single else ["p corrected"]), "n"]
    align = ("l" * (1 + len(labels))).ljust(len(header), "r")
    has_short = any(record["n"] and math.isnan(record["difference"].low) for record in records)
    notes = [CASES, MARKED, "" if single else CORRECTED, NO_INTERVAL * has_short]
    return Grid(title, header, rows, records, align, "\n".join(filter(None, notes)))


def _scenario(run: RunResult) -> str:
    return str(run.result["run"]["scenario"])


def _group(runs: Sequence[RunResult]) -> list[list[RunResult]]:
    """Return the runs of each scenario, planners in the order of `runs`. Raises InputError, see `compare_to`."""
    labels = list(dict.fromkeys(run.label for run in runs))
    groups: dict[str, dict[str, RunResult]] = {}
    for run in runs:
        of_scenario = groups.setdefault(_scenario(run), {})
        if run.label in of_scenario:
            both = f"{of_scenario[run.label].directory} and {run.directory}"
            raise InputError(f"{both} are both of {run.label} in {run.result['scenario']['name']}: give one of them")
        of_scenario[run.label] = run
    for of_scenario in groups.values():
        if missing := [label for label in labels if label not in of_scenario]:
            name = next(iter(of_scenario.values())).result["scenario"]["name"]
            raise InputError(
                f"there is no run of {missing[0]} in {name}: give a run of each planner in each of the scenarios"
            )
    return [[of_scenario[label] for label in labels] for of_scenario in groups.values()]


def correct(comparisons: list[Comparison]) -> list[Comparison]:
    """Correct the p-values of each metric for the number of tests (`holm`), and return the comparisons."""
    for name in dict.fromkeys(name for comparison in comparisons for name in comparison.rows):
        tables = [comparison.rows for comparison in comparisons if name in comparison.rows]
        tested = [rows for rows in tables if rows[name].p is not None]
        corrected = holm(np.array([rows[name].p for rows in tested], float))
        for rows, p in zip(tested, corrected.tolist(), strict=True):
            rows[name] = dataclasses.replace(rows[name], corrected=p)
    return comparisons


def _pair(a: RunResult, b: RunResult) -> Paired:
    check_comparable(a, b)
    _, *rows = np.intersect1d(a.episodes.key, b.episodes.key, return_indices=True)
    if len(rows[0]) == 0:
        raise InputError(f"{a.directory} ({a.cases}) and {b.directory} ({b.cases}) share no case to compare")
    shared = Cases(a.cases.split, max(a.cases.start, b.cases.start), min(a.cases.stop, b.cases.stop))
    return Paired(a.episodes.take(rows[0]), b.episodes.take(rows[1]), str(shared))


def compare_results(
    a: RunResult, b: RunResult, metrics: Sequence[str] = (), names: tuple[str, str] | None = None
) -> Comparison:
    """Compare two runs in the named metrics, or in all metrics. Raises InputError as `compare` does.

    Args:
        metrics: Names of metrics; all metrics if empty.
        names: Names of the runs; None for their planners, or their directories if these are the same.
    """
    if names is None:
        names = (a.label, b.label) if a.label != b.label else (str(a.directory), str(b.directory))
    return _summarize(a.result["scenario"]["name"], names, [_pair(a, b)], [*a.warnings, *b.warnings], metrics)


def _summarize(
    scenario: str, names: tuple[str, str], strata: Sequence[Paired], warnings: list[str], chosen: Sequence[str] = ()
) -> Comparison:
    """Compare two planners over scenarios (the strata), in the chosen metrics or in all."""
    first, tables = strata[0], [table.columns for pair in strata for table in (pair.a, pair.b)]
    metrics = [name for name in chosen or first.a.columns if all(name in columns for columns in tables)]
    changed = None
    if len(strata) == 1:
        outcomes = zip(first.a.case.tolist(), first.a.outcome.tolist(), first.b.outcome.tolist(), strict=True)
        changed = [(case, a, b) for case, a, b in outcomes if a != b]
    return Comparison(
        scenario=scenario,
        names=names,
        shared=", ".join(dict.fromkeys(pair.cases for pair in strata)),
        cases=sum(len(pair.a) for pair in strata),
        both_solved=sum(int(pair.solved.sum()) for pair in strata),
        rows={name: compare_metric(name, strata) for name in metrics},
        changed=changed,
        warnings=warnings,
    )


def check_comparable(a: RunResult, b: RunResult) -> None:
    """Raise InputError if two runs have different scenarios or splits, or if one of them has no success rate."""
    if _scenario(a) != _scenario(b):
        tables = [{key: repr(value) for key, value in flatten(run.result["scenario"]).items()} for run in (a, b)]
        keys = dict.fromkeys(key for key, _ in sorted(tables[0].items() ^ tables[1].items()) if key != "description")
        names = [run.result["scenario"]["name"] for run in (a, b)]
        different = f"{names[0]} and {names[1]}" if names[0] != names[1] else f"in {', '.join(keys)}"
        raise InputError(
            f"{a.directory} and {b.directory} are runs of different scenarios, {different}: "
            "run both planners on the same one"
        )
    if a.cases.split != b.cases.split:
        raise InputError(
            f"{a.directory} has {a.cases.split} cases and {b.directory} has {b.cases.split} cases: "
            "run both planners on the same cases"
        )
    for run in (a, b):
        if "success_rate" not in run.episodes.columns:
            raise InputError(f"{run.directory / EPISODES} has no column success_rate, so that it cannot be compared")
