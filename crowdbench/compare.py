"""Two runs of the same cases, side by side and paired by case."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from crowdbench.errors import InputError
from crowdbench.results import EPISODES, Episodes, read_result
from crowdbench.summary import Estimate, bootstrap


@dataclass(frozen=True)
class Row:
    """One metric in both runs, the difference B - A paired by case, and for rates McNemar's p-value."""

    a: float
    b: float
    difference: Estimate
    p: float | None


@dataclass(frozen=True)
class Comparison:
    """What `compare` found. Rates are over all shared `cases`, everything else over those `both_solved`.

    `changed` has case, outcome in A and outcome in B of every case in which they differ.
    """

    names: tuple[str, str]
    cases: int
    both_solved: int
    rows: dict[str, Row]
    changed: list[tuple[int, int, int]]


def compare(a: Path, b: Path) -> Comparison:
    """Compare two directories of runs, case by case.

    Raises InputError where they are not runs of the same scenario, or share no case.
    """
    results = read_result(a), read_result(b)
    _same(results, a, b)
    tables = Episodes.read(a / EPISODES), Episodes.read(b / EPISODES)
    _, rows_a, rows_b = np.intersect1d(tables[0].case, tables[1].case, return_indices=True)
    if len(rows_a) == 0:
        raise InputError(f"{a} ({results[0]['cases']}) and {b} ({results[1]['cases']}) share no case to compare")
    one, two = tables[0].take(rows_a), tables[1].take(rows_b)
    solved = one.columns["success_rate"] & two.columns["success_rate"]
    rows = {}
    for name in one.columns.keys() & two.columns.keys():
        x, y = one.columns[name], two.columns[name]
        rate = x.dtype == bool
        if not rate:
            x, y = x[solved], y[solved]
        difference = bootstrap(y.astype(float) - x, np.ones(len(x)))
        both = ~np.isnan(x.astype(float) + y)
        means = (float(x[both].mean()), float(y[both].mean())) if both.any() else (np.nan, np.nan)
        rows[name] = Row(*means, difference, mcnemar(x, y) if rate else None)
    differ = one.outcome != two.outcome
    return Comparison(
        names=(_name(results[0]), _name(results[1])),
        cases=len(one),
        both_solved=int(solved.sum()),
        rows={name: rows[name] for name in one.columns if name in rows},
        changed=list(zip(*(table[differ].tolist() for table in (one.case, one.outcome, two.outcome)), strict=True)),
    )


def mcnemar(a: Bool[np.ndarray, "case"], b: Bool[np.ndarray, "case"]) -> float:
    """The exact two-sided p-value of McNemar's test: 1 where no case differs."""
    from scipy.stats import binomtest

    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def _same(results: tuple[dict[str, Any], dict[str, Any]], a: Path, b: Path) -> None:
    (one, two), scenarios = results, [result["scenario"] for result in results]
    if scenarios[0]["digest"] != scenarios[1]["digest"]:
        names = " and ".join(f"{scenario['name']} ({scenario['digest']})" for scenario in scenarios)
        raise InputError(f"{a} and {b} are runs of different scenarios, {names}: run both planners on the same one")
    splits = [result["cases"].partition(":")[0] for result in (one, two)]
    if splits[0] != splits[1]:
        raise InputError(
            f"{a} has {splits[0]} cases and {b} has {splits[1]} cases: run both planners on the same cases"
        )


def _name(result: dict[str, Any]) -> str:
    options = ", ".join(f"{key}={value}" for key, value in result.get("options", {}).items())
    return f"{result['planner']} ({options})" if options else str(result["planner"])
