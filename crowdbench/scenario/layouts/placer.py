"""Placement of the agents of a layout, one after the other, at positions with enough room."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import shapely
from jaxtyping import Bool, Float
from numpy.random import Generator

from crowdbench.core.geometry import norm, pad_points
from crowdbench.scenario.placement import PerAgent, Placement
from crowdbench.sim.obstacles import touches_in_step
from crowdbench.utils.errors import InputError

CLEARANCE = 0.2
"""Smallest distance in metres between the rims of two agents at the start."""

WALL_CLEARANCE = 0.5
"""Smallest distance in metres between a rim and a wall at starts and goals. Nearer to a wall, the social force of the
wall keeps pedestrians away from their goals."""

MAX_DRAWS = 10_000
"""Number of draws for one pedestrian after which the layout counts as full."""

ALONE, TOGETHER = 20, 998
"""The first `ALONE` draws are checked one by one. If none of them is clear, the rest of `MAX_DRAWS` are checked in ten
batches of `TOGETHER`, which is faster if hardly any draw is clear."""

ATTEMPTS = 10
"""Number of attempts to place all pedestrians: in a layout with room for all, the first ones may block the
room for the others."""

Point = tuple[float, float]
"""A point in metres."""

Area = tuple[Point, Point]
"""A rectangle: its smallest and its largest coordinates in metres."""

Areas = tuple[Area, Area]
"""The area of the start of an agent, and the area of its goal."""


class Points:
    """Starts or goals of agents. Each is stored in the nine cells around it, so that one cell contains all near points.

    Args:
        radius: Radii in metres of all agents.
    """

    def __init__(self, radius: Sequence[float]) -> None:
        self.radius = radius
        self.all: list[Point] = []
        # Two points that are too close to each other are in the same cell or in neighbouring cells, despite rounding.
        self._side = 1.001 * (2 * max(radius) + CLEARANCE)
        self._cells: defaultdict[tuple[int, int], list[int]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self.all)

    def append(self, point: Point) -> None:
        """Add the point of the next agent, in metres."""
        for cell in self._cells_around(*point):
            self._cells[cell].append(len(self.all))
        self.all.append(point)

    def pop(self) -> None:
        """Remove the last point."""
        for cell in self._cells_around(*self.all.pop()):
            self._cells[cell].pop()

    def is_clear(self, x: float, y: float) -> bool:
        """Return whether the next agent, at a point in metres, keeps `CLEARANCE` from the disc around each of the
        points."""
        reach = self.radius[len(self.all)] + CLEARANCE
        for i in self._cells.get(self._cell(x, y), ()):
            px, py = self.all[i]
            if math.hypot(x - px, y - py) < reach + self.radius[i]:
                return False
        return True

    def may_be_clear(self, points: Float[np.ndarray, "point 2"]) -> Bool[np.ndarray, "point"]:
        """Return the points that may be clear: all that `is_clear` accepts, and possibly some that are 1e-9 m too
        near."""
        if not self.all:
            return np.ones(len(points), bool)
        least = np.array(self.radius[: len(self.all)]) + self.radius[len(self.all)] + CLEARANCE - 1e-9
        return np.asarray((norm(points[:, None] - np.array(self.all)) >= least).all(axis=1))

    def _cells_around(self, x: float, y: float) -> Iterator[tuple[int, int]]:
        column, row = self._cell(x, y)
        return itertools.product((column - 1, column, column + 1), (row - 1, row, row + 1))

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        return math.floor(x / self._side), math.floor(y / self._side)


class Placer:
    """Placement of agents, with checks whether a position is clear for the next one.

    Args:
        radius: Radii in metres of all agents, the vehicle first.
        obstacles: The corners of the obstacles in metres: walls with two corners, solid polygons with more.
    """

    def __init__(self, radius: PerAgent, obstacles: Sequence[Sequence[Point]] = ()) -> None:
        self.radius: list[float] = radius.tolist()
        self.obstacles = pad_points(obstacles) if obstacles else None
        shapes = [shapely.LineString(each) if len(each) == 2 else shapely.Polygon(each) for each in obstacles]
        self.walls = shapely.GeometryCollection(shapes) if shapes else None
        shapely.prepare(self.walls)
        self.start, self.goal = Points(self.radius), Points(self.radius)

    def add(self, start: Point, goal: Point) -> None:
        """Place the next agent with a start and a goal in metres."""
        self.start.append(start)
        self.goal.append(goal)

    def pop(self) -> None:
        """Remove the last agent."""
        self.start.pop()
        self.goal.pop()

    def draw(self, rng: Generator, start: Area, goal: Area) -> bool:
        """Draw the start of the next agent in an area and its goal in another one, clear of walls, starts and goals.

        Args:
            rng: The random stream of the case.
            start: Area of the start.
            goal: Area of the goal.

        Returns:
            True if there was room.
        """
        start_point = self._draw_point(rng, start, self.start)
        goal_point = self._draw_point(rng, goal, self.goal)
        if start_point is None or goal_point is None:
            return False
        self.add(start_point, goal_point)
        return True

    def fill_two_ways(self, rng: Generator, first: Areas, second: Areas, area: str, share: float = 0.5) -> Placement:
        """Place the remaining agents, with probability `share` in the areas `first`, else in `second`. See `fill`."""
        return self.fill(lambda: self.draw(rng, *(first if rng.random() < share else second)), area, "layout.width")

    def fill(self, place_next: Callable[[], bool], area: str, key: str) -> Placement:
        """Place all remaining agents.

        Args:
            place_next: Places the next agent, and returns True if there was room.
            area: Description of the area in the error message.
            key: The key of the scenario to raise for more room.

        Returns:
            The placement of all agents.

        Raises:
            InputError: There is no room for an agent.
        """
        before, agents = len(self.start), len(self.radius)
        for _ in range(ATTEMPTS):
            while len(self.start) < agents and place_next():
                pass
            if len(self.start) == agents:
                return Placement(start=np.array(self.start.all), goal=np.array(self.goal.all), obstacles=self.obstacles)
            unplaced = len(self.start)
            while len(self.start) > before:
                self.pop()
        raise InputError(no_room(unplaced, agents, area, key))

    def _draw_point(self, rng: Generator, area: Area, others: Points) -> Point | None:
        distance, ((left, low), (right, high)) = self.radius[len(self.start)] + WALL_CLEARANCE, area
        for _ in range(ALONE):  # equals `rng.uniform(*area)`, which takes ten times as long
            x, y = left + (right - left) * rng.random(), low + (high - low) * rng.random()
            if others.is_clear(x, y) and not self._is_near_wall(x, y, distance):
                return x, y
        for _ in range((MAX_DRAWS - ALONE) // TOGETHER):
            before = rng.bit_generator.state
            points = rng.uniform(*area, (TOGETHER, 2))
            rows = np.flatnonzero(others.may_be_clear(points))
            for row in rows[~self._are_near_wall(points[rows], distance)].tolist():
                x, y = points[row].tolist()
                if others.is_clear(x, y):
                    rng.bit_generator.state = before
                    rng.uniform(size=(row + 1, 2))  # the stream continues after the accepted point
                    return x, y
        return None

    def _is_near_wall(self, x: float, y: float, distance: float) -> bool:
        return self.obstacles is not None and bool(touches_in_step(x, y, 0.0, 0.0, distance, self.obstacles))

    def _are_near_wall(self, points: Float[np.ndarray, "point 2"], distance: float) -> Bool[np.ndarray, "point"]:
        if self.walls is None:
            return np.zeros(len(points), bool)
        return np.asarray(shapely.dwithin(self.walls, shapely.points(points), distance))


def no_room(agent: int, agents: int, area: str, key: str) -> str:
    """Return the message for a pedestrian without room.

    Args:
        agent: Index of the pedestrian in the last attempt.
        agents: Number of agents.
        area: Description of the area.
        key: The key of the scenario to raise for more room.
    """
    return (
        f"pedestrian {agent} of {agents - 1} finds no room on {area}, in {ATTEMPTS} attempts of {MAX_DRAWS} draws: "
        f"lower pedestrians.number or raise {key}"
    )
