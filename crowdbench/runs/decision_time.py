"""How long a planner takes for its decisions in one world alone: a pass of its own, outside of any run.

A run drives many worlds at once, where a decision of all of them is timed, which takes less per world.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.types import Observation
from crowdbench.planners.base import Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.rollout import Progress, rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario

HARD_LIMIT = 20
"""A single decision in one world is stopped after so many time steps."""


class _Timed(Planner):
    """Asks another planner, and keeps how long each answer took in seconds."""

    def __init__(self, planner: Planner) -> None:
        self.planner = planner
        self.privileged = planner.privileged
        self.native = planner.native
        self.facts = planner.facts
        self.seconds: list[float] = []

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        self.planner.reset(rows)

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        return self._time(lambda: self.planner.plan(obs))

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        return self._time(lambda: self.planner.plan_ahead(obs, steps))

    def _time(self, ask: Callable[[], np.ndarray]) -> np.ndarray:
        start = time.perf_counter()
        try:
            return ask()
        finally:
            self.seconds.append(time.perf_counter() - start)


def decision_seconds(
    planner: Planner,
    name: str,
    scenario: Scenario,
    replanning: Replanning,
    cases: Cases,
    progress: Progress | None = None,
) -> Float[np.ndarray, "decision"]:
    """Time the decisions of a planner, one world at a time.

    Args:
        planner: The planner.
        name: What it is called in errors.
        scenario: The scenario.
        replanning: When it observes.
        cases: What it drives. The first case is driven to warm up and does not count.
        progress: Called after each case with 1.

    Returns:
        How long each decision took, in seconds.

    Raises:
        InputError: The planner breaks its contract, or takes longer than `HARD_LIMIT` time steps for a decision.
    """
    timed = _Timed(planner)
    first, *others = cases.batches(1)
    # It may load and compile what it needs, for which it has the time of a decision of a whole batch.
    rollout(Driver(timed, name), scenario, first, replanning=replanning, undisturbed=False)
    timed.seconds.clear()
    for case in others:
        driver = Driver(timed, name, HARD_LIMIT * scenario.rules.dt)
        rollout(driver, scenario, case, replanning=replanning, undisturbed=False)
        if progress is not None:
            progress(1)
    return np.array(timed.seconds)
