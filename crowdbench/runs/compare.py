"""Runs of the same cases, compared case by case, in one scenario or in several."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench.core.types import Outcome
from crowdbench.metrics import MAIN, info_of
from crowdbench.runs.paired import MetricDifference, Paired, compare_metric, holm
from crowdbench.runs.results import EPISODES
from crowdbench.runs.store import RunResult
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import Grid, flatten, markdown

POOLED_SCENARIOS = "all {} scenarios"
"""What the scenarios of several runs are called together."""


@dataclass(frozen=True, repr=False)
class Comparison:
    """What `compare` found.

    Attributes:
        scenario: The name of the scenario, or `POOLED_SCENARIOS`.
        names: What the runs A and B are called.
        cases: The number of cases that both have driven. Rates, and means that count failures, are over these.
        both_solved: The number of cases that both have solved. Other means are over these.
        rows: The metrics, by name.
        changed: Case, outcome in A and outcome in B, of every case in which the outcomes differ; None for several
            scenarios.
        warnings: Reasons against comparing them, a sentence each.
    """

    scenario: str
    names: tuple[str, str]
    cases: int
    both_solved: int
    rows: dict[str, MetricDifference]
    changed: list[tuple[int, int, int]] | None
    warnings: list[str]

    def list_changed_cases(self) -> list[str]:
        """Return a line with the cases for each pair of different outcomes; none for several scenarios."""
        groups: dict[tuple[int, int], list[int]] = {}
        for case, *ends in self.changed or []:
            groups.setdefault((ends[0], ends[1]), []).append(case)
        lines = []
        for outcomes, cases in sorted(groups.items()):
            labels = (f"{name} {Outcome(end).label}" for name, end in zip(self.names, outcomes, strict=True))
            lines.append(f"{', '.join(labels)} ({len(cases)}): {', '.join(map(str, cases))}")
        return lines or ([] if self.changed is None else [f"no case ends differently in {self.names[1]}"])

    def _repr_markdown_(self) -> str:
        """What Jupyter shows."""
        return repr(self)

    def __repr__(self) -> str:
        """The metrics of both, and how they differ."""
        grid = comparison_grid([self])
        return f"{grid.title}\n\n{markdown(grid.header, grid.rows)}"


def compare(a: Path, b: Path) -> Comparison:
    """Compare two runs, case by case.

    Args:
        a: The directory of run A.
        b: The directory of run B.

    Raises:
        InputError: One of them is not as its run wrote it, they are not runs of the same scenario, or share no case.
    """
    return compare_results(RunResult.read(a), RunResult.read(b))


def compare_to(reference: Path, others: Sequence[Path]) -> list[Comparison]:
    """Compare runs with one of them, case by case, in each scenario and in all together.

    Where runs are of several scenarios, each is compared with that of the planner of `reference` in the same one. What
    is found in all scenarios, which count alike, comes last. The p-values of a metric are corrected for their number:
    those of single scenarios together, and those of all scenarios together.

    Args:
        reference: The directory of the run that the others are compared with.
        others: The directories of the others.

    Raises:
        InputError: As `compare` raises it; or, where there are several scenarios, a planner has no run in one of them,
            or two.
    """
    first, *rest = [RunResult.read(directory) for directory in (reference, *others)]
    if len(rest) == 1 or len({_scenario(run) for run in (first, *rest)}) == 1:
        return _correct([compare_results(first, run) for run in rest])
    by_scenario = _group(first, rest)
    pairs = [(runs[0], run) for runs in by_scenario for run in runs[1:]]
    found = [compare_results(*pair) for pair in pairs]
    pooled = []
    for label in dict.fromkeys(run.label for _, run in pairs):
        strata = [_shared(*pair) for pair in pairs if pair[1].label == label]
        pooled.append(_summarize(POOLED_SCENARIOS.format(len(strata)), (first.label, label), strata, []))
    return [*_correct(found), *_correct(pooled)]


def comparison_grid(found: Sequence[Comparison], metrics: Sequence[str] = ()) -> Grid:
    """Return runs beside the one that each was compared with: a row for each metric, scenario and run.

    Args:
        found: What `compare_to` returns.
        metrics: Names of metrics; none for all that two runs have, and for those in `MAIN` of more runs.

    Raises:
        InputError: A run has no such metric.
    """
    first, single = found[0], len(found) == 1
    shared = [name for name in first.rows if all(name in one.rows for one in found)]
    if lacking := [name for name in metrics if name not in shared]:
        raise InputError(f"not all runs have a metric {lacking[0]}; they have {', '.join(shared)}")
    main = [name for name in MAIN if name in shared]
    chosen = [name for name in shared if first.rows[name].difference.n] if single else main
    rows, records = [], []
    for name, one in itertools.product(metrics or chosen, found):
        row, info = one.rows[name], info_of(name, first.rows[name].p is not None)
        tests = ["" if p is None else f"{p:.2g}" for p in (row.p, row.corrected)]
        values = [info.number(row.a), info.number(row.b), info.estimate(row.difference), *tests]
        rows.append([info.heading, one.scenario, one.names[1], *values])
        about = {"metric": name, "scenario": one.scenario, "reference": one.names[0], "run": one.names[1]}
        records.append({**about, "cases": one.cases, **vars(row)})
    several = len({one.scenario for one in found}) > 1
    b = first.names[1] if single else "the run"
    header = ["metric", "scenario", "run", first.names[0], b, "difference (95 % interval)", "p", "p corrected"]
    hidden = {1: not several, 2: single, 7: single}
    shown = [number for number in range(len(header)) if not hidden.get(number)]
    if single:
        title = f"{first.names[0]} and {b}: {first.cases} shared cases, {first.both_solved} solved by both"
    else:
        cases = ", ".join(dict.fromkeys(str(one.cases) for one in found))
        title = f"Compared with {first.names[0]}: {cases} shared cases"
    align = "".join("l" if number < 3 else "r" for number in shown)
    return Grid(title, [header[n] for n in shown], [[row[n] for n in shown] for row in rows], records, align)


def _scenario(run: RunResult) -> str:
    return str(run.result["run"]["scenario"])


def _group(first: RunResult, rest: Sequence[RunResult]) -> list[list[RunResult]]:
    """The runs of each scenario, that of the planner of `first` first. Raises InputError, see `compare_to`."""
    labels = list(dict.fromkeys(run.label for run in (first, *rest)))
    found: dict[str, dict[str, RunResult]] = {}
    for run in (first, *rest):
        of_scenario = found.setdefault(_scenario(run), {})
        if run.label in of_scenario:
            both = f"{of_scenario[run.label].directory} and {run.directory}"
            raise InputError(f"{both} are both of {run.label} in {run.result['scenario']['name']}: give one of them")
        of_scenario[run.label] = run
    for runs in found.values():
        if missing := [label for label in labels if label not in runs]:
            name = next(iter(runs.values())).result["scenario"]["name"]
            raise InputError(
                f"there is no run of {missing[0]} in {name}: give a run of each planner in each of the scenarios"
            )
    return [[runs[label] for label in labels] for runs in found.values()]


def _correct(found: Sequence[Comparison]) -> list[Comparison]:
    """What was found, with the p-values of each metric corrected for their number."""
    for name in dict.fromkeys(name for one in found for name in one.rows):
        tested = [one.rows for one in found if name in one.rows and one.rows[name].p is not None]
        corrected = holm(np.array([rows[name].p for rows in tested], float))
        for rows, p in zip(tested, corrected.tolist(), strict=True):
            rows[name] = dataclasses.replace(rows[name], corrected=p)
    return list(found)


def _shared(a: RunResult, b: RunResult) -> Paired:
    check_comparable(a, b)
    _, *rows = np.intersect1d(a.episodes.case, b.episodes.case, return_indices=True)
    if len(rows[0]) == 0:
        raise InputError(f"{a.directory} ({a.cases}) and {b.directory} ({b.cases}) share no case to compare")
    one, two = a.episodes.take(rows[0]), b.episodes.take(rows[1])
    return Paired(one, two, one.columns["success_rate"] & two.columns["success_rate"])


def compare_results(a: RunResult, b: RunResult, metrics: Sequence[str] | None = None) -> Comparison:
    """Compare two runs in metrics, all where none are named. Raises InputError as `compare` does."""
    names = (a.label, b.label) if a.label != b.label else (str(a.directory), str(b.directory))
    return _summarize(a.result["scenario"]["name"], names, [_shared(a, b)], _warnings((a, b)), metrics)


def _summarize(
    scenario: str,
    names: tuple[str, str],
    strata: Sequence[Paired],
    warnings: list[str],
    chosen: Sequence[str] | None = None,
) -> Comparison:
    """Compare two planners in scenarios, the strata, by the chosen metrics or by all."""
    wanted = strata[0].one.columns if chosen is None else chosen
    metrics = [
        name for name in wanted if all(name in table.columns for pair in strata for table in (pair.one, pair.two))
    ]
    changed = None
    if len(strata) == 1:
        one, two = strata[0].one, strata[0].two
        differ = one.outcome != two.outcome
        changed = list(zip(*(table[differ].tolist() for table in (one.case, one.outcome, two.outcome)), strict=True))
    return Comparison(
        scenario=scenario,
        names=names,
        cases=sum(len(each.one) for each in strata),
        both_solved=sum(int(each.solved.sum()) for each in strata),
        rows={name: compare_metric(name, strata) for name in metrics},
        changed=changed,
        warnings=warnings,
    )


def _warnings(runs: Sequence[RunResult]) -> list[str]:
    warnings = [
        f"{run.directory} was interrupted: only the cases that it finished are compared"
        for run in runs
        if run.result["interrupted"]
    ]
    if len({run.result["run"]["code"] for run in runs}) > 1:
        both = " and ".join(str(run.directory) for run in runs)
        warnings.append(f"{both} were made by different code of crowdbench, which may be what makes them differ")
    return warnings


def check_comparable(one: RunResult, two: RunResult) -> None:
    """Raise InputError where two runs are not of the same scenario and split, or do not say what was solved."""
    a, b = one.directory, two.directory
    scenarios = one.result["scenario"], two.result["scenario"]
    if _scenario(one) != _scenario(two):
        tables = [{key: repr(value) for key, value in flatten(scenario).items()} for scenario in scenarios]
        keys = sorted(tables[0].items() ^ tables[1].items())
        differ = ", ".join(dict.fromkeys(key for key, _ in keys if key != "description"))
        raise InputError(f"{a} and {b} are runs of different scenarios, in {differ}: run both planners on the same one")
    splits = one.cases.split, two.cases.split
    if splits[0] != splits[1]:
        raise InputError(
            f"{a} has {splits[0]} cases and {b} has {splits[1]} cases: run both planners on the same cases"
        )
    for run in (one, two):
        if "success_rate" not in run.episodes.columns:
            raise InputError(f"{run.directory / EPISODES} has no column success_rate, so that it cannot be compared")
