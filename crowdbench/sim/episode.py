"""The rule of an episode: collision, arrival and time-out are defined here and nowhere else.

The simulator calls `check_step` for the vehicle of each world. Environments (for pedestrians as agents) and the
lookahead (for predicted steps) call the compiled `step_outcome`.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compiled import njit
from crowdbench.dynamics.motion import HOLONOMIC
from crowdbench.geometry import nearest_in_step
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.sim.swept import gaps_on_arc
from crowdbench.types import Outcome, Rules, World


class StepCheck(NamedTuple):
    """What the check of a step found for the vehicle of each world.

    Attributes:
        outcome: An `Outcome`.
        gap: Smallest distance in metres between the vehicle's rim and a pedestrian's in the step; infinite where
            there are no pedestrians.
        wall_gap: The same to the obstacles; infinite where there are none.
    """

    outcome: Int[np.ndarray, "world"]
    gap: Float[np.ndarray, "world"]
    wall_gap: Float[np.ndarray, "world"]


def check_step(before: World, after: World) -> StepCheck:
    """Find out whether a step ended the episode, and how close the vehicle came to pedestrians and obstacles in it.

    - Time-out: it is the last step of `Rules.max_steps`, whatever else happens in it.
    - Collision: a disc of the vehicle overlaps that of a pedestrian during the step. Under the rule `swept` both move
      as they really did; under `crowdnav` the pedestrian moves with its velocity from before the step, as in CrowdNav.
    - Collision with a wall: a disc of the vehicle overlaps an obstacle during the step.
    - Success: after the step, the vehicle's position is nearer to its goal than `Rules.goal_tolerance`.

    The first of these that applies is the outcome, in CrowdNav's order.

    Args:
        before: The worlds before the step.
        after: The worlds after it.

    Returns:
        The outcome and the gaps of the step.
    """
    worlds = len(before)
    check = StepCheck(np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds))
    rules = before.rules
    _check(
        rules.dynamics.code,
        np.array(rules.body),
        rules.goal_tolerance or 0.0,
        rules.dt,
        before.heading,
        after.velocity,
        after.angular_speed,
        before.position,
        swept_motion(before.position, after.position, before.velocity, rules),
        after.position,
        before.goal,
        before.radius,
        before.present,
        before.obstacles,
        before.step,
        rules.max_steps,
        *check,
    )
    return check


def swept_motion(
    before: Float[np.ndarray, "world agent 2"],
    after: Float[np.ndarray, "world agent 2"],
    velocity_before: Float[np.ndarray, "world agent 2"],
    rules: Rules,
) -> Float[np.ndarray, "world agent 2"]:
    """The motion of all agents in a step, as the collision check takes it.

    Args:
        before: Positions before the step in metres.
        after: Positions after the step in metres.
        velocity_before: Velocities before the step in m/s.
        rules: Its `collision` names the rule.

    Returns:
        Displacement of each agent in metres, along a straight line at constant speed.
    """
    motion = after - before
    if rules.collision == "crowdnav":
        motion[:, 1:] = velocity_before[:, 1:] * rules.dt
    return motion


@no_type_check
@njit(nogil=True)
def step_outcome(gap, wall_gap, dx, dy, tolerance, is_last):
    """The outcome of a step for one agent.

    Args:
        gap (float): Smallest distance in metres between its rim and another agent's during the step.
        wall_gap (float): The same to the obstacles.
        dx (float): x of the way from its centre to its goal after the step, in metres.
        dy (float): Its y.
        tolerance (float): Distance in metres to its goal below which it has arrived.
        is_last (bool): Whether this is the last step of the time limit.

    Returns:
        outcome (int): An `Outcome`.
    """
    if is_last:
        return Outcome.TIMEOUT.value
    if gap < 0.0:
        return Outcome.COLLISION.value
    if wall_gap < 0.0:
        return Outcome.WALL_COLLISION.value
    if math.sqrt(dx * dx + dy * dy) < tolerance:
        return Outcome.SUCCESS.value
    return Outcome.RUNNING.value


@no_type_check
@njit
def _check(
    code,
    body,
    tolerance,
    dt,
    heading,
    velocity,
    turn_rate,
    position,
    motion,
    end,
    goal,
    radius,
    present,
    obstacles,
    step,
    max_steps,
    outcome,
    gap,
    wall_gap,
):
    """Check a step of each world's vehicle.

    Args:
        code: The code of its dynamics.
        body: `[disc]`, where the centres of its discs are, in metres ahead of its position.
        tolerance: Distance in metres to its goal below which it has arrived; 0 stands for its radius.
        dt: Duration of the step in seconds.
        heading: `[world]`, the vehicle's heading before the step in radians.
        velocity: `[world, agent, 2]`, after the step, in m/s.
        turn_rate: `[world]`, the vehicle's in the step, in rad/s.
        position: `[world, agent, 2]`, before the step, in metres.
        motion: `[world, agent, 2]`, displacement in the step in metres.
        end: `[world, agent, 2]`, positions after the step in metres.
        goal: `[world, agent, 2]`, in metres.
        radius: `[world, agent]`, in metres.
        present: `[world, agent]`.
        obstacles: `[world, polygon, corner, 2]`, in metres.
        step: `[world]`, steps done before this one.
        max_steps: Steps after which an episode times out.
        outcome: `[world]`, filled: an `Outcome`.
        gap: `[world]`, filled, in metres.
        wall_gap: `[world]`, filled, in metres.
    """
    for w in range(len(radius)):
        if code == HOLONOMIC:
            gap[w], _ = nearest_in_step(0, position[w], motion[w], radius[w], present[w])
            x, y, mx, my = position[w, 0, 0], position[w, 0, 1], motion[w, 0, 0], motion[w, 0, 1]
            wall_gap[w] = wall_gap_in_step(x, y, mx, my, radius[w, 0], obstacles[w])
        else:
            own = heading[w], math.hypot(velocity[w, 0, 0], velocity[w, 0, 1]), turn_rate[w], dt
            others = motion[w], radius[w], present[w], obstacles[w]
            gap[w], wall_gap[w] = gaps_on_arc(body, *own, position[w], *others)
        dx, dy = goal[w, 0, 0] - end[w, 0, 0], goal[w, 0, 1] - end[w, 0, 1]
        near = tolerance if tolerance > 0.0 else radius[w, 0]
        outcome[w] = step_outcome(gap[w], wall_gap[w], dx, dy, near, step[w] + 1 >= max_steps)
