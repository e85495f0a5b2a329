"""Tables of the pages: tags, tests of pairs, and failures by case."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int

from crowdbench import Episodes, Outcome
from crowdbench.metrics import Pair
from crowdbench_leaderboards.pages.standings import Standing, Standings
from crowdbench_leaderboards.pages.texts import NOTHING, number

MOST_CASES = 80
"""Largest number of shown cases: the ones in which most entries fail."""

LETTERS = {
    Outcome.RUNNING: NOTHING,
    Outcome.SUCCESS: "",
    Outcome.COLLISION: "C",
    Outcome.TIMEOUT: "T",
    Outcome.WALL_COLLISION: "C",
}
"""The letter of each outcome; a planner does not start in a scenario that it cannot drive."""


TAGS = "reactive learned planning;real-time;privileged"
"""Tags by which entries are filtered, in groups: a row that has one tag of each chosen group is shown."""


def tags(one: Standing) -> str:
    """Return the tags of an entry, in the groups of `TAGS`.

    An entry is `learned` if it states a digest of weights or its card states a training, `planning` if its card states
    so, and `reactive` if it is neither.
    """
    card, spec = one.entry.card, one.entry.spec
    has_weights = any(name.endswith("weights") for facts in spec.facts.values() for name in facts)
    is_learned = has_weights or bool(card.training_scenarios or card.training_data)
    kinds = {"reactive": not (is_learned or card.planning), "learned": is_learned, "planning": card.planning}
    groups = [
        [kind for kind, holds in kinds.items() if holds],
        ["real-time"] if one.decision_time is not None and one.decision_time.is_real_time else [],
        ["privileged"] if card.privileged_training or spec.privileged else [],
    ]
    return ";".join(" ".join(group) for group in groups)


def pair_table(table: Standings) -> list[tuple[Standing, list[dict[str, str] | None]]]:
    """Return a row for each ranked entry with a cell for each one; None for itself and for pairs not compared."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for pair in table.pairs:
        cells[pair.higher, pair.lower] = _pair_cell(pair, "better", 1.0)
        cells[pair.lower, pair.higher] = _pair_cell(pair, "worse", -1.0)
    names = [one.entry.name for one in table.ranked]
    return [(one, [cells.get((one.entry.name, name)) for name in names]) for one in table.ranked]


def _pair_cell(pair: Pair, verdict: str, sign: float) -> dict[str, str]:
    """Return the verdict, and the difference in score with its half width, row minus column."""
    text = number(sign * pair.difference, 3)
    signed = text if text.startswith("\N{MINUS SIGN}") else f"+{text}"
    return {
        "style": verdict if pair.is_sure else "",
        "verdict": verdict if pair.is_sure else "not decided",
        "difference": f"{signed} \N{PLUS-MINUS SIGN} {number(pair.error, 3)}",
    }


def _outcomes(episodes: Episodes) -> Int[np.ndarray, "case"]:
    """Return the outcome of each case: success only if all vehicles succeed."""
    return np.asarray(episodes.outcome.reshape(len(np.unique(episodes.case)), -1).max(axis=1))


def case_table(table: Standings) -> dict[str, Any] | None:
    """Return the public cases in which some entry failed; None without entries that drove them.

    Pending entries are left out.

    Returns:
        `groups` are the scenarios with their number of shown cases, `cases` the numbers of these cases, `links` their
        names in a replay, and `rows` the entries with their outcomes. Of `total` cases, some entry failed in `failed`,
        and all entries failed in `by_all`.
    """
    board = table.board
    entries = [one for one in table.entries if one.public]
    if not entries:
        return None
    drawn = board.public_cases
    per_scenario = len(drawn)
    undriven = np.full(per_scenario, Outcome.RUNNING)
    driven = [{name: _outcomes(own) for name, own in one.public.items()} for one in entries]
    outcomes = np.array([np.concatenate([own.get(name, undriven) for name in board.scenarios]) for own in driven])
    failures = (outcomes != Outcome.SUCCESS).sum(axis=0)
    hardest = np.argsort(-failures, kind="stable")[: min(MOST_CASES, int((failures > 0).sum()))]
    cases = hardest[np.argsort(hardest // per_scenario, kind="stable")]
    groups = zip(*np.unique(cases // per_scenario, return_counts=True), strict=True)
    return {
        "groups": [(board.scenarios[i], length) for i, length in groups],
        "cases": (cases % per_scenario).tolist(),
        "links": [
            f"{board.scenarios[i // per_scenario]}/{drawn.split}/{drawn.start + i % per_scenario}" for i in cases
        ],
        "rows": [
            (one, [LETTERS[Outcome(each)] for each in own])
            for one, own in zip(entries, outcomes[:, cases].tolist(), strict=True)
        ],
        "failed": int((failures > 0).sum()),
        "total": per_scenario * len(board.scenarios),
        "by_all": int((failures == len(entries)).sum()),
    }
