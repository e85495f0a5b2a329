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
from crowdbench.types import COLLISION_RULES, Outcome, Rules, World

_CROWDNAV, _CROWDNAV_PLUS = COLLISION_RULES.index("crowdnav"), COLLISION_RULES.index("crowdnav_plus")


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

    Under the rule `crowdnav_plus`, that of CrowdNav++ (Liu et al. 2023), nothing moves: collisions and arrival are
    those at the positions before the step, so that nobody notices what overlaps between two steps.

    The first of these that applies is the outcome, in CrowdNav's order.

    Args:
        before: The worlds before the step.
        after: The worlds after it.

    Returns:
        The outcome and the gaps of the step.
    """
    check = unchecked(len(before))
    rules = before.rules
    check_worlds(
        rules.dynamics.code,
        rules.discs,
        rules.goal_tolerance or 0.0,
        rules.collision_code,
        rules.dt,
        before.heading,
        after.velocity,
        after.angular_speed,
        before.position,
        before.velocity,
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


def unchecked(worlds: int) -> StepCheck:
    """Arrays for the check of so many worlds, which `check_worlds` fills."""
    return StepCheck(np.empty(worlds, np.int64), np.empty(worlds), np.empty(worlds))


def swept_motion(
    before: Float[np.ndarray, "agent 2"],
    after: Float[np.ndarray, "agent 2"],
    velocity_before: Float[np.ndarray, "agent 2"],
    rules: Rules,
) -> Float[np.ndarray, "agent 2"]:
    """The motion of all agents of one world in a step, as the collision check takes it.

    Args:
        before: Positions before the step in metres.
        after: Positions after the step in metres.
        velocity_before: Velocities before the step in m/s.
        rules: Its `collision` names the rule.

    Returns:
        Displacement of each agent in metres, along a straight line at constant speed.
    """
    motion = np.empty(before.shape)
    fill_motion(before, after, velocity_before, rules.collision_code, rules.dt, motion)
    return motion


@no_type_check
@njit
def fill_motion(before, after, velocity_before, rule, dt, motion):
    """Fill `motion [agent, 2]` of one world, see `swept_motion`."""
    for i in range(len(motion)):
        for axis in range(2):
            if rule == _CROWDNAV_PLUS:
                motion[i, axis] = 0.0
            elif rule == _CROWDNAV and i > 0:
                motion[i, axis] = velocity_before[i, axis] * dt
            else:
                motion[i, axis] = after[i, axis] - before[i, axis]


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
def check_worlds(
    code,
    body,
    tolerance,
    rule,
    dt,
    heading,
    velocity,
    turn_rate,
    position,
    velocity_before,
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
    """Check a step of each world's vehicle, see `check_step`. Compiled.

    Args:
        code (int): The code of its dynamics.
        body (array): `[disc]`, where the centres of its discs are, in metres ahead of its position.
        tolerance (float): Distance in metres to its goal below which it has arrived; 0 stands for its radius.
        rule (int): Index of the collision rule in `COLLISION_RULES`.
        dt (float): Duration of the step in seconds.
        heading (array): `[world]`, the vehicle's heading before the step in radians.
        velocity (array): `[world, agent, 2]`, after the step, in m/s.
        turn_rate (array): `[world]`, the vehicle's in the step, in rad/s.
        position (array): `[world, agent, 2]`, before the step, in metres.
        velocity_before (array): `[world, agent, 2]`, before the step, in m/s.
        end (array): `[world, agent, 2]`, positions after the step in metres.
        goal (array): `[world, agent, 2]`, in metres.
        radius (array): `[world, agent]`, in metres.
        present (array): `[world, agent]`.
        obstacles (array): `[world, polygon, corner, 2]`, in metres.
        step (array): `[world]`, steps done before this one.
        max_steps (int): Steps after which an episode times out.
        outcome (array): `[world]`, filled: an `Outcome`.
        gap (array): `[world]`, filled, in metres.
        wall_gap (array): `[world]`, filled, in metres.
    """
    motion = np.empty(position.shape[1:])
    for w in range(len(radius)):
        fill_motion(position[w], end[w], velocity_before[w], rule, dt, motion)
        if code == HOLONOMIC:
            gap[w], _ = nearest_in_step(0, position[w], motion, radius[w], present[w])
            x, y, mx, my = position[w, 0, 0], position[w, 0, 1], motion[0, 0], motion[0, 1]
            wall_gap[w] = wall_gap_in_step(x, y, mx, my, radius[w, 0], obstacles[w])
        else:
            own = heading[w], math.hypot(velocity[w, 0, 0], velocity[w, 0, 1]), turn_rate[w], dt
            if rule == _CROWDNAV_PLUS:
                own = heading[w], 0.0, 0.0, dt
            others = motion, radius[w], present[w], obstacles[w]
            gap[w], wall_gap[w] = gaps_on_arc(body, *own, position[w], *others)
        last = position if rule == _CROWDNAV_PLUS else end
        dx, dy = goal[w, 0, 0] - last[w, 0, 0], goal[w, 0, 1] - last[w, 0, 1]
        near = tolerance if tolerance > 0.0 else radius[w, 0]
        outcome[w] = step_outcome(gap[w], wall_gap[w], dx, dy, near, step[w] + 1 >= max_steps)
