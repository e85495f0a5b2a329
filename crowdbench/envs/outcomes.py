"""How a step of one world ended for each of its agents: the vehicle as judged, a pedestrian in its own right."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from crowdbench.geometry import nearest_in_step
from crowdbench.sim.episode import StepCheck, step_outcome
from crowdbench.types import Outcome, World


def everybodys_outcomes(
    before: World, after: World, check: StepCheck
) -> tuple[Int[np.ndarray, "agent"], Float[np.ndarray, "agent"]]:
    """Outcome and gap, in metres, of each agent in a step of one world, from those of the vehicle.

    A pedestrian is judged as the vehicle is, in the same order of precedence: the time-out is everybody's;
    then a collision, where its disc touches that of an agent it can see, in their true relative motion;
    then success, where it ends nearer to its goal than its radius. A collision is no end for it.
    A vehicle that it cannot see does not count: a reward that nothing it observes foretells teaches nothing.
    """
    agents = before.radius.shape[1]
    outcomes = np.full(agents, check.outcome[0])
    gaps = np.full(agents, check.gap[0])
    seen = before.present[0].copy()
    seen[0] &= before.rules.visible
    _judge_pedestrians(
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
@njit(cache=True)
def _judge_pedestrians(position, motion, end, goal, radius, seen, outcomes, gaps):
    for i in range(1, len(radius)):
        gaps[i], _ = nearest_in_step(i, position, motion, radius, seen)
        is_last = outcomes[0] == Outcome.TIMEOUT.value
        dx, dy = goal[i, 0] - end[i, 0], goal[i, 1] - end[i, 1]
        outcomes[i] = step_outcome(gaps[i], np.inf, dx, dy, radius[i], is_last)
