"""Routes: which waypoint an agent heads for. Compiled."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.geometry import local_goals
from crowdbench.core.types import Trace, World
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.utils.compiled import njit

SIGHT_GAP = 0.01
"""A waypoint is in sight where the straight way to it passes all walls with this gap, in metres."""

REACH = 1.0
"""In a world without obstacles, where all waypoints are in sight, a waypoint is reached at this distance in metres."""


def goals_on_way(world: World) -> Float[np.ndarray, "world agent 2"]:
    """The local goal of each agent in metres, see `crowdbench.core.geometry.local_goals`."""
    return local_goals(world.position, world.goal, world.route, world.waypoint)


def goals_in_trace(trace: Trace) -> Float[np.ndarray, "world time 2"]:
    """The vehicle's local goal in metres in every state of a trace; the goal after an episode's end."""
    goal = trace.goal[:, :, 0]
    if trace.route.shape[1] == 0:
        return goal
    goals, waypoint = goal.copy(), np.zeros((len(trace), 1), np.int64)
    for t in range(trace.steps.max() + 1):
        rows = np.flatnonzero(trace.steps >= t)
        vehicle = trace.position[rows, t, :1], goal[rows, t, None], trace.route[rows, None]
        if t > 0:
            waypoint[rows] = next_waypoints(*vehicle, waypoint[rows], trace.radius[rows, t, :1], trace.obstacles[rows])
        goals[rows, t] = local_goals(*vehicle, waypoint[rows])[:, 0]
    return goals


def next_waypoints(
    position: Float[np.ndarray, "world agent 2"],
    goal: Float[np.ndarray, "world agent 2"],
    route: Float[np.ndarray, "world agent waypoint 2"],
    waypoint: Int[np.ndarray, "world agent"],
    radius: Float[np.ndarray, "world agent"],
    obstacles: Float[np.ndarray, "world polygon corner 2"],
) -> Int[np.ndarray, "world agent"]:
    """The waypoint that each agent heads for next.

    Among obstacles it is the last one of the route that is in sight, the goal included: a disc of the agent's radius
    could go straight there. Where there is none, as beside a wall, it is the last one to which no wall crosses the line
    from the agent's centre, and else it does not change. Without obstacles it is the first one that the agent has not
    reached.

    Args:
        position: Centres in metres.
        goal: Goals in metres.
        route: Waypoints on the way to the goal, in metres, NaN after the last one.
        waypoint: Index of the waypoint that each agent has been heading for.
        radius: Radii in metres.
        obstacles: Polygons in metres, NaN after the last corner.

    Returns:
        Indices of waypoints; the number of waypoints of the route for the goal.
    """
    if route.shape[2] == 0:
        return waypoint
    following = waypoint.copy()
    _next_waypoints(*map(np.ascontiguousarray, (position, goal, route, radius, obstacles)), following)
    return following


@no_type_check
@njit
def _next_waypoints(position, goal, route, radius, obstacles, waypoint):
    """Update `waypoint`, see `next_waypoints`."""
    worlds, agents = waypoint.shape
    for w in range(worlds):
        walled = obstacles.shape[1] > 0 and not math.isnan(obstacles[w, 0, 0, 0])
        for i in range(agents):
            last = 0
            while last < route.shape[2] and not math.isnan(route[w, i, last, 0]):
                last += 1
            x, y = position[w, i, 0], position[w, i, 1]
            if walled:
                # Whoever touches a wall cannot go anywhere by its whole disc, and looks along the line of its centre.
                visible = _last_in_sight(x, y, radius[w, i] + SIGHT_GAP, goal[w, i], route[w, i], last, obstacles[w])
                if visible < 0:
                    visible = _last_in_sight(x, y, 0.0, goal[w, i], route[w, i], last, obstacles[w])
                if visible >= 0:
                    waypoint[w, i] = visible
            else:
                while waypoint[w, i] < last:
                    target = route[w, i, waypoint[w, i]]
                    if math.hypot(target[0] - x, target[1] - y) >= REACH:
                        break
                    waypoint[w, i] += 1


@no_type_check
@njit
def _last_in_sight(x, y, radius, goal, route, last, obstacles):
    """The index of the last waypoint to which a disc can go straight, `last` for the goal; -1 if there is none."""
    for k in range(last, -1, -1):
        target = goal if k == last else route[k]
        if not touches_in_step(x, y, target[0] - x, target[1] - y, radius, obstacles):
            return k
    return -1
