"""The rule of an episode: what ends it, and how. The only home of collision, arrival and time-out.

The simulator asks `check_step` about a step that was made; environments and lookahead call the compiled
`step_outcome` for agents and steps of their own.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from crowdbench.geometry import nearest_in_step
from crowdbench.types import Outcome, Rules, World


class StepCheck(NamedTuple):
    """What the check of a step found for the vehicle of each world.

    Attributes:
        outcome: An `Outcome`.
        gap: Smallest distance in metres between the vehicle's rim and a pedestrian's in the step; infinite where
            there are no pedestrians.
        wall_gap: The same to the obstacles. No scenario has obstacles yet, so that it is always infinite.
    """

    outcome: Int[np.ndarray, "world"]
    gap: Float[np.ndarray, "world"]
    wall_gap: Float[np.ndarray, "world"]


def check_step(before: World, after: World) -> StepCheck:
    """Find out whether a step ended the episode, and how close the vehicle came to anything in it.

    The vehicle collides with a pedestrian where their discs touch during the step: under the rule `swept` in their
    true relative motion; under `crowdnav` with the pedestrian's velocity from before the step, as CrowdNav does. It
    succeeds where its centre ends nearer to its goal than its radius. The step after which `Rules.max_steps` are done
    is a time-out, whatever happens in it. CrowdNav's order of precedence: time-out, collision, success.

    Args:
        before: The worlds before the step.
        after: The worlds after it.

    Returns:
        The outcome and the gaps of the step.
    """
    worlds = len(before)
    check = StepCheck(np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds))
    _check(
        before.position,
        swept_motion(before.position, after.position, before.velocity, before.rules),
        after.position,
        before.goal,
        before.radius,
        before.present,
        before.step,
        before.rules.max_steps,
        *check,
    )
    return check


def swept_motion(
    before: Float[np.ndarray, "world agent 2"],
    after: Float[np.ndarray, "world agent 2"],
    velocity_before: Float[np.ndarray, "world agent 2"],
    rules: Rules,
) -> Float[np.ndarray, "world agent 2"]:
    """How the collision check sees everybody move in a step, in metres.

    Args:
        before: Positions before the step in metres.
        after: Positions after the step in metres.
        velocity_before: Velocities before the step in m/s.
        rules: Its `collision` says which rule holds.

    Returns:
        The motion of each agent during the step, straight and at constant speed.
    """
    motion = after - before
    if rules.collision == "crowdnav":
        motion[:, 1:] = velocity_before[:, 1:] * rules.dt
    return motion


@no_type_check
@njit(cache=True, nogil=True)
def step_outcome(gap, wall_gap, dx, dy, radius, is_last):
    """The outcome of a step for one agent, as an int.

    `gap` and `wall_gap` are the smallest distances in metres to other agents and to obstacles during the step,
    `dx, dy` is the way from the agent's centre to its goal after the step in metres, `radius` its radius in metres,
    and `is_last` whether the time is over after this step.
    """
    if is_last:
        return Outcome.TIMEOUT.value
    if gap < 0.0:
        return Outcome.COLLISION.value
    if wall_gap < 0.0:
        return Outcome.WALL_COLLISION.value
    if math.sqrt(dx * dx + dy * dy) < radius:
        return Outcome.SUCCESS.value
    return Outcome.RUNNING.value


@no_type_check
@njit(cache=True)
def _check(position, motion, end, goal, radius, present, step, max_steps, outcome, gap, wall_gap):
    for w in range(len(radius)):
        gap[w], _ = nearest_in_step(0, position[w], motion[w], radius[w], present[w])
        wall_gap[w] = np.inf
        dx, dy = goal[w, 0, 0] - end[w, 0, 0], goal[w, 0, 1] - end[w, 0, 1]
        outcome[w] = step_outcome(gap[w], wall_gap[w], dx, dy, radius[w, 0], step[w] + 1 >= max_steps)
