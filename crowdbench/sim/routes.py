"""Routes: the next waypoint of each agent, and new routes for agents without a waypoint in sight. Compiled."""

from __future__ import annotations

import contextlib
import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.core.arrays import AgentFlags, AgentInts, AgentNumbers, AgentPoints, Walls, WorldPaths
from crowdbench.core.geometry import local_goals
from crowdbench.core.types import Trace, World
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.sim.visibility_graph import find_routes
from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import InputError

Routes = Float[np.ndarray, "world agent waypoint 2"]
Rerouted = Float[np.ndarray, "world agent waypoint_after 2"]

SIGHT_GAP = 0.01
"""Smallest gap in metres between walls and the straight path to a waypoint that is in sight."""

REACH = 1.0
"""Distance in metres at which a waypoint is reached in a world without obstacles, where all waypoints are in sight."""


def goals_on_way(world: World) -> AgentPoints:
    """Return the local goal of each agent in metres, see `crowdbench.core.geometry.local_goals`."""
    return local_goals(world.position, world.goal, world.route, world.waypoint)


def goals_in_trace(trace: Trace) -> WorldPaths:
    """Return the vehicle's local goal in metres in every state of a trace; the goal after an episode's end."""
    goal = trace.goal[:, :, 0]
    if not trace.route.shape[1] and not trace.obstacles.shape[1]:
        return goal
    goals, waypoint, route = goal.copy(), np.zeros((len(trace), 1), np.int64), trace.route[:, None]
    for t in range(trace.steps.max() + 1):
        runs, vehicle = trace.steps >= t, (trace.position[:, t, :1], goal[:, t, None])
        if t > 0:
            sizes = trace.radius[:, t, :1], trace.obstacles, runs[:, None]
            route, waypoint = follow_routes(*vehicle, route, waypoint, *sizes)
        goals[runs, t] = local_goals(*vehicle, route, waypoint)[runs, 0]
    return goals


def follow_routes(
    position: AgentPoints,
    goal: AgentPoints,
    route: Routes,
    waypoint: AgentInts,
    radius: AgentNumbers,
    obstacles: Walls,
    present: AgentFlags,
) -> tuple[Rerouted, AgentInts]:
    """Return the routes of agents after a step, and the next waypoint of each agent.

    An agent that was pushed off its route, so that no point of it is in sight, gets the shortest path from its
    position. It keeps its route if no path is wide enough.

    Args:
        position: Centres in metres; see `next_waypoints`.
        goal: Goals in metres.
        route: Waypoints in metres.
        waypoint: Index of the current waypoint of each agent.
        radius: Radii in metres.
        obstacles: Polygons in metres.
        present: True if the agent is present.
    """
    following, lost = next_waypoints(position, goal, route, waypoint, radius, obstacles)
    if not (lost & present).any():
        return route, following
    route = route.copy()
    for w, agent in np.argwhere(lost & present).tolist():
        start, end, size = position[w, agent, None], goal[w, agent, None], radius[w, agent, None]
        with contextlib.suppress(InputError):  # no path is wide enough
            route = with_route(route, w, agent, find_routes(start, end, size, obstacles[w])[0])
            following[w, agent] = 0
    return route, following


def with_route(route: Routes, row: int, agent: int, points: Float[np.ndarray, "point 2"]) -> Rerouted:
    """Replace the waypoints of one agent, in metres: in this array, or in a longer one if they do not fit."""
    if (longer := len(points) - route.shape[2]) > 0:
        route = np.pad(route, [(0, 0), (0, 0), (0, longer), (0, 0)], constant_values=np.nan)
    route[row, agent] = np.nan
    route[row, agent, : len(points)] = points
    return route


def next_waypoints(
    position: AgentPoints,
    goal: AgentPoints,
    route: Routes,
    waypoint: AgentInts,
    radius: AgentNumbers,
    obstacles: Walls,
) -> tuple[AgentInts, AgentFlags]:
    """Return the next waypoint of each agent, and a mask of the agents without one in sight.

    Among obstacles it is the last point of the route in sight, the goal included: a disc of the agent's radius could
    move straight to it. If there is none, as beside a wall, it is the last point to which no wall crosses the line from
    the agent's centre; otherwise it does not change. Without obstacles it is the first waypoint that the agent has not
    reached.

    Args:
        position: Centres in metres.
        goal: Goals in metres.
        route: Waypoints on the way to the goal, in metres, NaN after the last one.
        waypoint: Index of the current waypoint of each agent.
        radius: Radii in metres.
        obstacles: Polygons in metres, NaN after the last corner.

    Returns:
        Indices of waypoints (for the goal, the number of waypoints of the route), and the mask.
    """
    lost = np.zeros(waypoint.shape, np.bool_)
    if not route.shape[2] and not obstacles.shape[1]:
        return waypoint, lost
    following = waypoint.copy()
    _next_waypoints(*map(np.ascontiguousarray, (position, goal, route, radius, obstacles)), following, lost)
    return following, lost


@no_type_check
@njit
def _next_waypoints(position, goal, route, radius, obstacles, waypoint, lost):
    """Update `waypoint`, and fill `lost`; see `next_waypoints`."""
    worlds, agents = waypoint.shape
    for w in range(worlds):
        walled = obstacles.shape[1] > 0 and not math.isnan(obstacles[w, 0, 0, 0])
        for i in range(agents):
            last = 0
            while last < route.shape[2] and not math.isnan(route[w, i, last, 0]):
                last += 1
            x, y = position[w, i, 0], position[w, i, 1]
            if walled:
                # An agent that touches a wall cannot move its whole disc anywhere: the line of its centre counts.
                visible = _last_in_sight(x, y, radius[w, i] + SIGHT_GAP, goal[w, i], route[w, i], last, obstacles[w])
                if visible < 0:
                    visible = _last_in_sight(x, y, 0.0, goal[w, i], route[w, i], last, obstacles[w])
                lost[w, i] = visible < 0
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
    """Return the index of the last waypoint to which a disc can go straight, `last` for the goal; -1 if there is
    none."""
    for k in range(last, -1, -1):
        target = goal if k == last else route[k]
        if not touches_in_step(x, y, target[0] - x, target[1] - y, radius, obstacles):
            return k
    return -1
