"""Means of metrics over the scenarios of a board, and over networks that were trained with other seeds."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench import Cases, Episodes, InputError
from crowdbench.metrics import (
    OF_FLEETS,
    UNDEFINED,
    UNDISTURBED,
    Estimate,
    info_of,
    mean_over_scenarios,
    range_over_networks,
)
from crowdbench.results import COMMANDS, read_commands
from crowdbench.utils import plain
from crowdbench_leaderboards.board import Board, others_in
from crowdbench_leaderboards.board_runs import EntryPlanner, read_episodes
from crowdbench_leaderboards.entry import Entry
from crowdbench_leaderboards.verdict import Method

MIN_NETWORKS = 5
"""Fewer networks do not represent a method."""

MAX_NETWORK_CASES = 100
"""Cases that each network of a method drives, at most."""

ALIKE = 0.01
"""Commands of two networks count as the same up to this difference, in m/s or in the units of native commands."""

METHOD_METRICS = ("success_rate", "collision_rate", "sct")
"""Metrics whose means over networks are shown."""

Estimates = Mapping[str, Mapping[str, Estimate]]
"""Estimates by scenario and metric."""


def case_means(episodes: Episodes, metric: str) -> Float[np.ndarray, "case"]:
    """Return a metric in each case: the mean over the vehicles that are scored."""
    cases = len(np.unique(episodes.case))
    return np.asarray(episodes.columns[metric].reshape(cases, -1).mean(axis=1))


def board_figures(board: Board, scenarios: Estimates) -> dict[str, Estimate]:
    """Return the means over the scenarios of a board by metric.

    A mean is undefined if it is undefined in a scenario. Metrics that compare with the undisturbed crowd are means over
    the scenarios with cooperative pedestrians, which see the vehicle. Metrics of several vehicles are means over the
    scenarios in which the entry drives all.

    Args:
        board: The board.
        scenarios: The estimates; a scenario without any counts as 0.
    """
    figures = {}
    for metric in board.metrics:
        estimates = [scenario.get(metric) for scenario in scenarios.values()]
        counted = [True] * len(estimates)
        if UNDISTURBED in info_of(metric).needs:
            counted = [estimate is not None and not np.isnan(estimate.mean) for estimate in estimates]
        elif metric in OF_FLEETS:
            counted = [not others_in(name) for name in scenarios]
        estimates = [estimate if counts else None for estimate, counts in zip(estimates, counted, strict=True)]
        weights = board.weights * counted
        figures[metric] = mean_over_scenarios(weights / weights.sum(), estimates) if any(counted) else UNDEFINED
    return figures


def method_cases(cases: Cases) -> Cases:
    """Return the cases of an entry that each network of its method drives: the first ones."""
    return Cases(cases.split, cases.start, min(cases.stop, cases.start + MAX_NETWORK_CASES))


def method_networks(entry: Entry, board: Board) -> list[EntryPlanner]:
    """Return the planners with each network of a method, the entry's own first.

    The list is empty on boards of several scenarios, and if the method has fewer than `MIN_NETWORKS` networks.
    """
    spec = entry.spec
    if len(spec.networks) + 1 < MIN_NETWORKS or len(board.scenarios) > 1:
        return []
    return [EntryPlanner(entry.directory, spec.planner, {**spec.options, **each}) for each in ({}, *spec.networks)]


def check_networks_differ(board: Board, folders: Sequence[Path], cases: Cases) -> None:
    """Raise InputError if two networks of a method drive 90 % of cases alike, which networks of other seeds do not.

    Args:
        board: The board, of one scenario.
        folders: The folders of the runs of each network.
        cases: The cases that all networks drove.
    """
    runs = [read_commands(folder / board.scenarios[0] / COMMANDS) for folder in folders]
    for (first, one), (second, two) in itertools.combinations(enumerate(runs, start=1), 2):
        pairs = [(one.of(case), two.of(case)) for case in range(cases.start, cases.stop)]
        alike = [len(own) == len(other) and bool((np.abs(own - other) < ALIKE).all()) for own, other in pairs]
        if sum(alike) >= 0.9 * len(alike):
            raise InputError(
                f"networks {first} and {second} of its method drive {sum(alike)} of {len(alike)} cases alike"
            )


def summarize_method(board: Board, folders: Sequence[Path], cases: int) -> Method:
    """Return the means over the networks of a method, with intervals that account for both networks and cases.

    Args:
        board: The board, of one scenario.
        folders: The folders of the runs of each network.
        cases: How many cases all networks drove.
    """
    networks = [read_episodes(board, folder)[board.scenarios[0]].columns for folder in folders]
    values = {metric: np.array([columns[metric][:cases] for columns in networks], float) for metric in METHOD_METRICS}
    figures = plain({metric: range_over_networks(shares) for metric, shares in values.items()})
    return Method.model_validate({"networks": len(networks), "cases": cases, "metrics": figures})
