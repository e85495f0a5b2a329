"""What holds of a method, and not of one network alone: its mean over networks that were trained with other seeds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.boards.board import Board
from crowdbench.boards.entry import Entry
from crowdbench.boards.kept_runs import read_episodes
from crowdbench.boards.ranking import rank_by_bounds
from crowdbench.boards.run_entry import EntryRun
from crowdbench.boards.verdict import Method, Range
from crowdbench.metrics.summary import Estimate, wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.intervals import mean_over_networks

LEAST = 5
"""Fewer networks say nothing of their method."""

METRICS = ("success_rate", "collision_rate", "sct")
"""Shares whose means over networks are told."""

Figures = Mapping[str, Estimate]
"""The means of an entry over a board."""

MOST_CASES = 250
"""Cases that each network drives, at most."""


def method_cases(cases: Cases) -> Cases:
    """Those of an entry's cases that each network of its method drives: the first ones."""
    return Cases(cases.split, cases.start, min(cases.stop, cases.start + MOST_CASES))


def method_networks(entry: Entry, board: Board) -> Sequence[Mapping[str, Any]]:
    """The options in which the other networks of a method differ; none with too few networks, or several scenarios."""
    networks = entry.spec.networks
    return networks if len(networks) + 1 >= LEAST and len(board.scenarios) == 1 else []


def network_runs(entry: Entry, run: EntryRun) -> list[EntryRun]:
    """The runs of the other networks of a method, as the run of the entry's own network."""
    return [
        dataclasses.replace(
            run,
            options={**run.options, **options},
            out=run.out / "networks" / str(number),
            cases=method_cases(run.cases),
            shard=run.shard.rotate(number + 1),
        )
        for number, options in enumerate(method_networks(entry, run.board))
    ]


def summarize_method(run: EntryRun, others: Sequence[EntryRun]) -> Method:
    """The means over all networks of a method, which have all driven, with intervals for other networks and cases.

    Args:
        run: The run of the entry's own network.
        others: Those of the other networks.
    """
    cases = len(method_cases(run.cases))
    (name,) = run.board.scenarios
    each = [read_episodes(run.board, one.out)[name].columns for one in (run, *others)]
    metrics = {
        metric: range_over_networks(np.array([columns[metric][:cases] for columns in each], float))
        for metric in METRICS
    }
    return Method(networks=len(each), cases=cases, metrics=metrics)


def rank_methods(
    board: Board, entries: Sequence[tuple[Entry, Method | None, Mapping[str, Estimate]]]
) -> dict[str, int]:
    """The rank of the method of each entry, by the entry's name: of its mean over networks, or of itself.

    Entries that were trained and have too few networks have none.

    Args:
        board: The board.
        entries: What is ranked, with what holds of its method and its own figures.
    """
    score, error = {}, {}
    for entry, method, figures in entries:
        if method is None and entry.card.training_seeds > 0:
            continue
        found = figures if method is None else method.metrics
        success = found["success_rate"]
        score[entry.name] = board.scale.score(success.mean, found["sct"].mean)
        error[entry.name] = (success.high - success.low) / 2.0
    return rank_by_bounds(score, error)


def range_over_networks(values: Float[np.ndarray, "network case"]) -> Range:
    """The mean of shares over networks, with its interval within 0 and 1."""
    # Where neither networks nor cases differ, which is no certainty, it is Wilson's for the cases of one network.
    is_one = (values == values[0, 0]).all()
    estimate = wilson(values[0].astype(bool)) if is_one else mean_over_networks(values)
    return Range(mean=estimate.mean, low=max(estimate.low, 0.0), high=min(estimate.high, 1.0))
