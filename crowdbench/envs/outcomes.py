"""The outcome of a step for each agent of one world: for the vehicle as in a rollout, and for each pedestrian."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compiled import njit
from crowdbench.dynamics.motion import HOLONOMIC
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import StepCheck, step_outcome
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import Outcome, World


def outcomes_of_agents(
    before: World, after: World, check: StepCheck
) -> tuple[Int[np.ndarray, "agent"], Float[np.ndarray, "agent"]]:
    """Check a step of one world for all agents, by the rule for the vehicle (`crowdbench.sim.episode`).

    For a pedestrian the rule is `swept`. Agents that it cannot see do not count, because an agent cannot learn from a
    reward that its observations do not explain.

    Args:
        before: The world before the step.
        after: The world after it.
        check: What the check of the step found for the vehicle.

    Returns:
        The `Outcome` of the step for each agent, and the smallest distance in metres between its rim and another's.
    """
    agents = before.radius.shape[1]
    outcomes = np.full(agents, check.outcome[0])
    gaps = np.full(agents, check.gap[0])
    seen = before.present[0].copy()
    seen[0] &= before.rules.visible
    _check_pedestrians(
        before.rules.dynamics.code,
        np.array(before.rules.body),
        before.rules.dt,
        before.heading[0],
        math.hypot(*after.velocity[0, 0]),
        after.angular_speed[0],
        before.position[0],
        after.position[0] - before.position[0],
        after.position[0],
        before.goal[0],
        before.radius[0],
        before.obstacles[0, :0],
        seen,
        outcomes,
        gaps,
    )
    return outcomes, gaps


@no_type_check
@njit
def _check_pedestrians(
    code, body, dt, heading, speed, turn_rate, position, motion, end, goal, radius, no_walls, seen, outcomes, gaps
):
    """Check a step for the pedestrians of one world.

    Args:
        code: The code of the vehicle's dynamics.
        body: `[disc]`, where the centres of its discs are, in metres ahead of its position.
        dt: Duration of the step in seconds.
        heading: The vehicle's heading before the step, in radians.
        speed: Its speed in the step, in m/s.
        turn_rate: Its turn rate in the step, in rad/s.
        position: `[agent, 2]`, before the step, in metres.
        motion: `[agent, 2]`, displacement in the step in metres.
        end: `[agent, 2]`, positions after the step in metres.
        goal: `[agent, 2]`, in metres.
        radius: `[agent]`, in metres.
        no_walls: `[0, corner, 2]`.
        seen: `[agent]`, whether pedestrians see the agent.
        outcomes: `[agent]`, the vehicle's outcome in every element, filled from index 1.
        gaps: `[agent]`, filled from index 1, in metres.
    """
    others = seen.copy()
    others[0] = seen[0] and code == HOLONOMIC
    only = np.zeros(len(radius), np.bool_)
    for i in range(1, len(radius)):
        gaps[i], _ = nearest_in_step(i, position, motion, radius, others)
        if seen[0] and not others[0]:
            only[i] = True
            gap, _ = gaps_on_arc(body, heading, speed, turn_rate, dt, position, motion, radius, only, no_walls)
            gaps[i] = min(gaps[i], gap)
            only[i] = False
        is_last = outcomes[0] == Outcome.TIMEOUT.value
        dx, dy = goal[i, 0] - end[i, 0], goal[i, 1] - end[i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[i], is_last)
