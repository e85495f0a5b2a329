"""The table of cases and planners: who fails where."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Shaped

from crowdbench.boards.site.rows import is_measured
from crowdbench.boards.site.texts import NOTHING
from crowdbench.boards.standings import Standing, Standings

MOST = 80
"""The most cases that are shown: those in which most entries fail."""

SUCCESS, COLLISION, TIMEOUT, UNDRIVEN = "", "C", "T", NOTHING


@dataclass(frozen=True)
class CaseTable:
    """Cases in which somebody failed.

    Attributes:
        is_measured: Whether the cases are those of the season; otherwise they are the public ones.
        groups: The scenarios with how many of their cases are shown.
        cases: The numbers of the cases shown.
        rows: The entries, each with its outcome in each case.
        failed: In how many cases somebody failed.
        total: How many cases there are.
        by_all: In how many cases all failed.
    """

    is_measured: bool
    groups: Sequence[tuple[str, int]]
    cases: Sequence[int]
    rows: Sequence[tuple[Standing, Sequence[str]]]
    failed: int
    total: int
    by_all: int


def case_table(found: Standings) -> CaseTable | None:
    """The cases in which somebody failed; None without entries.

    Entries of other rules, and those that drove fewer cases, are left out. Where nobody was measured in the season, the
    cases are the public ones.

    Args:
        found: The standings of the board.
    """
    board = found.board
    everybody = [*found.ranked, *(one for one in found.others if one.entry.spec.board_digest == board.digest)]
    measured = [one for one in everybody if is_measured(one)]
    entries = measured or everybody
    if not entries:
        return None
    per_scenario = board.spec.cases if measured else board.spec.public_cases
    total = per_scenario * len(board.scenarios)
    entries = [one for one in entries if one.cases == per_scenario]
    if not entries:
        return None
    outcomes = np.array([_outcomes(one) for one in entries])
    failures = (outcomes != SUCCESS).sum(axis=0)
    hardest = np.argsort(-failures, kind="stable")[: min(MOST, int((failures > 0).sum()))]
    shown = sorted(hardest.tolist(), key=lambda i: (i // per_scenario, -failures[i], i))
    names = [scenario.name for scenario in board.scenarios]
    return CaseTable(
        is_measured=bool(measured),
        groups=[(names[i], len(list(g))) for i, g in itertools.groupby(shown, lambda case: case // per_scenario)],
        cases=[i % per_scenario for i in shown],
        rows=[(one, row) for one, row in zip(entries, outcomes[:, shown].tolist(), strict=True)],
        failed=int((failures > 0).sum()),
        total=total,
        by_all=int((failures == len(entries)).sum()),
    )


def _outcomes(one: Standing) -> Shaped[np.ndarray, "case"]:
    """The letter of the outcome of each case."""
    columns = {name: values.ravel() for name, values in one.columns.items()}
    return np.select(
        [columns["success_rate"] == 1.0, columns["collision_rate"] == 1.0, columns["timeout_rate"] == 1.0],
        [SUCCESS, COLLISION, TIMEOUT],
        UNDRIVEN,
    )
