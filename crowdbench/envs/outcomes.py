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
    agents, rules = before.radius.shape[1], before.rules
    outcomes, gaps = np.empty(agents, np.int64), np.empty(agents)
    _check_agents(
        rules.dynamics.code,
        rules.discs,
        rules.dt,
        rules.visible,
        before.heading,
        0.0 if rules.dynamics.code == HOLONOMIC else math.hypot(*after.velocity[0, 0]),
        after.angular_speed,
        before.position,
        after.position,
        before.goal,
        before.radius,
        before.obstacles,
        before.present,
        *check[:2],
        outcomes,
        gaps,
    )
    return outcomes, gaps


@no_type_check
@njit
def _check_agents(
    code,
    body,
    dt,
    visible,
    heading,
    speed,
    turn_rate,
    position,
    end,
    goal,
    radius,
    obstacles,
    present,
    outcome,
    gap,
    outcomes,
    gaps,
):
    """Check a step for the agents of one world. The axis `world` has length 1.

    Args:
        code: The code of the vehicle's dynamics.
        body: `[disc]`, where the centres of its discs are, in metres ahead of its position.
        dt: Duration of the step in seconds.
        visible: Whether pedestrians see the vehicle.
        heading: `[world]`, the vehicle's heading before the step, in radians.
        speed: The vehicle's in the step, in m/s; not used where it is holonomic.
        turn_rate: `[world]`, the vehicle's in the step, in rad/s.
        position: `[world, agent, 2]`, before the step, in metres.
        end: `[world, agent, 2]`, positions after the step in metres.
        goal: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        present: `[world, agent]`.
        outcome: `[world]`, the vehicle's `Outcome`.
        gap: `[world]`, the vehicle's, in metres.
        outcomes: `[agent]`, filled: an `Outcome`.
        gaps: `[agent]`, filled, in metres.
    """
    motion = np.empty(position.shape[1:])
    for i in range(len(motion)):
        for axis in range(2):
            motion[i, axis] = end[0, i, axis] - position[0, i, axis]
    outcomes[0], gaps[0] = outcome[0], gap[0]
    is_seen = present[0, 0] and visible
    others = present[0].copy()
    others[0] = is_seen and code == HOLONOMIC
    only = np.zeros(len(motion), np.bool_)
    for i in range(1, len(motion)):
        gaps[i], _ = nearest_in_step(i, position[0], motion, radius[0], others)
        if is_seen and code != HOLONOMIC:
            only[i] = True
            drive = heading[0], speed, turn_rate[0], dt
            near, _ = gaps_on_arc(body, *drive, position[0], motion, radius[0], only, obstacles[0, :0])
            gaps[i] = min(gaps[i], near)
            only[i] = False
        is_last = outcomes[0] == Outcome.TIMEOUT.value
        dx, dy = goal[0, i, 0] - end[0, i, 0], goal[0, i, 1] - end[0, i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[0, i], is_last)
