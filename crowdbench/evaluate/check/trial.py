"""The drive on which policies, predictors and metrics are examined."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.driver import Driver
from crowdbench.evaluate.rollout import rollout
from crowdbench.geometry import toward_goal
from crowdbench.planners.base import Planner
from crowdbench.planners.reactive import ORCAPlanner
from crowdbench.scenario.cases import Cases
from crowdbench.scenario.scenario import Scenario
from crowdbench.types import Observation, Trace


def trial(scenario: Scenario, cases: Cases, privileged: bool = False) -> tuple[Trace, list[Observation]]:
    """Drive through cases in three ways.

    Args:
        scenario: The scenario of the cases.
        cases: The cases.
        privileged: Whether observations show the pedestrians' next velocities.

    Returns:
        The trace, and the observation of each step.

    Raises:
        InputError: The scenario breaks its contract.
    """
    vehicle = _Vehicle(privileged)
    trace = rollout(Driver(vehicle, "trial"), scenario, cases)
    return trace, vehicle.shown


class _Vehicle(Planner):
    """Avoids pedestrians in every third case, drives straight in another third, and stands in the rest.

    So that all outcomes occur.
    """

    def __init__(self, privileged: bool) -> None:
        self.privileged = privileged
        self.orca = ORCAPlanner()
        self.shown: list[Observation] = []

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        self.shown.append(obs)
        straight = toward_goal(obs.vehicle.position, obs.vehicle.goal, obs.vehicle.preferred_speed)
        return np.choose(obs.row[:, None] % 3, [self.orca.plan(obs), straight, np.zeros_like(straight)])
