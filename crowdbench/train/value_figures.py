"""What a trained network is measured to do, for its card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.metrics import METRICS
from crowdbench.evaluate.results import Episodes, to_json
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.planners.lookahead.kce import Limits
from crowdbench.predict import ConstantVelocity
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.settings import BATCH
from crowdbench.value.networks import ValueNetwork

CASES = {"validation": Cases("val", 1000, 2000), "test": Cases("test", 0, 500)}
"""The cases that are run, by the name of their split on the card. None of them chooses a checkpoint."""

MEASURED = ("success_rate", "collision_rate", "timeout_rate", "navigation_time")
"""The metrics on the card."""


def figures(
    network: ValueNetwork, scenario: Scenario, limits: Limits | None, progress: Callable[[float], None]
) -> dict[str, Any]:
    """Run a network with constant-velocity lookahead.

    Args:
        network: The trained network.
        scenario: The scenario that it was trained in.
        limits: The limits to the commands; None for none.
        progress: Called as by `rollout`.

    Returns:
        For every split of `CASES` the cases and the mean of every metric with its 95 % interval, as JSON.
    """
    planner = ValuePlanner(ConstantVelocity(), network, limits=limits)
    return measured(planner, network.name, scenario, MEASURED, progress)


def measured(
    planner: Planner, name: str, scenario: Scenario, wanted: Sequence[str], progress: Callable[[float], None]
) -> dict[str, Any]:
    """Run a planner through the cases of a card.

    Args:
        planner: The planner.
        name: What it is called in errors.
        scenario: The scenario.
        wanted: The names of the metrics.
        progress: Called as by `rollout`.

    Returns:
        For every split of `CASES` the cases and the mean of every metric with its 95 % interval, as JSON.
    """
    driver = Driver(planner, name)
    metrics = {name: METRICS[name] for name in wanted}
    found = {}
    for split, cases in CASES.items():
        traces = (rollout(driver, scenario, part, progress=progress) for part in cases.batches(BATCH))
        parts = [Episodes.of(trace, metrics) for trace in traces]
        found[split] = {"cases": str(cases), "metrics": to_json(Episodes.joined(parts).summary())}
    return found
