"""The rule of an episode: collision, arrival and time-out are defined here and nowhere else. Compiled.

The simulator calls `check_step` for the vehicle of each world. Environments (for pedestrians as agents) and the
lookahead (for predicted steps) call `step_outcome`.

A vehicle on wheels drives an arc. The check sweeps each of its discs along chords of the arc, with an error of at most
a millimetre. A holonomic vehicle is a disc that moves straight.
"""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.dynamics.kernels import HOLONOMIC, along_arc, chords, signed_speed
from crowdbench.core.geometry import Discs, nearest_in_step
from crowdbench.core.types import COLLISION_RULES, Outcome
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.utils.compiled import njit

_CROWDNAV, _CROWDNAV_PLUS = COLLISION_RULES.index("crowdnav"), COLLISION_RULES.index("crowdnav_plus")


class StepCheck(NamedTuple):
    """Result of the check of a step for the vehicle of each world.

    Attributes:
        outcome: An `Outcome`.
        gap: Smallest distance in metres between the vehicle's rim and a pedestrian's in the step; infinite without
            pedestrians.
        wall_gap: Smallest distance in metres between the vehicle's rim and the obstacles; infinite without obstacles.
    """

    outcome: Int[np.ndarray, "world"]
    gap: Float[np.ndarray, "world"]
    wall_gap: Float[np.ndarray, "world"]


@no_type_check
@njit
def check_step(rules, before, after, check):
    """Compute the outcome of a step, and the smallest distances of the vehicle to pedestrians and obstacles in it.

    - Time-out: it is the last step of `World.max_steps`, regardless of collisions or arrival in it.
    - Collision: a disc of the vehicle overlaps that of a pedestrian during the step. Under the rule `swept` both have
      their actual motion; under `crowdnav` the pedestrian moves with its velocity from before the step, as in CrowdNav.
      No outcome if `Rules.collision_ends` is False.
    - Collision with a wall: a disc of the vehicle overlaps an obstacle during the step.
    - Success: after the step, the vehicle's position is nearer to its goal than `Rules.goal_tolerance`.

    Under the rule `crowdnav_plus` of CrowdNav++ (Liu et al. 2023), collisions and arrival are checked only at the
    positions before the step. Overlaps between two steps are not detected.

    The first of these that applies is the outcome, in CrowdNav's order.

    Args:
        rules (RuleNumbers): The rules.
        before (Before): The worlds before the step, see `crowdbench.sim.simulator`.
        after (After): The worlds after it.
        check (StepCheck): Filled.
    """
    position, radius, obstacles = before.position, before.radius, before.obstacles
    motion = np.empty(position.shape[1:])
    for w in range(len(position)):
        fill_motion(position[w], after.position[w], before.velocity[w], rules.collision, rules.dt, motion)
        discs = Discs(position[w], motion, radius[w], before.present[w])
        if rules.code == HOLONOMIC:
            check.gap[w], _ = nearest_in_step(0, discs)
            x, y, dx, dy = position[w, 0, 0], position[w, 0, 1], motion[0, 0], motion[0, 1]
            check.wall_gap[w] = wall_gap_in_step(x, y, dx, dy, radius[w, 0], obstacles[w])
        else:
            speed = signed_speed(after.velocity[w, 0, 0], after.velocity[w, 0, 1], after.heading[w])
            turn_rate = after.angular_speed[w]
            if rules.collision == _CROWDNAV_PLUS:
                speed, turn_rate = 0.0, 0.0
            arc = before.heading[w], speed, turn_rate, rules.dt
            check.gap[w], check.wall_gap[w] = gaps_on_arc(rules.body, *arc, discs, obstacles[w])
    last = before.position if rules.collision == _CROWDNAV_PLUS else after.position
    _fill_outcomes(rules, before, last, check)


@no_type_check
@njit(inline="always")
def check_disc(rules, before, after, check):
    """Compute the gaps of a vehicle that is a disc, without walls; see `check_step`."""
    position = before.position
    motion = np.empty(position.shape[1:])
    for w in range(len(position)):
        fill_motion(position[w], after.position[w], before.velocity[w], rules.collision, rules.dt, motion)
        check.gap[w], _ = nearest_in_step(0, Discs(position[w], motion, before.radius[w], before.present[w]))
        check.wall_gap[w] = math.inf
    last = before.position if rules.collision == _CROWDNAV_PLUS else after.position
    _fill_outcomes(rules, before, last, check)


@no_type_check
@njit(inline="always")
def _fill_outcomes(rules, before, last, check):
    """Fill the outcomes from the gaps, and from the positions at which arrival counts; see `check_step`."""
    goal = before.goal
    for w in range(len(goal)):
        dx, dy = goal[w, 0, 0] - last[w, 0, 0], goal[w, 0, 1] - last[w, 0, 1]
        near = rules.goal_tolerance if rules.goal_tolerance > 0.0 else before.radius[w, 0]
        is_last = before.step[w] + 1 >= before.max_steps[w]
        gap = check.gap[w] if rules.collision_ends else math.inf
        check.outcome[w] = step_outcome(gap, check.wall_gap[w], dx, dy, near, is_last)


@no_type_check
@njit
def fill_motion(before, after, velocity_before, rule, dt, motion):
    """Fill in the motion of all agents of one world in a step, as the collision check takes it.

    Args:
        before (array): `[agent, 2]`, positions before the step in metres.
        after (array): `[agent, 2]`, positions after it.
        velocity_before (array): `[agent, 2]`, in m/s.
        rule (int): Index of the collision rule in `COLLISION_RULES`.
        dt (float): Duration of the step in seconds.
        motion (array): `[agent, 2]`, filled: displacements in metres, along a straight line at constant speed.
    """
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
    """Return the outcome of a step for one agent.

    Args:
        gap (float): Smallest distance in metres between its rim and another agent's during the step.
        wall_gap (float): The same to the obstacles.
        dx (float): x of the vector from its centre to its goal after the step, in metres.
        dy (float): Its y.
        tolerance (float): Distance in metres to its goal below which it has arrived.
        is_last (bool): True if this is the last step of the time limit.

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
@njit(nogil=True)
def gaps_on_arc(body, heading, speed, turn_rate, dt, discs, obstacles):
    """Return the smallest distances between the vehicle's rim and the rims of pedestrians, and obstacles, during a
    step.

    Compiled, for one world.

    Args:
        body (array): The centres of its discs, in metres ahead of its position.
        heading (float): Its heading before the step in radians.
        speed (float): Its speed during the step in m/s, negative if it drives backwards.
        turn_rate (float): Its turn rate during the step in rad/s.
        dt (float): Duration of the step in seconds.
        discs (Discs): The vehicle, whose motion is not read, and the pedestrians.
        obstacles (array): `[polygon, corner, 2]`, in metres, NaN after the last corner.

    Returns:
        gap (float): To pedestrians, in metres; negative if discs overlap, infinite without pedestrians.
        wall_gap (float): To obstacles, in metres; negative if they overlap, infinite without obstacles.
    """
    position, motion = discs.position, discs.motion
    x, y = position[0, 0], position[0, 1]
    number = chords(speed, turn_rate, max(abs(body[0]), abs(body[-1])), dt)
    # In loops, because numba takes seconds to compile array expressions.
    begin, chord = np.empty(position.shape), np.empty(motion.shape)
    on_chord = Discs(begin, chord, discs.radius, discs.counts)
    for agent in range(1, len(position)):
        for axis in range(2):
            chord[agent, axis] = motion[agent, axis] / number
    gap, wall_gap = math.inf, math.inf
    for k in range(number):
        x0, y0, before = along_arc(x, y, heading, speed, turn_rate, dt * k / number)
        x1, y1, after = along_arc(x, y, heading, speed, turn_rate, dt * (k + 1) / number)
        for agent in range(1, len(position)):
            for axis in range(2):
                begin[agent, axis] = position[agent, axis] + k * chord[agent, axis]
        for ahead in body:
            begin[0, 0], begin[0, 1] = x0 + ahead * math.cos(before), y0 + ahead * math.sin(before)
            chord[0, 0] = x1 + ahead * math.cos(after) - begin[0, 0]
            chord[0, 1] = y1 + ahead * math.sin(after) - begin[0, 1]
            nearest, _ = nearest_in_step(0, on_chord)
            gap = min(gap, nearest)
            wall = wall_gap_in_step(begin[0, 0], begin[0, 1], chord[0, 0], chord[0, 1], discs.radius[0], obstacles)
            wall_gap = min(wall_gap, wall)
    return gap, wall_gap


@no_type_check
@njit(nogil=True)
def stopping_gap(body, deceleration, x, y, vx, vy, heading, radius, obstacles):
    """Return the smallest distance to obstacles while the vehicle brakes to a standstill, straight ahead. Compiled.

    A vehicle that cannot stop in front of a wall is in an inevitable collision state (Fraichard and Asama 2004).

    Args:
        body (array): The centres of its discs, in metres ahead of its position.
        deceleration (float): Largest deceleration in m/s^2; infinite if it can stop at once.
        x (float): x of its position in metres.
        y (float): Its y.
        vx (float): x of its velocity in m/s.
        vy (float): Its y.
        heading (float): Its heading in radians.
        radius (float): The radius of its discs in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres, NaN after the last corner.

    Returns:
        gap (float): In metres; negative if it would hit an obstacle.
    """
    gap = math.inf
    if deceleration == math.inf:
        return gap
    time = math.hypot(vx, vy) / (2.0 * deceleration)
    c, s = math.cos(heading), math.sin(heading)
    for ahead in body:
        gap = min(gap, wall_gap_in_step(x + ahead * c, y + ahead * s, vx * time, vy * time, radius, obstacles))
    return gap
