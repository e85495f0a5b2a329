"""Two runs of the same cases, compared case by case."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.metrics import OVER_ALL, POOLED, heading, is_rate
from crowdbench.metrics.summary import (
    NOTHING,
    RESAMPLES,
    Estimate,
    around,
    bootstrap_distribution,
    by_block,
    interval,
    weighted_mean,
)
from crowdbench.runs.manifest import no_manifest
from crowdbench.runs.results import EPISODES, Episodes
from crowdbench.runs.store import RunResult
from crowdbench.scenario.digest import compute_digest
from crowdbench.utils.errors import InputError
from crowdbench.utils.tables import flatten, markdown

EXACT = 12
"""Blocks of cases for which the test of two rates tries all ways to exchange the runs."""


@dataclass(frozen=True)
class MetricDifference:
    """One metric in two runs.

    Attributes:
        a: Its mean in run A.
        b: Its mean in run B.
        difference: B - A, paired by case.
        p: McNemar's p-value of rates, or that of `sign_test` where cases come in blocks; None for other metrics.
    """

    a: float
    b: float
    difference: Estimate
    p: float | None


@dataclass(frozen=True)
class Comparison:
    """What `compare` found.

    Attributes:
        names: What the runs A and B are called.
        cases: The number of cases that both have driven. Rates, and means that count failures, are over these.
        both_solved: The number of cases that both have solved. Other means are over these.
        rows: The metrics, by name.
        changed: Case, outcome in A and outcome in B, of every case in which the outcomes differ.
        doubts: Sentences on what speaks against comparing them.
    """

    names: tuple[str, str]
    cases: int
    both_solved: int
    rows: dict[str, MetricDifference]
    changed: list[tuple[int, int, int]]
    doubts: list[str]

    def _repr_markdown_(self) -> str:
        """What Jupyter shows: the metrics of both, and how they differ."""
        rows = []
        for name, row in self.rows.items():
            if row.difference.n:
                factor, digits = (1.0, 3) if row.p is None else (100.0, 1)
                found = row.a, row.b, row.difference.mean, row.difference.low, row.difference.high
                a, b, mean, low, high = (f"{factor * value:.{digits}f}" for value in found)
                p = "" if row.p is None else f"{row.p:.2g}"
                rows.append([heading(name, row.p is not None), a, b, mean, f"{low} to {high}", p])
        header = ["metric", *self.names, "difference", "95 % interval", "p"]
        return f"{self.cases} shared cases, {self.both_solved} solved by both\n\n{markdown(header, rows)}"


def compare(a: Path, b: Path) -> Comparison:
    """Compare two runs, case by case.

    Args:
        a: The directory of run A.
        b: The directory of run B.

    Raises:
        InputError: One of them is not as its run wrote it, they are not runs of the same scenario, or share no case.
    """
    runs = RunResult.read(a), RunResult.read(b)
    _check_comparable(*runs)
    _, *rows = np.intersect1d(runs[0].episodes.case, runs[1].episodes.case, return_indices=True)
    if len(rows[0]) == 0:
        raise InputError(f"{a} ({runs[0].cases}) and {b} ({runs[1].cases}) share no case to compare")
    one, two = (run.episodes.take(own) for run, own in zip(runs, rows, strict=True))
    solved = one.columns["success_rate"] & two.columns["success_rate"]
    differ = one.outcome != two.outcome
    labels = runs[0].label, runs[1].label
    return Comparison(
        names=labels if labels[0] != labels[1] else (str(a), str(b)),
        cases=len(one),
        both_solved=int(solved.sum()),
        rows={name: _difference(name, one, two, solved) for name in one.columns if name in two.columns},
        changed=list(zip(*(table[differ].tolist() for table in (one.case, one.outcome, two.outcome)), strict=True)),
        doubts=_doubts(runs),
    )


def compare_to(reference: Path, others: Sequence[Path]) -> list[Comparison]:
    """Compare runs with one of them, case by case. The p-values of a metric are corrected for their number (`holm`).

    Args:
        reference: The directory of the run that the others are compared with.
        others: The directories of the others.

    Raises:
        InputError: As `compare` raises it.
    """
    found = [compare(reference, other) for other in others]
    for name in dict.fromkeys(name for one in found for name in one.rows):
        tested = [one.rows for one in found if name in one.rows and one.rows[name].p is not None]
        corrected = holm(np.array([rows[name].p for rows in tested], float))
        for rows, p in zip(tested, corrected.tolist(), strict=True):
            rows[name] = dataclasses.replace(rows[name], p=p)
    return found


def _doubts(runs: Sequence[RunResult]) -> list[str]:
    doubts = [no_manifest(run.directory) for run in runs if not run.manifest]
    doubts += [
        f"{run.directory} was interrupted: only the cases that it finished are compared"
        for run in runs
        if run.manifest.get("interrupted")
    ]
    if len({run.manifest["code"] for run in runs if run.manifest}) > 1:
        both = " and ".join(str(run.directory) for run in runs)
        doubts.append(f"{both} were made by different code of crowdbench, which may be what makes them differ")
    return doubts


def _difference(name: str, one: Episodes, two: Episodes, solved: Bool[np.ndarray, "case"]) -> MetricDifference:
    """Compare a metric over all cases where it is a rate or counts failures, otherwise over those that both solve."""
    x, y = one.columns[name], two.columns[name]
    is_share, p = is_rate(x) and is_rate(y), None
    if is_share:
        p = mcnemar(x, y) if one.block is None else sign_test(x, y, one.block)
    chosen = ~np.isnan(x.astype(float) + y) & (solved | is_share | (name in OVER_ALL))
    if not chosen.any():
        return MetricDifference(math.nan, math.nan, NOTHING, p)
    x, y = x[chosen].astype(float), y[chosen].astype(float)
    weights = [table.steps[chosen] * 1.0 if name in POOLED else np.ones(len(x)) for table in (one, two)]
    a, b = float(weighted_mean(x, weights[0])), float(weighted_mean(y, weights[1]))
    block = None if one.block is None else one.block[chosen]
    columns = *by_block(x, weights[0], block), *by_block(y, weights[1], block)
    low, high = around(b - a, *interval(bootstrap_distribution(_mean_difference, *columns)))
    return MetricDifference(a, b, Estimate(b - a, low, high, len(x), float((y - x).max())), p)


def _mean_difference(*columns: Float[np.ndarray, "*resample case"], axis: int = -1) -> Float[np.ndarray, "*resample"]:
    """The weighted mean of run B minus that of run A; the columns are values and weights of A, then of B."""
    x, x_weights, y, y_weights = columns
    return np.asarray(weighted_mean(y, y_weights, axis) - weighted_mean(x, x_weights, axis))


def mcnemar(a: Bool[np.ndarray, "case"], b: Bool[np.ndarray, "case"]) -> float:
    """The exact two-sided p-value of the test of McNemar (1947); 1 if no case differs.

    Args:
        a: Whether each case was solved in run A.
        b: The same in run B.
    """
    from scipy.stats import binomtest

    only_a, only_b = int((a & ~b).sum()), int((b & ~a).sum())
    return float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0


def holm(p: Float[np.ndarray, "test"]) -> Float[np.ndarray, "test"]:
    """The p-values corrected by Holm (1979) for the number of tests.

    Those below 0.05 are significant: with a probability of 0.95 or more, none of them is where there is no difference.
    """
    order = np.argsort(p, kind="stable")
    factors = len(p) - np.arange(len(p))
    corrected = np.empty_like(p)
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return corrected


def sign_test(a: Bool[np.ndarray, "case"], b: Bool[np.ndarray, "case"], block: Int[np.ndarray, "case"]) -> float:
    """The two-sided p-value of a permutation test (Fisher 1935) that exchanges the runs block by block.

    It is exact for up to `EXACT` blocks, and from `RESAMPLES` random exchanges for more.

    Args:
        a: Whether each case was solved in run A.
        b: The same in run B.
        block: The block of each case; those of the same block are not independent.
    """
    _, number = np.unique(block, return_inverse=True)
    sums = np.bincount(number, b.astype(float) - a)
    sums = sums[sums != 0.0]
    if len(sums) <= EXACT:
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(sums))))
    else:
        signs = np.random.default_rng(0).choice((-1.0, 1.0), (RESAMPLES, len(sums)))
    return float((np.abs(signs @ sums) >= abs(sums.sum()) - 1e-9).mean())


def _check_comparable(one: RunResult, two: RunResult) -> None:
    """Raise InputError where two runs are not of the same scenario and split, or do not say what was solved."""
    a, b = one.directory, two.directory
    scenarios = one.result["scenario"], two.result["scenario"]
    # Computed again, because results of earlier versions hold digests that were computed otherwise.
    if compute_digest(scenarios[0]) != compute_digest(scenarios[1]):
        tables = [{key: repr(value) for key, value in flatten(scenario).items()} for scenario in scenarios]
        keys = sorted(tables[0].items() ^ tables[1].items())
        differ = ", ".join(dict.fromkeys(key for key, _ in keys if key not in ("digest", "description")))
        raise InputError(f"{a} and {b} are runs of different scenarios, in {differ}: run both planners on the same one")
    splits = one.cases.split, two.cases.split
    if splits[0] != splits[1]:
        raise InputError(
            f"{a} has {splits[0]} cases and {b} has {splits[1]} cases: run both planners on the same cases"
        )
    for run in (one, two):
        if "success_rate" not in run.episodes.columns:
            raise InputError(f"{run.directory / EPISODES} has no column success_rate, so that it cannot be compared")
