"""How a step of one world ended for each of its agents: the vehicle as judged, a pedestrian in its own right."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from crowdbench.geometry import closest_approach
from crowdbench.types import Outcome, World


def everybodys_outcomes(
    before: World, after: World, outcome: Int[np.ndarray, "1"], gap: Float[np.ndarray, "1"]
) -> tuple[Int[np.ndarray, "agent"], Float[np.ndarray, "agent"]]:
    """Outcome and gap, in metres, of each agent in a step of one world, from those of the vehicle.

    A pedestrian is judged as the vehicle is, in the same order of precedence: the time-out is everybody's;
    then a collision, where its disc touches that of an agent it can see, in their true relative motion;
    then success, where it ends nearer to its goal than its radius. A collision is no end for it.
    A vehicle that it cannot see does not count: a reward that nothing it observes foretells teaches nothing.
    """
    agents = before.radius.shape[1]
    outcomes, gaps = np.empty(agents, np.int64), np.empty(agents)
    outcomes[0], gaps[0] = outcome[0], gap[0]
    _judge_pedestrians(
        before.position,
        after.velocity,
        after.position,
        before.goal,
        before.radius,
        before.present,
        before.rules.visible,
        before.rules.dt,
        outcomes,
        gaps,
    )
    return outcomes, gaps


@no_type_check
@njit(cache=True)
def _judge_pedestrians(position, velocity, end, goal, radius, present, visible, dt, outcomes, gaps):
    position, velocity, end, goal, radius, present = position[0], velocity[0], end[0], goal[0], radius[0], present[0]
    agents = len(radius)
    for i in range(1, agents):
        gaps[i] = np.inf
        for j in range(agents):
            if j != i and present[j] and (j > 0 or visible):
                distance = closest_approach(
                    position[j, 0] - position[i, 0],
                    position[j, 1] - position[i, 1],
                    (velocity[j, 0] - velocity[i, 0]) * dt,
                    (velocity[j, 1] - velocity[i, 1]) * dt,
                )
                gaps[i] = min(gaps[i], distance - radius[j] - radius[i])
        if outcomes[0] == Outcome.TIMEOUT.value:
            outcomes[i] = outcomes[0]
            continue
        left = math.hypot(end[i, 0] - goal[i, 0], end[i, 1] - goal[i, 1])
        if gaps[i] < 0.0:
            outcomes[i] = Outcome.COLLISION.value
        elif left < radius[i]:
            outcomes[i] = Outcome.SUCCESS.value
        else:
            outcomes[i] = Outcome.RUNNING.value
