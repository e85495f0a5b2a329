"""The outcome of a step for each agent of one world: for the vehicle as in a rollout, and for each pedestrian."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compiled import njit
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import StepCheck, step_outcome
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
        before.position[0],
        after.position[0] - before.position[0],
        after.position[0],
        before.goal[0],
        before.radius[0],
        seen,
        outcomes,
        gaps,
    )
    return outcomes, gaps


@no_type_check
@njit
def _check_pedestrians(position, motion, end, goal, radius, seen, outcomes, gaps):
    """Check a step for the pedestrians of one world.

    Args:
        position: `[agent, 2]`, before the step, in metres.
        motion: `[agent, 2]`, displacement in the step in metres.
        end: `[agent, 2]`, positions after the step in metres.
        goal: `[agent, 2]`, in metres.
        radius: `[agent]`, in metres.
        seen: `[agent]`, whether pedestrians see the agent.
        outcomes: `[agent]`, the vehicle's outcome in every element, filled from index 1.
        gaps: `[agent]`, filled from index 1, in metres.
    """
    for i in range(1, len(radius)):
        gaps[i], _ = nearest_in_step(i, position, motion, radius, seen)
        is_last = outcomes[0] == Outcome.TIMEOUT.value
        dx, dy = goal[i, 0] - end[i, 0], goal[i, 1] - end[i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[i], is_last)
