"""How long a planner takes to decide in one world alone, on one core, and whether that is in time.

The time of a decision never changes a command. What a slower or faster machine would measure is estimated by a fixed
piece of work, the calibration kernel, that is timed on the same core.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

from crowdbench.boards.entry import DecisionTime
from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.replanning import Replanning
from crowdbench.evaluate.rollout import rollout
from crowdbench.planners.base import Planner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation

KERNEL = "python-loop-and-sort-1"
"""The name of the calibration kernel. Another kernel or machine of reference gets another name."""

REFERENCE_MS = 25.0
"""What the kernel takes on the machine of reference, by definition: about one core of a rented server of 2026."""

CASES = Cases("val", 0, 11)
"""The cases that are timed. The first one is driven to warm up and does not count."""

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
        return self._timed(lambda: self.planner.plan(obs))

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        return self._timed(lambda: self.planner.plan_ahead(obs, steps))

    def _timed(self, ask: Callable[[], np.ndarray]) -> np.ndarray:
        start = time.perf_counter()
        try:
            return ask()
        finally:
            self.seconds.append(time.perf_counter() - start)


def decision_time(planner: Planner, name: str, scenario: Scenario, replanning: Replanning) -> DecisionTime:
    """Time the decisions of a planner, one world at a time.

    Args:
        planner: The planner, on one core.
        name: What it is called in errors.
        scenario: The scenario.
        replanning: When it observes.

    Returns:
        What was measured.

    Raises:
        InputError: The planner breaks its contract, or takes longer than `HARD_LIMIT` time steps for a decision.
    """
    timed = _Timed(planner)
    first, *others = CASES.batches(1)
    # It may load and compile what it needs, for which it has the time of a decision of a whole batch.
    rollout(Driver(timed, name), scenario, first, replanning=replanning)
    timed.seconds.clear()
    before = kernel_seconds()
    for case in others:
        rollout(Driver(timed, name, HARD_LIMIT * scenario.rules.dt), scenario, case, replanning=replanning)
    kernel_ms = 1e3 * (before + kernel_seconds()) / 2.0
    p99 = 1e3 * float(np.percentile(timed.seconds, 99))
    calibrated = p99 * REFERENCE_MS / kernel_ms
    return DecisionTime(
        p99_ms=p99,
        kernel=KERNEL,
        kernel_ms=kernel_ms,
        calibrated_p99_ms=calibrated,
        is_real_time=calibrated <= 1e3 * scenario.rules.dt,
    )


def kernel_seconds() -> float:
    """The median time in seconds, of five tries, of the calibration kernel: a loop of Python, and sorting in NumPy."""

    def work() -> None:
        total = 0
        for number in range(300_000):
            total += number * number & 255
        values = np.random.Generator(np.random.Philox(1)).random(300_000)
        np.sort(values)

    tries = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        tries.append(time.perf_counter() - start)
    return sorted(tries)[2]
