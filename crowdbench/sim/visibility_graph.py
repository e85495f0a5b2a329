"""Shortest paths of discs around obstacles, over a visibility graph (Lozano-Pérez and Wesley 1979).

A path keeps a clearance from every corner: the centre of the disc must not enter a circle around it. The vertices of a
regular polygon around each circle are the nodes of the graph. Two nodes are joined if the straight line between them
enters no circle and crosses no wall.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from crowdbench.core.arrays import Agents, PerAgent, Polygons, WayPoints
from crowdbench.core.geometry import norm, pad_points, polygons
from crowdbench.utils.compiled import njit
from crowdbench.utils.errors import InputError

Points = Float[np.ndarray, "point 2"]

CLEARANCE = 0.2
"""Distance in metres between an agent's rim and the corners of obstacles on a path, if the gap is wide enough."""

LEAST_CLEARANCE = 0.02
"""Smallest clearance in metres, in narrow gaps. No path leads through a narrower gap."""

SPACING = 1.0
"""Waypoints are at most this far apart, in metres."""

SIDES = 16
"""Sides of the polygon around a corner. A path half around a corner is longer than the arc by 1.3 %."""

_TOLERANCE = 1e-6


def find_routes(start: Agents, goal: Agents, radius: PerAgent, obstacles: Polygons) -> WayPoints:
    """Return the waypoints of each agent on its shortest path to its goal.

    Args:
        start: Start of each agent in metres.
        goal: Goal of each agent in metres.
        radius: Radii in metres.
        obstacles: Polygons in metres, NaN beyond the last corner of each; two corners are a wall.

    Returns:
        Waypoints in metres, at most `SPACING` apart, without the goal, NaN after the last one of an agent.

    Raises:
        InputError: An agent has no path to its goal.
    """
    routes: list[Float[np.ndarray, "waypoint 2"]] = [np.empty((0, 2))] * len(start)
    for size in np.unique(radius):
        roadmap = _roadmap(obstacles.astype(np.float64).tobytes(), obstacles.shape, float(size))
        agents = np.flatnonzero(radius == size)
        agents = agents[~roadmap.free(start[agents], goal[agents])]
        if len(agents):
            for agent, route in zip(agents, _go_around(start[agents], goal[agents], roadmap), strict=True):
                if route is None:
                    ends = (f"({x:.3g}, {y:.3g})" for x, y in (start[agent], goal[agent]))
                    raise InputError(
                        f"no way leads {who(int(agent))} from {' to its goal at '.join(ends)}: "
                        f"it needs gaps of at least {2 * (size + LEAST_CLEARANCE):.3g} m"
                    )
                routes[agent] = route
    return _add_marks(start, goal, routes)


def who(agent: int) -> str:
    """Return the name of an agent in error messages."""
    return "the vehicle" if agent == 0 else f"pedestrian {agent}"


def edges_of(obstacles: Polygons) -> Float[np.ndarray, "edge 2 2"]:
    """Return the edges of polygons, from corner to corner in metres; a wall is a single edge."""
    edges = [np.empty((0, 2, 2))]
    for corners in polygons(obstacles):
        closed = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        edges.append(closed[:1] if len(corners) == 2 else closed)
    return np.concatenate(edges)


def solids(obstacles: Polygons) -> list[shapely.Polygon]:
    """Return the obstacles that are solid, not walls."""
    return [shapely.Polygon(corners) for corners in polygons(obstacles) if len(corners) > 2]


def nearest_on(edges: Float[np.ndarray, "edge 2 2"], points: Points) -> Float[np.ndarray, "point edge 2"]:
    """Return the point of each edge that is nearest to each of the points.

    Args:
        edges: Both ends of each edge in metres.
        points: The points in metres.

    Returns:
        In metres.
    """
    first, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    share = ((points[:, None] - first) * along).sum(2) / np.maximum((along**2).sum(1), np.finfo(float).tiny)
    return first + np.clip(share, 0.0, 1.0)[..., None] * along


def _add_marks(start: Agents, goal: Agents, routes: Sequence[np.ndarray]) -> WayPoints:
    """Return routes with waypoints at most `SPACING` apart, so that an agent pushed off its route has one in sight."""
    marked = []
    for agent, corners in enumerate(routes):
        points = np.concatenate([start[agent, None], corners, goal[agent, None]])
        legs = np.ceil(np.hypot(*np.diff(points, axis=0).T) / SPACING).astype(int)
        parts = [
            first + np.arange(1, n + 1)[:, None] / n * (last - first)
            for first, last, n in zip(points[:-1], points[1:], legs, strict=True)
        ]
        marked.append(np.concatenate([np.empty((0, 2)), *parts])[:-1])
    return pad_points(marked)


@dataclass(frozen=True)
class _Roadmap:
    """The corners of all obstacles with their clearances for agents of one radius, and the paths between them.

    Attributes:
        edges: The edges of all obstacles.
        point: The corners in metres.
        keep: Distance in metres that the centre of the agent keeps from each.
        angle: Direction in radians of the normal of one side of the polygon around each corner.
        least: Distance in metres that waypoints keep from all edges.
    """

    edges: Float[np.ndarray, "edge 2 2"]
    point: Float[np.ndarray, "corner 2"]
    keep: Float[np.ndarray, "corner"]
    angle: Float[np.ndarray, "corner"]
    least: float

    def free(self, start: Float[np.ndarray, "line 2"], end: Float[np.ndarray, "line 2"]) -> Bool[np.ndarray, "line"]:
        """Return whether the agent can go straight from one point to another.

        An end of the line inside the clearance of a corner is permitted, but then the rest of the line must not come
        nearer to this corner.
        """
        free = np.empty(len(start), bool)
        _fill_free(start, end, self.point, self.keep - _TOLERANCE, self.edges, free)
        return free

    @functools.cached_property
    def nodes(self) -> Float[np.ndarray, "node 2"]:
        """The vertices of the polygons around corners that the agent can reach."""
        angle = self.angle[:, None] + (np.arange(SIDES) + 0.5) * (2 * np.pi / SIDES)
        out = np.stack([np.cos(angle), np.sin(angle)], axis=2) * (self.keep / np.cos(np.pi / SIDES))[:, None, None]
        point = (self.point[:, None] + out).reshape(-1, 2)
        distance = norm(nearest_on(self.edges, point) - point[:, None]).min(axis=1)
        return point[distance >= self.least - _TOLERANCE]

    @functools.cached_property
    def lines(self) -> Int[np.ndarray, "line 2"]:
        """The pairs of nodes between which the agent can go straight."""
        between = np.stack(np.triu_indices(len(self.nodes), 1), axis=1)
        return between[self.free(self.nodes[between[:, 0]], self.nodes[between[:, 1]])]


@functools.lru_cache(maxsize=32)
def _roadmap(obstacles: bytes, shape: tuple[int, ...], radius: float) -> _Roadmap:
    """Return the roadmap of an agent; cached, because most layouts have the same obstacles in all cases.

    Args:
        obstacles: The bytes of polygons in metres, in double precision.
        shape: Their shape, `[polygon, corner, 2]`.
        radius: The agent's, in metres.
    """
    polygon = np.ndarray(shape, np.float64, obstacles)
    edges = edges_of(polygon)
    points = np.unique(edges.reshape(-1, 2), axis=0)
    most = 2 * (radius + CLEARANCE)
    nearest = nearest_on(edges, points)
    offset = nearest - points[:, None]
    distance = norm(offset)
    corner, edge = np.nonzero((distance > _TOLERANCE) & (distance < most))
    between = (points[corner] + nearest[corner, edge]) / 2
    # The space between two edges of one polygon may be its inside.
    inside = norm(nearest_on(edges, between) - between[:, None]).min(axis=1, initial=np.inf) < _TOLERANCE
    for solid in solids(polygon):
        inside |= shapely.contains_xy(solid, between)
    distance[corner[inside], edge[inside]] = np.inf
    distance[distance <= _TOLERANCE] = np.inf
    # The narrowest gap beside each corner, and its direction.
    narrowest = distance.argmin(axis=1) if len(edges) else np.zeros(0, np.int64)
    rows = np.arange(len(points))
    gap = distance[rows, narrowest]
    x, y = offset[rows, narrowest].T
    keep = np.clip(np.minimum(gap, most) / 2, radius + LEAST_CLEARANCE, radius + CLEARANCE)
    return _Roadmap(edges, points, keep, np.where(gap < most, np.arctan2(y, x), 0.0), radius + LEAST_CLEARANCE)


def _go_around(start: Agents, goal: Agents, roadmap: _Roadmap) -> list[Float[np.ndarray, "waypoint 2"] | None]:
    """Return the waypoints of agents of one size that cannot go straight, None for an agent without a path."""
    node = roadmap.nodes
    n, agents = len(node), len(start)
    point = np.concatenate([node, start, goal])
    starts, goals = n + np.arange(agents), n + agents + np.arange(agents)
    ends = np.stack(np.meshgrid(np.arange(n), np.r_[starts, goals]), axis=2).reshape(-1, 2)
    ends = ends[roadmap.free(point[ends[:, 0]], point[ends[:, 1]])]
    lines = np.concatenate([roadmap.lines, ends])
    # Lines lead from nodes to goals and from starts to nodes, so that no path leads over another agent's start or goal.
    lines = np.concatenate([lines[~np.isin(lines[:, 1], starts)], lines[~np.isin(lines[:, 1], goals), ::-1]])
    length = norm(point[lines[:, 1]] - point[lines[:, 0]])
    graph = coo_array((length, tuple(lines.T)), shape=(len(point), len(point))).tocsr()
    _, before = dijkstra(graph, indices=starts, return_predecessors=True)
    return [_trace_back(point, before[agent], n + agent, n + agents + agent) for agent in range(agents)]


def _trace_back(
    point: Points, before: Int[np.ndarray, "point"], start: int, goal: int
) -> Float[np.ndarray, "waypoint 2"] | None:
    """Return the points between a start and a goal, in order, traced back from the goal; None if it was not reached."""
    waypoints = []
    at = before[goal]
    while at != start:
        if at < 0:
            return None
        waypoints.append(point[at])
        at = before[at]
    return np.array(waypoints[::-1]).reshape(-1, 2)


@no_type_check
@njit(error_model="numpy")
def _fill_free(start, end, corner, keep, edges, free):
    """Fill `free` as defined by `_Roadmap.free`; `keep` contains the distance to keep from each corner in metres."""
    for line in range(len(start)):
        ax, ay = start[line]
        x, y = end[line, 0] - ax, end[line, 1] - ay
        length = x * x + y * y
        free[line] = True
        for k in range(len(corner)):
            px, py = corner[k, 0] - ax, corner[k, 1] - ay
            share = min(max((px * x + py * y) / length, 0.0), 1.0) if length > 0.0 else 0.0
            to_start, to_end = px * px + py * py, (px - x) ** 2 + (py - y) ** 2
            nearest = (px - share * x) ** 2 + (py - share * y) ** 2
            # The ends of the line may be inside the clearance.
            if nearest < min(keep[k] * keep[k], to_start - _TOLERANCE, to_end - _TOLERANCE):
                free[line] = False
                break
        for k in range(len(edges)):
            if not free[line]:
                break
            px, py = edges[k, 0, 0] - ax, edges[k, 0, 1] - ay
            qx, qy = edges[k, 1, 0] - ax, edges[k, 1, 1] - ay
            ex, ey = qx - px, qy - py
            parted = (x * py - y * px) * (x * qy - y * qx) < 0.0
            if parted and (px * ey - py * ex) * ((px - x) * ey - (py - y) * ex) < 0.0:
                free[line] = False
