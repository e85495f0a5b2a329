"""Successors of the states of a beam: every command of every state, checked as in the simulator. Compiled."""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.core import COLLISION_RULES, HOLONOMIC, Discs, Motion, drive, nearest_in_step
from crowdbench.metrics import fill_close_seconds
from crowdbench.sim import fill_motion, gaps_on_arc, wall_gap_in_step
from crowdbench.utils import njit
from studies.best_times.cost_to_go import cost_left

SAFE = 1e-9
"""Excess of a gap over 0, in metres, so that rounding does not cause a collision."""

CLOSE_REACH = 0.6
"""Gap in metres from which pedestrians do not count as close, see `crowdbench.metrics.closeness`."""

GRID_ERROR = 1.028
"""Largest ratio of a path on the grid of `CostToGo` to the shortest path."""

_SWEPT = COLLISION_RULES.index("swept")


class Successors(NamedTuple):
    """Successors of all states by all commands. For kernels.

    Attributes:
        state: Position, velocity, heading and turn rate.
        left: Estimate of the remaining time in seconds, 0 at the goal; infinite if the successor is discarded.
        close: Seconds close to pedestrians so far.
        arrived: True at the goal.
    """

    state: Float[np.ndarray, "state action 6"]
    left: Float[np.ndarray, "state action"]
    close: Float[np.ndarray, "state action"]
    arrived: Bool[np.ndarray, "state action"]

    @classmethod
    def empty(cls, states: int, actions: int) -> Successors:
        """Return arrays to fill."""
        shape = states, actions
        return cls(np.empty((*shape, 6)), np.full(shape, np.inf), np.zeros(shape), np.zeros(shape, bool))


@no_type_check
@njit(nogil=True)
def steps_left(length, speed, max_speed, change, tolerance, dt):
    """Return the least number of steps along a path, as a fraction. Compiled.

    Args:
        length (float): Length of the path to the goal in metres.
        speed (float): Speed now in m/s.
        max_speed (float): Largest speed in m/s.
        change (float): Largest change of speed in a step, in m/s.
        tolerance (float): Distance to the goal in metres at which the vehicle has arrived.
        dt (float): Length of a step in seconds.
    """
    rest, steps = length - tolerance, 0.0
    while rest > 0.0 and speed < max_speed:
        speed = min(speed + change, max_speed)
        way = min(speed * dt, rest)
        steps += way / (speed * dt)
        rest -= way
    return steps + max(rest, 0.0) / (max_speed * dt)


@no_type_check
@njit(nogil=True)
def fill_successors(vehicle, cost, states, close, commands, crowds, budget, found):
    """Fill in the successors that are free of collisions and can arrive within a budget.

    Args:
        vehicle (Vehicle): Motion of the vehicle, and the obstacles.
        cost (CostToGo): The lengths of the paths to its goal.
        states (array): `[state, 6]`, as in `Successors`.
        close (array): `[state]`, seconds close to pedestrians so far.
        commands (array): `[state, action, 2]`.
        crowds (CrowdStep): Motion of the crowd of each state in the step.
        budget (float): Largest sum of the remaining time, from before the step, and the seconds close, in seconds.
        found (Successors): Filled.
    """
    rules, max_speed, tolerance, obstacles = vehicle
    before, end, velocity, radius, present = crowds
    agents, dt, is_arc = radius.shape[1], rules.dt, rules.code != HOLONOMIC
    motion = np.empty((agents, 2))
    reach, size = max(abs(rules.body[0]), abs(rules.body[-1])), radius[0, 0]
    near_radius, near_present = np.empty(agents), np.ones(agents, np.bool_)
    place, moved = np.empty((agents, 2)), np.empty((agents, 2))
    person, one_step, seconds = np.zeros((1, 2, agents - 1), np.int64), np.ones(1, np.int64), np.zeros(1)
    position, radii = np.empty((1, 2, agents, 2)), np.empty((1, 2, agents))
    faces, speeds = np.empty((1, 2)), np.empty((1, 2, 1, 2))
    for s in range(len(states)):
        x, y, vx, vy, heading, turn_rate = states[s]
        now = Motion(x, y, vx, vy, heading, turn_rate)
        fill_motion(before[s], end[s], velocity[s], _SWEPT, dt, motion)
        near_radius[0], near = size, 1
        for j in range(1, agents):
            far = 2.0 * reach + max_speed * dt + math.hypot(motion[j, 0], motion[j, 1])
            far += size + radius[s, j] + CLOSE_REACH
            if present[s, j] and math.hypot(before[s, j, 0] - x, before[s, j, 1] - y) <= far:
                place[near], moved[near], near_radius[near] = before[s, j], motion[j], radius[s, j]
                position[0, 0, near], position[0, 1, near] = before[s, j], before[s, j] + motion[j]
                near += 1
        radii[0, 0, :near], radii[0, 1, :near] = near_radius[:near], near_radius[:near]
        discs = Discs(place[:near], moved[:near], near_radius[:near], near_present[:near])
        for a in range(commands.shape[1]):
            then = drive(rules.code, rules.limits, now, (commands[s, a, 0], commands[s, a, 1]), max_speed, dt)
            nx, ny, nvx, nvy, after, turned = then
            straight = math.hypot(cost.goal[0] - nx, cost.goal[1] - ny)
            arrived = straight < tolerance
            length, speed = cost_left(nx, ny, cost), math.hypot(nvx, nvy)
            if math.isinf(length):
                continue
            change = rules.limits[0] * dt
            least = max(length / GRID_ERROR, straight) if len(cost.length) else length
            least_time = 0.0
            if not arrived:
                least = steps_left(least, speed, max_speed, change, tolerance, dt)
                least_time = max(math.ceil(least - 1e-6), 1.0) * dt
            if close[s] + dt + least_time > budget:
                continue
            place[0, 0], place[0, 1], moved[0, 0], moved[0, 1] = x, y, nx - x, ny - y
            if is_arc:
                gap, wall_gap = gaps_on_arc(rules.body, heading, speed, turned, dt, discs, obstacles)
            else:
                gap, _ = nearest_in_step(0, discs)
                wall_gap = wall_gap_in_step(x, y, nx - x, ny - y, size, obstacles)
            if min(gap, wall_gap) < SAFE:
                continue
            seconds[0] = 0.0
            if gap < CLOSE_REACH:
                position[0, 0, 0], position[0, 1, 0] = place[0], place[0] + moved[0]
                faces[0, 0], faces[0, 1] = heading, after
                speeds[0, 1, 0, 0], speeds[0, 1, 0, 1] = nvx, nvy
                people = position[:, :, :near], speeds, faces, radii[:, :, :near], person[:, :, : near - 1]
                fill_close_seconds(*people, one_step, rules.body, is_arc, dt, seconds)
            if close[s] + seconds[0] + dt + least_time > budget:
                continue
            found.state[s, a] = (nx, ny, nvx, nvy, after, turned)
            found.close[s, a], found.arrived[s, a] = close[s] + seconds[0], arrived
            found.left[s, a] = 0.0
            if not arrived:
                found.left[s, a] = dt * steps_left(length, speed, max_speed, change, tolerance, dt)
