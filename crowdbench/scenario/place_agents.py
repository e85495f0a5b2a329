"""Has a layout place the agents of a case, examines what it returns, and finds the ways around obstacles."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.scenario.placement import Placement, pad_points, split_corners
from crowdbench.scenario.visibility_graph import edges_of, find_routes
from crowdbench.utils.errors import InputError

EXTENT = 1e6
"""Coordinates are at most so many metres from zero."""

SPACING = 1.0
"""Waypoints of a shortest way are at most this far apart, in metres."""

_TOLERANCE = 1e-9


def complete_placement(answer: object, radius: Float[np.ndarray, "agent"]) -> Placement:
    """What a layout returned: with routes if there are obstacles, and solid polygons counter-clockwise.

    Args:
        answer: Whatever that is.
        radius: Radii in metres.

    Raises:
        InputError: It is no placement of these agents, or cannot be.
    """
    return add_routes(check_obstacles(check_finite(check_shape(answer, len(radius))), radius), radius)


def check_shape(answer: object, agents: int) -> Placement:
    """What a layout returned.

    Args:
        answer: Whatever that is.
        agents: The number of agents.

    Returns:
        The placement.

    Raises:
        InputError: It is no placement of so many agents.
    """
    if not isinstance(answer, Placement):
        raise InputError(f"the layout returned a {type(answer).__name__} instead of a Placement")
    wanted = {"start": (agents, 2), "goal": (agents, 2), "route": (agents, None, 2), "obstacles": (None, None, 2)}
    for part, shape in wanted.items():
        array = getattr(answer, part)
        if array is None and part in ("route", "obstacles"):
            continue
        if not isinstance(array, np.ndarray) or array.dtype.kind != "f":
            raise InputError(f"the layout returned a Placement with {part} that is not an array of floats")
        wishes = zip(shape, array.shape, strict=False)
        if array.ndim != len(shape) or not all(wish in (None, length) for wish, length in wishes):
            words = ", ".join("any number" if wish is None else str(wish) for wish in shape)
            raise InputError(
                f"the layout returned a Placement with {part} of shape {list(array.shape)} instead of [{words}]"
            )
    return answer


def check_finite(placement: Placement) -> Placement:
    """A placement. Raises InputError where a number in it is not finite, beyond the padding, or is too large."""
    for part, points in (("start", placement.start), ("goal", placement.goal)):
        wrong = ~(np.abs(points) <= EXTENT).all(axis=1)
        if wrong.any():
            agent = int(wrong.argmax())
            raise InputError(f"the layout gives {who(agent)} the {part} {points[agent].tolist()}, {_NUMBERS}")
    for part, rows in (("route", placement.route), ("obstacles", placement.obstacles)):
        for row, points in enumerate(() if rows is None else rows):
            used = len(points) - int(np.isnan(points).all(axis=1)[::-1].cumprod().sum())
            wrong = ~(np.abs(points[:used]) <= EXTENT).all(axis=1)
            if wrong.any():
                point = points[int(wrong.argmax())].tolist()
                raise InputError(f"the layout returned {part}[{row}] with the point {point}, {_NUMBERS}")
    return placement


_NUMBERS = f"whose coordinates must be numbers from {-EXTENT:g} to {EXTENT:g}"


def check_obstacles(placement: Placement, radius: Float[np.ndarray, "agent"]) -> Placement:
    """A placement among obstacles, solid polygons counter-clockwise.

    Args:
        placement: The placement.
        radius: Radii in metres.

    Raises:
        InputError: An obstacle is a single point, has no length or no area, or crosses itself or another one, or a
            start or a goal is in a wall.
    """
    if placement.obstacles is None:
        return placement
    corners = split_corners(placement.obstacles)
    shapes = {i: _shape(i, each) for i, each in enumerate(corners) if len(each)}
    _apart(shapes)
    _outside(placement, radius, shapes)
    turned = placement.obstacles.copy()
    for i, each in enumerate(corners):
        if len(each) > 2 and not shapely.is_ccw(shapely.LinearRing(each)):
            turned[i, : len(each)] = each[::-1]
    return dataclasses.replace(placement, obstacles=turned)


def add_routes(placement: Placement, radius: Float[np.ndarray, "agent"]) -> Placement:
    """A placement with routes if there are obstacles, without waypoints at the end that are the goal.

    Args:
        placement: The placement.
        radius: Radii in metres.

    Raises:
        InputError: No way leads an agent to its goal.
    """
    route = placement.route
    if route is None:
        if placement.obstacles is None:
            return placement
        route = find_routes(placement.start, placement.goal, radius, placement.obstacles)
        return dataclasses.replace(placement, route=_add_marks(placement.start, placement.goal, route))
    route = route.copy()
    for agent, points in enumerate(route):
        last = int(np.isfinite(points[:, 0]).sum()) - 1
        while last >= 0 and np.array_equal(points[last], placement.goal[agent]):
            points[last] = np.nan
            last -= 1
    return dataclasses.replace(placement, route=route)


def _add_marks(
    start: Float[np.ndarray, "agent 2"], goal: Float[np.ndarray, "agent 2"], route: Float[np.ndarray, "agent corner 2"]
) -> Float[np.ndarray, "agent waypoint 2"]:
    """Routes with waypoints at most `SPACING` apart, so that whoever has been pushed off its way sees one of them."""
    ways = []
    for agent, corners in enumerate(route):
        points = np.concatenate([start[agent, None], corners[np.isfinite(corners[:, 0])], goal[agent, None]])
        legs = np.ceil(np.hypot(*np.diff(points, axis=0).T) / SPACING).astype(int)
        parts = [
            first + np.arange(1, n + 1)[:, None] / n * (last - first)
            for first, last, n in zip(points[:-1], points[1:], legs, strict=True)
        ]
        ways.append(np.concatenate([np.empty((0, 2)), *parts])[:-1])
    return pad_points(ways)


def check_routes(placement: Placement, radius: Float[np.ndarray, "agent"]) -> Placement:
    """A placement whose routes lead clear of walls.

    Args:
        placement: The placement.
        radius: Radii in metres.

    Returns:
        The same placement.

    Raises:
        InputError: The route of an agent leads into a wall.
    """
    if placement.route is None or placement.obstacles is None:
        return placement
    edges = shapely.MultiLineString(list(edges_of(placement.obstacles)))
    for agent, points in enumerate(placement.route):
        waypoints = points[np.isfinite(points[:, 0])]
        way = shapely.LineString([placement.start[agent], *waypoints, placement.goal[agent]])
        if way.distance(edges) < radius[agent] - _TOLERANCE:
            raise InputError(
                f"the route of {who(agent)} leads {way.distance(edges):.3g} m past an obstacle, but its radius is "
                f"{radius[agent]:.3g} m"
            )
    return placement


def who(agent: int) -> str:
    """What an agent is called in errors."""
    return "the vehicle" if agent == 0 else f"pedestrian {agent}"


def _shape(i: int, corners: Float[np.ndarray, "corner 2"]) -> shapely.Geometry:
    """An obstacle as a shape. Raises InputError where it is none."""
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


def _apart(shapes: Mapping[int, shapely.Geometry]) -> None:
    """Raises InputError where two obstacles cross or overlap. They may touch."""
    number, each = list(shapes), list(shapes.values())
    for one, other in shapely.STRtree(each).query(each, predicate="intersects").T.tolist():
        if one < other and shapely.relate_pattern(each[one], each[other], "T********"):
            raise InputError(f"obstacles[{number[one]}] and obstacles[{number[other]}] cross or overlap")


def _outside(placement: Placement, radius: Float[np.ndarray, "agent"], shapes: Mapping[int, shapely.Geometry]) -> None:
    """Raises InputError where a start or a goal is in a wall, or nearer to it than the agent's radius."""
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
