"""Layouts, the placement of the agents of one case, its checks, and the routes around its obstacles."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.core.arrays import Agents, Polygons, WayPoints
from crowdbench.core.arrays import PerAgent as PerAgent
from crowdbench.sim.visibility_graph import edges_of, find_routes, who
from crowdbench.utils.errors import InputError

EXTENT = 1e6
"""Largest absolute value of a coordinate in metres."""

_TOLERANCE = 1e-9

Position = Float[np.ndarray, "2"]
"""A point in metres."""

Trip = tuple[Position, Position]
"""The start and the goal of an agent."""


@dataclass(frozen=True)
class Placement:
    """Starts, goals, routes and obstacles that a layout returns for one case.

    Attributes:
        start: Start position of each agent in metres.
        goal: Goal position of each agent in metres.
        route: Waypoints of each agent on the way to its goal, in metres, NaN beyond its last one. By default the
            shortest paths around the obstacles.
        obstacles: Polygons in metres, NaN beyond the last corner of each. Two corners are a wall without thickness;
            three or more, in either order, are solid. None without obstacles.
    """

    start: Agents
    goal: Agents
    route: WayPoints | None = None
    obstacles: Polygons | None = None

    def as_seen_by(self, vehicle: int) -> Placement:
        """Return the placement with one of several vehicles as the first agent."""
        order = np.append(vehicle, np.delete(np.arange(len(self.start)), vehicle))
        route = None if self.route is None else self.route[order]
        return dataclasses.replace(self, start=self.start[order], goal=self.goal[order], route=route)


Layout = Callable[..., Placement]
"""A function `(rng, radius, preferred_speed, **options) -> Placement`.

- `rng` is the random stream of the case, the only source of random numbers.
- `radius` and `preferred_speed` are `[agent]`, in metres and in m/s, the vehicle first.
- The options are keyword-only parameters with defaults.

It raises InputError if there is no room for an agent."""


LayoutCall = functools.partial[Any]
"""A layout with its options: a function `(rng, radius, preferred_speed) -> Placement`."""


def complete_placement(placement: Placement, radius: PerAgent) -> Placement:
    """Complete the placement of a layout: with routes if there are obstacles, and solid polygons counter-clockwise.

    Args:
        placement: Return value of the layout, with arrays of the right shapes.
        radius: Radii in metres.

    Raises:
        InputError: It is not a valid placement of these agents.
    """
    return add_routes(check_obstacles(check_finite(placement), radius), radius)


def check_shape(answer: object, agents: int) -> Placement:
    """Return the placement of a layout. Raises InputError if it is not a placement of `agents` agents."""
    if not isinstance(answer, Placement):
        raise InputError(f"the layout returned a {type(answer).__name__} instead of a Placement")
    shapes = {"start": (agents, 2), "goal": (agents, 2), "route": (agents, None, 2), "obstacles": (None, None, 2)}
    for part, shape in shapes.items():
        array = getattr(answer, part)
        if array is None and part in ("route", "obstacles"):
            continue
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            raise InputError(f"the layout returned a Placement with {part} that is not an array of floats")
        fits = [right in (None, length) for right, length in zip(shape, array.shape, strict=False)]
        if array.ndim != len(shape) or not all(fits):
            words = ", ".join("any number" if right is None else str(right) for right in shape)
            raise InputError(f"the layout returned {part} of shape {list(array.shape)} instead of [{words}]")
    return answer


def check_finite(placement: Placement) -> Placement:
    """Return the placement. Raises InputError if a number outside the padding is not finite or too large."""
    right = f"whose coordinates must be numbers from {-EXTENT:g} to {EXTENT:g}"
    for part, points in (("start", placement.start), ("goal", placement.goal)):
        for agent in _find_wrong(points):
            raise InputError(f"the layout gives {who(agent)} the {part} {points[agent].tolist()}, {right}")
    for part, rows in (("route", placement.route), ("obstacles", placement.obstacles)):
        for row, points in enumerate(() if rows is None else rows):
            padding = int(np.isnan(points).all(axis=1)[::-1].cumprod().sum())
            for point in _find_wrong(points[: len(points) - padding]):
                raise InputError(f"the layout returned {part}[{row}] with the point {points[point].tolist()}, {right}")
    return placement


def _find_wrong(points: Float[np.ndarray, "point 2"]) -> list[int]:
    """Return the indices of points with a coordinate that is not finite or too large."""
    return np.flatnonzero(~(np.abs(points) <= EXTENT).all(axis=1)).tolist()


def check_obstacles(placement: Placement, radius: PerAgent) -> Placement:
    """Check the obstacles of a placement, and return it with solid polygons counter-clockwise.

    Args:
        placement: The placement.
        radius: Radii in metres.

    Raises:
        InputError: An obstacle is a single point, has no length or no area, or crosses itself or another one, or a
            start or a goal is in a wall.
    """
    if placement.obstacles is None:
        return placement
    corners = {i: points for i, points in enumerate(map(_points, placement.obstacles)) if len(points)}
    shapes = {i: _shape(i, points) for i, points in corners.items()}
    _check_apart(shapes)
    _check_outside(placement, radius, shapes)
    obstacles = placement.obstacles.copy()
    for i, points in corners.items():
        if len(points) > 2 and not shapely.is_ccw(shapely.LinearRing(points)):
            obstacles[i, : len(points)] = points[::-1]
    return dataclasses.replace(placement, obstacles=obstacles)


def add_routes(placement: Placement, radius: PerAgent) -> Placement:
    """Return a placement with routes if there are obstacles and the layout gives no routes.

    Args:
        placement: The placement.
        radius: Radii in metres.

    Raises:
        InputError: There is no path from the start of an agent to its goal.
    """
    if placement.route is not None or placement.obstacles is None:
        return placement
    route = find_routes(placement.start, placement.goal, radius, placement.obstacles)
    return dataclasses.replace(placement, route=route)


def _points(row: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point_there 2"]:
    """Return the points of a row, without the padding."""
    return row[np.isfinite(row[:, 0])]


def check_routes(placement: Placement, radius: PerAgent) -> Placement:
    """Return the placement. Raises InputError if a route comes nearer to an obstacle than the agent's radius in
    metres."""
    if placement.route is None or placement.obstacles is None:
        return placement
    edges = shapely.MultiLineString(list(edges_of(placement.obstacles)))
    for agent, points in enumerate(placement.route):
        path = shapely.LineString([placement.start[agent], *_points(points), placement.goal[agent]])
        if path.distance(edges) < radius[agent] - _TOLERANCE:
            raise InputError(
                f"the route of {who(agent)} leads {path.distance(edges):.3g} m past an obstacle, but its radius is "
                f"{radius[agent]:.3g} m"
            )
    return placement


def _shape(i: int, corners: Float[np.ndarray, "corner 2"]) -> shapely.Geometry:
    """Return an obstacle as a shape of shapely. Raises InputError if the shape is not valid."""
    name = f"obstacles[{i}]"
    if len(corners) == 1:
        raise InputError(f"{name} has one corner, but a wall has two and a solid polygon three or more")
    after = np.roll(corners, -1, axis=0)
    same = (corners == after).all(axis=1)
    if same.any():
        point = corners[int(same.argmax())].tolist()
        what = "has no length: both its corners are" if len(corners) == 2 else "has twice in a row the corner"
        raise InputError(f"{name} {what} {point}")
    if len(corners) == 2:
        return shapely.LineString(corners)
    shape = shapely.Polygon(corners)
    if not shape.is_valid:
        if shape.convex_hull.area < _TOLERANCE:
            raise InputError(f"{name} has no area: its corners are on a line")
        raise InputError(f"{name} crosses or touches itself: {shapely.is_valid_reason(shape)}")
    return shape


def _check_apart(shapes: Mapping[int, shapely.Geometry]) -> None:
    """Raise InputError if two obstacles cross or overlap. They may touch."""
    number, geometries = list(shapes), list(shapes.values())
    pairs = shapely.STRtree(geometries).query(np.array(geometries, object), predicate="intersects")
    for first, second in pairs.T.tolist():
        if first < second and shapely.relate_pattern(geometries[first], geometries[second], "T********"):
            raise InputError(f"obstacles[{number[first]}] and obstacles[{number[second]}] cross or overlap")


def _check_outside(placement: Placement, radius: PerAgent, shapes: Mapping[int, shapely.Geometry]) -> None:
    """Raise InputError if a start or a goal is in a wall, or nearer to it than the agent's radius."""
    for part, points in (("start", placement.start), ("goal", placement.goal)):
        for i, shape in shapes.items():
            distance = shapely.distance(shapely.points(points), shape)
            wrong = distance < radius - _TOLERANCE
            if wrong.any():
                agent = int(wrong.argmax())
                raise InputError(
                    f"the {part} of {who(agent)}, {points[agent].tolist()}, is {distance[agent]:.3g} m from "
                    f"obstacles[{i}], but must be {radius[agent]:.3g} m away, the radius of the disc around it"
                )
