"""Geometry in the plane: moving discs, headings, vectors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from crowdbench.core.arrays import Numbers, Vectors
from crowdbench.utils.compiled import njit


class Discs(NamedTuple):
    """Agents of one world in a step, as discs that move in straight lines at constant speed. For kernels.

    Attributes:
        position: Centres before the step in metres.
        motion: Displacements in the step in metres.
        radius: In metres.
        counts: True for agents with which others can collide.
    """

    position: Float[np.ndarray, "agent 2"]
    motion: Float[np.ndarray, "agent 2"]
    radius: Float[np.ndarray, "agent"]
    counts: Bool[np.ndarray, "agent"]


@no_type_check
@njit
def nearest_in_step(i, discs):
    """Return the smallest distance between an agent's rim and any other agent's during a step. Compiled.

    Args:
        i (int): Index of the agent.
        discs (Discs): All agents.

    Returns:
        distance (float): In metres, negative if discs overlap; infinite if no agent counts.
        nearest (int): Index of the nearest agent; -1 if no agent counts.
    """
    position, motion, radius, counts = discs
    least, nearest = np.inf, -1
    for j in range(len(radius)):
        if j != i and counts[j]:
            x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            dx, dy = motion[j, 0] - motion[i, 0], motion[j, 1] - motion[i, 1]
            squared = dx * dx + dy * dy
            share = min(max(-(x * dx + y * dy) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
            x, y = x + share * dx, y + share * dy
            gap = math.sqrt(x * x + y * y) - radius[j] - radius[i]
            if gap < least:
                least, nearest = gap, j
    return least, nearest


def norm(vector: Vectors) -> Numbers:
    """Return the length of each vector."""
    x, y = vector[..., 0], vector[..., 1]
    return np.sqrt(x * x + y * y)


def dot(a: Float[np.ndarray, "*#batch 2"], b: Float[np.ndarray, "*#batch 2"]) -> Float[np.ndarray, "..."]:
    """Return the scalar product of each pair of vectors."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def least_distance(
    between: Float[np.ndarray, "*#batch 2"], motion: Float[np.ndarray, "*#batch 2"]
) -> Float[np.ndarray, "..."]:
    """Return the smallest distance in metres between two points during a step, in which both move in straight lines.

    Args:
        between: The vector between them at the start of the step in metres.
        motion: Its change in the step in metres.
    """
    squared = dot(motion, motion)
    nearest = np.clip(-dot(between, motion) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return norm(between + nearest[..., None] * motion)


@no_type_check
@njit
def turn(before, after):
    """Return the change from one heading to another. Compiled.

    Args:
        before (float): A heading in radians.
        after (float): Another one.

    Returns:
        change (float): In radians, in [-pi, pi).
    """
    return (after - before + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angle(angle: Numbers) -> Numbers:
    """Return angles in radians, reduced to [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def toward_goal(position: Vectors, goal: Vectors, preferred_speed: Numbers) -> Vectors:
    """Return the velocity towards the goal at the preferred speed, which decreases with the distance over the last
    metre.

    As in CrowdNav it is the vector to the goal in metres, taken as a velocity in m/s and shortened to the preferred
    speed.

    Args:
        position: Positions in metres.
        goal: Goals in metres.
        preferred_speed: In m/s.

    Returns:
        Velocities in m/s.
    """
    out = np.empty(position.shape)
    position, goal = (np.ascontiguousarray(points).reshape(-1, 2) for points in (position, goal))
    fill_toward_goal(position, goal, np.ascontiguousarray(preferred_speed).reshape(-1), out.reshape(-1, 2))
    return out


@no_type_check
@njit
def fill_toward_goal(position, goal, preferred_speed, out):
    """See `toward_goal`. Compiled.

    Args:
        position (array): `[agent, 2]`, in metres.
        goal (array): `[agent, 2]`, in metres.
        preferred_speed (array): `[agent]`, in m/s.
        out (array): `[agent, 2]`, filled: velocities in m/s.
    """
    for i in range(len(position)):
        x, y = goal[i, 0] - position[i, 0], goal[i, 1] - position[i, 1]
        scale = preferred_speed[i] / max(math.sqrt(x * x + y * y), preferred_speed[i])
        out[i, 0], out[i, 1] = scale * x, scale * y


def polygons(obstacles: Float[np.ndarray, "polygon corner 2"]) -> list[Float[np.ndarray, "corners 2"]]:
    """Return the corners of each polygon of a world in metres, without the padding."""
    corners = [polygon[~np.isnan(polygon[:, 0])] for polygon in obstacles]
    return [each for each in corners if len(each)]


def pad_points(points: Sequence[Any]) -> Float[np.ndarray, "row point 2"]:
    """Return rows of different numbers of points in one array, NaN beyond the last point of each."""
    padded = np.full((len(points), max(map(len, points), default=0), 2), np.nan)
    for row, each in zip(padded, points, strict=True):
        row[: len(each)] = each
    return padded


def pad_arrays(arrays: Sequence[np.ndarray], fill: Any, rows: int | None = None) -> Shaped[np.ndarray, "array row ..."]:
    """Return arrays of different sizes as one padded array, with `rows` rows or as many as the longest."""
    shape = np.max([array.shape for array in arrays], axis=0)
    padded = np.full((len(arrays), shape[0] if rows is None else rows, *shape[1:]), fill)
    for row, array in zip(padded, arrays, strict=True):
        row[tuple(map(slice, array.shape))] = array
    return padded


def local_goals(
    position: Vectors, goal: Vectors, route: Float[np.ndarray, "*batch waypoint 2"], waypoint: Int[np.ndarray, "*batch"]
) -> Vectors:
    """Return the local goals of agents on their routes.

    A local goal lies in the direction of the next waypoint, as far away as the goal is along the route. An agent that
    heads for it turns at waypoints without slowing down. If no waypoint is left, the local goal is the goal.

    Args:
        position: Positions in metres.
        goal: Goals in metres.
        route: Waypoints on the way to the goal, in metres, NaN after the last one.
        waypoint: Index of the next waypoint.

    Returns:
        Points in metres.
    """
    if route.shape[-2] == 0:
        return goal
    out = np.empty(position.shape)
    routes = np.ascontiguousarray(route).reshape(-1, *route.shape[-2:])
    _fill_local_goals(*map(np.ascontiguousarray, (position, goal, waypoint)), routes, out)
    return out


@no_type_check
@njit
def _fill_local_goals(position, goal, waypoint, route, out):
    """See `local_goals`; the routes are `[agent, waypoint, 2]`, the other arrays have any batch axes."""
    position, goal, out = position.reshape(-1, 2), goal.reshape(-1, 2), out.reshape(-1, 2)
    waypoint = waypoint.reshape(-1)
    for i in range(len(out)):
        x, y = position[i, 0], position[i, 1]
        ahead_x, ahead_y, first, length = 0.0, 0.0, 0.0, 0.0
        px, py = x, y
        for k in range(waypoint[i], route.shape[1] + 1):
            if k < route.shape[1] and math.isnan(route[i, k, 0]):
                continue
            qx, qy = (route[i, k, 0], route[i, k, 1]) if k < route.shape[1] else (goal[i, 0], goal[i, 1])
            leg = math.hypot(qx - px, qy - py)
            # A waypoint on which the agent stands has no direction.
            if length == 0.0:
                ahead_x, ahead_y, first = qx - x, qy - y, leg
            length += leg
            px, py = qx, qy
        if first == length:
            out[i, 0], out[i, 1] = goal[i, 0], goal[i, 1]
        else:
            out[i, 0], out[i, 1] = x + ahead_x * (length / first), y + ahead_y * (length / first)
