"""Placement of the agents of a layout, one after the other, at positions with enough room."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.random import Generator

from crowdbench.core.geometry import pad_points
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
        clearance: Smallest distance in metres between the discs around two points.
    """

    def __init__(self, radius: Sequence[float], clearance: float = CLEARANCE) -> None:
        self.radius, self.clearance = radius, clearance
        self.all: list[Point] = []
        # Two points that are too close to each other are in the same cell or in neighbouring cells, despite rounding.
        self._side = 1.001 * (2 * max(radius) + clearance)
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
        """Return whether the next agent, at a point in metres, keeps the clearance from the disc around each of the
        points."""
        reach = self.radius[len(self.all)] + self.clearance
        for i in self._cells.get(self._cell(x, y), ()):
            px, py = self.all[i]
            if math.hypot(x - px, y - py) < reach + self.radius[i]:
                return False
        return True

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
        clearance: Smallest distance in metres between the rims of two agents at starts, and at goals.
    """

    def __init__(
        self, radius: PerAgent, obstacles: Sequence[Sequence[Point]] = (), clearance: float = CLEARANCE
    ) -> None:
        self.radius: list[float] = radius.tolist()
        self.obstacles = pad_points(obstacles) if obstacles else None
        self.start, self.goal = Points(self.radius, clearance), Points(self.radius, clearance)

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
        raise InputError(
            f"pedestrian {unplaced} of {agents - 1} finds no room on {area}, in {ATTEMPTS} attempts of {MAX_DRAWS} "
            f"draws: lower pedestrians.number or raise {key}"
        )

    def _draw_point(self, rng: Generator, area: Area, others: Points) -> Point | None:
        distance, ((left, low), (right, high)) = self.radius[len(self.start)] + WALL_CLEARANCE, area
        for _ in range(MAX_DRAWS):  # equals `rng.uniform(*area)`, which takes ten times as long
            x, y = left + (right - left) * rng.random(), low + (high - low) * rng.random()
            if others.is_clear(x, y) and not self._is_near_wall(x, y, distance):
                return x, y
        return None

    def _is_near_wall(self, x: float, y: float, distance: float) -> bool:
        return self.obstacles is not None and bool(touches_in_step(x, y, 0.0, 0.0, distance, self.obstacles))
