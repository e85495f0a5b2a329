"""The least time of the vehicle to its goal in the empty world: a lower bound for all drives, in steps.

No commands bring the vehicle to its goal in fewer steps, with or without pedestrians. The bound has two parts:

- The path is not shorter than that of a disc that the body always covers, around obstacles whose rounded corners are
  cut by regular polygons.
- The displacement towards the goal is not shorter than the distance to it. A vehicle on wheels moves along its
  heading, which changes gradually.

Both end at the goal's tolerance. The vehicle has its highest speed as early as the limits permit.
"""

from __future__ import annotations

import functools
import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from crowdbench.core.arrays import Polygons, Walls, WorldPoints
from crowdbench.core.dynamics import Holonomic
from crowdbench.core.dynamics.kernels import CHORD_ERROR, HOLONOMIC, SPEED_TOLERANCE, UNICYCLE
from crowdbench.core.geometry import norm, wrap_angle
from crowdbench.core.types import Rules
from crowdbench.sim.obstacles import wall_gap_in_step
from crowdbench.utils.compiled import njit

_SIDES = 16
"""Sides of the polygons around corners. A path around a corner is too short by 2 % of the radius at most."""

_INNER = math.cos(math.pi / _SIDES)
"""Radius of the circle inside such a polygon as a share of the one around it."""

_ENDS = 64
"""Number of points on the circle around a goal beside a wall, where paths end."""

_MOST = 100_000
"""Number of steps after which the vehicle has its highest speed and the right heading in any case."""

_ROUNDING = 1e-6
"""Length in metres that a drive may lack because of rounding."""


def least_steps(
    rules: Rules,
    start: WorldPoints,
    goal: WorldPoints,
    *,
    velocity: WorldPoints,
    heading: Float[np.ndarray, "world"],
    radius: Float[np.ndarray, "world"],
    max_speed: Float[np.ndarray, "world"],
    obstacles: Walls,
) -> Int[np.ndarray, "world"]:
    """Return the least number of steps of each vehicle to its goal, see the top of this file.

    Args:
        rules: The rules.
        start: Starts in metres.
        goal: Goals in metres.
        velocity: Velocities at the start in m/s.
        heading: Headings at the start in radians.
        radius: Radii of the discs of the bodies in metres.
        max_speed: Largest speeds in m/s.
        obstacles: Polygons in metres.
    """
    near = radius if rules.goal_tolerance is None else np.full(len(radius), rules.goal_tolerance)
    offset = goal - start
    straight = norm(offset) - near
    # Under CrowdNav++'s rule, the vehicle is checked at single positions: a step may lead through a wall.
    jumps = rules.collision == "crowdnav_plus"
    length = straight.copy()
    has_walls = obstacles.shape[1] > 0 and not jumps
    for w in np.flatnonzero(has_walls & (straight > 0.0)).tolist():
        path = _shortest_path(start[w], goal[w], float(near[w]), _covered(rules, float(radius[w])), obstacles[w])
        length[w] = max(length[w], path)
    angle = np.abs(wrap_angle(np.arctan2(offset[:, 1], offset[:, 0]) - heading))
    speeds = norm(velocity), max_speed * (1.0 + SPEED_TOLERANCE)
    delay, lag = round(rules.actuation.delay / rules.dt), rules.actuation.lag
    share = -math.expm1(-rules.dt / lag) if lag else 1.0
    steps = np.empty(len(start), np.int64)
    numbers = rules.numbers
    _fill_steps(numbers.code, numbers.limits, rules.dt, delay, share, length, straight, angle, *speeds, steps)
    # Under that rule, arrival is checked before the step.
    return np.maximum(steps + jumps, 1)


def _covered(rules: Rules, radius: float) -> float:
    """Return the radius in metres of a disc around the vehicle's position that its body of such discs covers."""
    if not isinstance(rules.dynamics, Holonomic):
        radius = max(radius - CHORD_ERROR, 0.0)  # it drives arcs, which the collision check replaces by chords
    behind = [-ahead for ahead in rules.body if ahead <= 0.0]
    before = [ahead for ahead in rules.body if ahead >= 0.0]
    if behind and before:
        return math.sqrt(max(radius**2 - min(behind) * min(before), 0.0))
    return max(radius - min(behind or before), 0.0)


def _shortest_path(
    start: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"], near: float, radius: float, obstacles: Polygons
) -> float:
    """Return a lower bound in metres for the path of a disc to a position nearer than `near` to its goal.

    Args:
        start: Start in metres.
        goal: Goal in metres.
        near: The goal's tolerance in metres.
        radius: Radius of the disc in metres.
        obstacles: Polygons in metres.
    """
    ends, slack = goal[None], near
    if wall_gap_in_step(*goal, 0.0, 0.0, radius, obstacles) < near:
        # A wall may part the goal from positions within its tolerance: a path ends on the circle around it, at most
        # `slack` from one of these points. The disc is smaller by as much, so that it can go from there to the point.
        angle = np.arange(_ENDS) * (2.0 * np.pi / _ENDS)
        ends, slack = goal + near * np.stack([np.cos(angle), np.sin(angle)], axis=1), near * np.pi / _ENDS
        radius = max(radius - slack, 0.0)
    length = float(_path_lengths(start, ends, radius, obstacles).min()) - slack
    return length if math.isfinite(length) else math.dist(start, goal) - near


def _path_lengths(
    start: Float[np.ndarray, "2"], ends: Float[np.ndarray, "end 2"], radius: float, obstacles: Polygons
) -> Float[np.ndarray, "end"]:
    """Return lower bounds in metres for the paths of a disc from `start` to some points, infinite without a path."""
    inner = radius * _INNER
    if len(ends) == 1 and _are_free(start[None], ends, inner, obstacles)[0]:
        return norm(ends - start)
    corner, lines = _roadmap(obstacles.tobytes(), obstacles.shape, radius)
    point, first = np.concatenate([corner, start[None], ends]), len(corner)
    more = np.stack(np.meshgrid(np.arange(first + 1), np.arange(first, len(point))), axis=2).reshape(-1, 2)
    more = more[_are_free(point[more[:, 0]], point[more[:, 1]], inner, obstacles)]
    lines = np.concatenate([lines, more])
    length = norm(point[lines[:, 1]] - point[lines[:, 0]])
    graph = coo_array((length, tuple(lines.T)), shape=(len(point), len(point))).tocsr()
    return np.asarray(dijkstra(graph, directed=False, indices=first)[first + 1 :])


@functools.lru_cache(maxsize=32)
def _roadmap(
    obstacles: bytes, shape: tuple[int, ...], radius: float
) -> tuple[Float[np.ndarray, "node 2"], Int[np.ndarray, "line 2"]]:
    """Return the points where shortest paths of a disc bend, and the pairs of them with a free line between them.

    The points are the vertices of regular polygons inside the circles around corners. Lines may enter these circles, up
    to the largest circle inside the polygon: so no path is missing. Cached, because most layouts have the same
    obstacles in all cases.

    Args:
        obstacles: The bytes of polygons in metres, in double precision.
        shape: Their shape, `[polygon, corner, 2]`.
        radius: The radius of the disc in metres.
    """
    polygon = np.ndarray(shape, np.float64, obstacles)
    angle = np.arange(_SIDES) * (2.0 * np.pi / _SIDES)
    corners = np.unique(polygon[np.isfinite(polygon[..., 0])], axis=0)
    node = (corners[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)).reshape(-1, 2)
    node = node[_are_free(node, node, radius * _INNER, polygon)]
    pairs = np.stack(np.triu_indices(len(node), 1), axis=1)
    return node, pairs[_are_free(node[pairs[:, 0]], node[pairs[:, 1]], radius * _INNER, polygon)]


def _are_free(
    start: Float[np.ndarray, "line 2"], end: Float[np.ndarray, "line 2"], radius: float, obstacles: Polygons
) -> Bool[np.ndarray, "line"]:
    """Return whether a disc with a radius in metres can move straight from each start to the end, in metres."""
    free = np.empty(len(start), bool)
    _fill_free(start, end, radius - _ROUNDING, obstacles, free)
    return free


@no_type_check
@njit(nogil=True)
def _fill_free(start, end, radius, obstacles, free):
    """See `_are_free`."""
    for i in range(len(start)):
        x, y = start[i]
        free[i] = wall_gap_in_step(x, y, end[i, 0] - x, end[i, 1] - y, radius, obstacles) >= 0.0


@no_type_check
@njit(nogil=True)
def _fill_steps(code, limits, dt, delay, share, length, straight, angle, speed, max_speed, steps):
    """Fill in the number of steps of each vehicle.

    Args:
        code (int): Code of the dynamics.
        limits (array): `Dynamics.limits`.
        dt (float): Length of a step in seconds.
        delay (int): Number of steps before the first command acts.
        share (float): Share of the change of a command that is executed in a step.
        length (array): `[world]`, length of the path in metres.
        straight (array): `[world]`, displacement in metres.
        angle (array): `[world]`, angle between the heading and the goal in radians.
        speed (array): `[world]`, speed at the start in m/s.
        max_speed (array): `[world]`, in m/s.
        steps (array): `[world]`, filled.
    """
    for w in range(len(steps)):
        ahead, back, executed = speed[w], 0.0, 0.0
        reverse = max_speed[w] if code == HOLONOMIC else min(limits[3], max_speed[w])
        turned, rate = 0.0, 0.0
        path, left, k = length[w], straight[w], 0
        while max(path, left) > _ROUNDING and k < _MOST:
            k += 1
            if k > delay:
                executed += share * (max_speed[w] - executed)
            change = limits[0] * dt
            ahead = min(min(ahead + change, max_speed[w]), max(ahead, executed))
            back = min(min(back + change, reverse), max(back, executed))
            if code == HOLONOMIC:
                turned = math.pi
            elif code == UNICYCLE:
                rate = min(rate + limits[2] * dt, limits[1])
                turned += rate * dt
            else:
                turned += ahead * dt * math.tan(limits[1]) / limits[2]
            toward = ahead * math.cos(min(max(angle[w] - turned, 0.0), math.pi))
            away = back * math.cos(min(max(math.pi - angle[w] - turned, 0.0), math.pi))
            path -= ahead * dt
            left -= max(toward, away, 0.0) * dt
        rest = max(path, left) - _ROUNDING
        if rest > 0.0:
            k += math.ceil(min(rest / (max_speed[w] * dt), 1e15))
        steps[w] = k
