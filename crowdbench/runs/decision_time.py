"""How long a planner takes for its decisions in one world alone: a pass of its own, outside of any run.

A run drives many worlds at once, where a decision of all of them is timed, which takes less per world. The pass may
repeat the cases of a run: then the planner must decide the same.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Observation
from crowdbench.planners.base import AheadPlanner, Planner
from crowdbench.planners.driver import Driver
from crowdbench.runs.recording import Commands
from crowdbench.runs.rollout import rollout
from crowdbench.runs.spec import Replanning
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario

HARD_LIMIT = 20
"""A single decision in one world is stopped after so many time steps."""

SAME = 1.5e-4
"""Commands count as the same up to this difference, in the units of the vehicle's commands: networks round otherwise
in one world than in many, and boards round commands to 1e-4."""


class Decisions(NamedTuple):
    """The decisions of a planner, one world at a time.

    Attributes:
        seconds: Time that each took, or its processor time if that is more.
        is_same: True if its commands are the recorded ones of the run; True where no run was followed.
    """

    seconds: Float[np.ndarray, "decision"]
    is_same: Bool[np.ndarray, "decision"]


class _Timed(AheadPlanner):
    """Driver that keeps the time of each decision, and whether the decision is as recorded.

    Args:
        driver: Asks the planner.
        recorded: The commands of the episode by step. The vehicle executes the commands of the planner as long as
            they are the same, so that the planner is shown nothing of the run, and otherwise the recorded ones.
        processor: Returns the processor time of the planner so far. Time between two decisions counts for
            the later one.
    """

    native = True  # the driver has made commands of velocities

    def __init__(
        self, driver: Driver, recorded: Float[np.ndarray, "step 2"] | None, processor: Callable[[], float]
    ) -> None:
        self.driver, self.recorded, self.processor, self.privileged = driver, recorded, processor, driver.privileged
        self.decisions: list[tuple[float, bool]] = []

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        self.driver.reset(rows)
        self.taken = self.processor()

    def plan_ahead(self, obs: Observation, steps: int) -> Float[np.ndarray, "world time 2"]:
        start = time.perf_counter()
        commands = self.driver.decide(obs)[:, None] if steps == 1 else self.driver.decide_ahead(obs, steps)
        seconds, is_same, before = time.perf_counter() - start, True, self.taken
        self.taken = self.processor()
        if self.recorded is not None:
            executed = self.recorded[obs.step[0] : obs.step[0] + steps]
            is_same = bool((np.abs(commands[0, : len(executed)] - executed) <= SAME).all())
            if not is_same:  # an episode may end before all commands of its last decision are executed
                commands = np.pad(executed, ((0, steps - len(executed)), (0, 0)))[None]
        self.decisions.append((max(seconds, self.taken - before), is_same))
        return commands


def decide_alone(
    planner: Planner,
    name: str,
    scenario: Scenario,
    replanning: Replanning,
    cases: Cases,
    recorded: Commands | None = None,
    progress: Callable[[float], None] | None = None,
    processor: Callable[[], float] = lambda: 0.0,
) -> Decisions:
    """Time the decisions of a planner, one world at a time, with a `reset` before each case.

    Args:
        planner: The planner.
        name: Its name in errors.
        scenario: The scenario.
        replanning: When it observes.
        cases: The cases. The first case is driven to warm up and does not count.
        recorded: The commands of a run of these cases, which the planner must give again.
        progress: Called after each case with 1.
        processor: Returns the processor time of the planner so far, where it is in a process of its own.

    Returns:
        The decisions.

    Raises:
        InputError: The planner breaks its contract, or takes longer than `HARD_LIMIT` time steps for a decision.
    """
    first, *others = cases.batches(1)

    def drive(driver: Driver, case: Cases) -> list[tuple[float, bool]]:
        timed = _Timed(driver, None if recorded is None else recorded.of(case.start), processor)
        rollout(Driver(timed, name), scenario, case, replanning=replanning, undisturbed=False)
        return timed.decisions

    # It may load and compile what it needs, for which it has the time of a decision of a whole batch.
    drive(Driver(planner, name), first)
    driver = Driver(planner, name, HARD_LIMIT * scenario.rules.dt)
    decisions: list[tuple[float, bool]] = []
    for case in others:
        decisions += drive(driver, case)
        if progress is not None:
            progress(1)
    seconds, is_same = np.array(decisions).reshape(-1, 2).T
    return Decisions(seconds, is_same.astype(bool))
