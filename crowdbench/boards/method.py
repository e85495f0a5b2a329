"""What holds of a method, and not of one network alone: its mean over networks that were trained with other seeds."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from crowdbench.boards.board import Board
from crowdbench.boards.entry import Entry, Method, Range
from crowdbench.boards.ranking import CRITERIA
from crowdbench.boards.run_entry import EntryRun, read_episodes
from crowdbench.metrics.summary import wilson
from crowdbench.scenario.cases import Cases
from crowdbench.study.intervals import mean_over_networks

LEAST = 5
"""Fewer networks say nothing of their method."""

MOST_CASES = 250
"""Cases that each network drives, at most."""

Networks = Sequence[Mapping[str, Any]]
"""The options in which each other network of a method differs from that of the entry."""


def method_cases(cases: Cases) -> Cases:
    """Those of an entry's cases that each network of its method drives: the first ones."""
    return Cases(cases.split, cases.start, min(cases.stop, cases.start + MOST_CASES))


def method_networks(entry: Entry, board: Board) -> Networks:
    """The other networks of an entry that claims something of its method: with enough, on boards of one scenario."""
    networks = entry.spec.networks
    return networks if len(networks) + 1 >= LEAST and len(board.scenarios) == 1 else []


def drive_networks(run: EntryRun, networks: Networks) -> None:
    """Drive the other networks of a method, in the scenario of a board that has only one.

    Args:
        run: The run of the entry's own network.
        networks: The other networks.

    Raises:
        InputError: The planner breaks its contract or a limit.
        Unfinished: Runs are missing that other shards make.
        KeyboardInterrupt: Somebody interrupted it. What is finished is kept.
    """
    others = _network_runs(run, networks)
    for other in others:
        other.drive()
    for other in others:
        other.check_finished({})


def _network_runs(run: EntryRun, networks: Networks) -> list[EntryRun]:
    return [
        dataclasses.replace(
            run,
            planner=dataclasses.replace(run.planner, options={**run.planner.options, **options}),
            out=run.out / "networks" / str(number),
            cases=method_cases(run.cases),
            shard=run.shard.rotate(number + 1),
        )
        for number, options in enumerate(networks)
    ]


def summarize_method(run: EntryRun, networks: Networks) -> Method:
    """The means over all networks of a method, which have all driven, with intervals for other networks and cases.

    Args:
        run: The run of the entry's own network.
        networks: The other networks.
    """
    cases = len(method_cases(run.cases))
    (name,) = run.board.scenarios
    each = [read_episodes(run.board, one.out)[name].columns for one in (run, *_network_runs(run, networks))]
    metrics = {
        metric: range_over_networks(np.array([columns[metric][:cases] for columns in each], float))
        for metric in CRITERIA
    }
    return Method(networks=len(each), cases=cases, metrics=metrics)


def range_over_networks(values: Float[np.ndarray, "network case"]) -> Range:
    """The mean of shares over networks, with its interval within 0 and 1."""
    # Where neither networks nor cases differ, which is no certainty, it is Wilson's for the cases of one network.
    is_one = (values == values[0, 0]).all()
    estimate = wilson(values[0].astype(bool)) if is_one else mean_over_networks(values)
    return Range(mean=estimate.mean, low=max(estimate.low, 0.0), high=min(estimate.high, 1.0))
