"""Measure the decision time of a planner with one world at a time, separately from its run.

A run drives many worlds at once and times one decision for all of them, which takes less time per world. The
measurement repeats cases of the run, in which the planner must return the same commands.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench import Cases, Driver, Observation, Planner, Scenario, rollout
from crowdbench.planners import AheadPlanner
from crowdbench.results import StoredCommands
from crowdbench.runs import Replanning

HARD_LIMIT = 20
"""Number of time steps after which a single decision in one world is stopped."""

SAME_COMMANDS = 1.5e-4
"""Largest difference of commands that count as the same, in the units of the vehicle's commands. Networks round
differently for one world than for many, and boards round commands to 1e-4."""


class Decisions(NamedTuple):
    """The decisions of a planner, one world at a time.

    Attributes:
        seconds: Wall-clock time of each decision, or its processor time if that is larger.
        is_same: True if its commands equal the recorded ones.
    """

    seconds: Float[np.ndarray, "decision"]
    is_same: Bool[np.ndarray, "decision"]


class _Timed(AheadPlanner):
    """Planner that measures the time of each decision of a driver, and compares its commands with recorded ones.

    Args:
        driver: The driver of the planner.
        recorded: The recorded commands of the episode by step. The vehicle executes the planner's commands while they
            are the same, so that the planner gets no information about the run, and otherwise the recorded ones.
        processor: Returns the processor time of the planner so far. Time between two decisions is added to the later
            one.
    """

    native = True  # the driver has converted velocities to commands

    def __init__(self, driver: Driver, recorded: Float[np.ndarray, "step 2"], processor: Callable[[], float]) -> None:
        self.driver, self.recorded, self.processor = driver, recorded, processor
        self.privileged, self.raw = driver.privileged, driver.raw
        self.decisions: list[tuple[float, bool]] = []

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        self.driver.reset(rows)
        self.taken = self.processor()

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        start = time.perf_counter()
        commands = self.driver.decide(obs)[:, None] if steps == 1 else self.driver.decide_ahead(obs, steps)
        seconds, before = time.perf_counter() - start, self.taken
        self.taken = self.processor()
        executed = self.recorded[obs.step[0] : obs.step[0] + steps]
        is_same = bool((np.abs(commands[0, : len(executed)] - executed) <= SAME_COMMANDS).all())
        if not is_same:  # an episode may end before all commands of its last decision are executed
            commands = np.pad(executed, ((0, steps - len(executed)), (0, 0)))[None]
        self.decisions.append((max(seconds, self.taken - before), is_same))
        return commands


def time_single_world(
    planner: Planner,
    name: str,
    scenario: Scenario,
    replanning: Replanning,
    cases: Cases,
    recorded: StoredCommands,
    processor: Callable[[], float],
) -> Decisions:
    """Time the decisions of a planner, one world at a time, with a `reset` before each case.

    Args:
        planner: The planner.
        name: Its name in errors.
        scenario: The scenario.
        replanning: The steps at which it observes.
        cases: The cases. The first case is driven to warm up and does not count.
        recorded: The commands of a run of these cases, which are compared with the planner's commands.
        processor: Returns the processor time of the planner so far.

    Returns:
        The decisions.

    Raises:
        InputError: The planner breaks its contract, or takes longer than `HARD_LIMIT` time steps for a decision.
    """
    first, *others = cases.batches(1)

    def drive(driver: Driver, case: Cases) -> list[tuple[float, bool]]:
        timed = _Timed(driver, recorded.of(case.start), processor)
        rollout(timed, scenario, case, replanning=replanning, undisturbed=False)
        return timed.decisions

    # The planner may load and compile code here, with the time limit for a decision of a whole batch.
    drive(Driver(planner, name), first)
    driver = Driver(planner, name, HARD_LIMIT * scenario.rules.dt)
    decisions: list[tuple[float, bool]] = []
    for case in others:
        decisions += drive(driver, case)
    seconds, is_same = np.array(decisions).reshape(-1, 2).T
    return Decisions(seconds, is_same.astype(bool))
