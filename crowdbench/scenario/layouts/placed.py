"""The agents that a layout has placed so far, and room for the next one; polygons as arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.errors import InputError
from crowdbench.scenario.placement import Placement

CLEARANCE = 0.2
"""Smallest distance in metres between the rims of two agents at the start."""

WALL_CLEARANCE = 0.5
"""Smallest distance in metres between a rim and a wall at starts and goals. Nearer to a wall, the border of a social
force keeps pedestrians away from their goals."""

BEYOND = 4.0
"""Distance in metres from the vehicle's start and goal to the ends of a corridor or of streets that cross."""

TRIES = 10_000
"""Number of draws for one pedestrian after which the layout counts as full."""

Point = tuple[float, float]
"""A point in metres."""

Area = tuple[Point, Point]
"""A rectangle: its smallest and its largest coordinates in metres."""


def polygons(*corners: Sequence[Point]) -> Float[np.ndarray, "polygon corner 2"]:
    """Polygons of different numbers of corners in one array, NaN beyond the last corner of each."""
    array = np.full((len(corners), max(map(len, corners), default=0), 2), np.nan)
    for i, polygon in enumerate(corners):
        array[i, : len(polygon)] = polygon
    return array


class Placed:
    """The agents placed so far, and whether a position is clear for the next one.

    Args:
        radius: Radii in metres of all agents, the vehicle first.
        obstacles: What stands around them, in metres; nothing if None.
    """

    def __init__(
        self, radius: Float[np.ndarray, "agent"], obstacles: Float[np.ndarray, "polygon corner 2"] | None = None
    ) -> None:
        self.radius: list[float] = radius.tolist()
        self.obstacles = obstacles
        self.walls = None if obstacles is None else shapely.GeometryCollection(list(map(_shape, obstacles)))
        self.start: list[Point] = []
        self.goal: list[Point] = []

    def add(self, start: Point, goal: Point) -> None:
        """Place the next agent.

        Args:
            start: Where it starts, in metres.
            goal: Where it goes, in metres.
        """
        self.start.append(start)
        self.goal.append(goal)

    def draw(self, rng: np.random.Generator, start: Area, goal: Area) -> bool:
        """Place the next agent somewhere in an area, its goal in another one, clear of walls, starts and goals.

        Args:
            rng: The random stream of the case.
            start: Where it starts.
            goal: Where it goes.

        Returns:
            Whether there was room.
        """
        own_start = self._drawn(rng, start, self.start)
        own_goal = self._drawn(rng, goal, self.goal)
        if own_start is None or own_goal is None:
            return False
        self.add(own_start, own_goal)
        return True

    def fill(self, place_next: Callable[[], bool], area: str, key: str) -> Placement:
        """Place all agents that are left.

        Args:
            place_next: Places the next agent, and says whether there was room.
            area: Where that is, for the error.
            key: The key of the scenario that would make more room.

        Returns:
            The placement of all agents.

        Raises:
            InputError: There is no room for an agent.
        """
        while len(self.start) < len(self.radius):
            if not place_next():
                raise InputError(
                    f"pedestrian {len(self.start)} of {len(self.radius) - 1} finds no room on {area} after {TRIES} "
                    f"draws: lower pedestrians.number or raise {key}"
                )
        return Placement(start=np.array(self.start), goal=np.array(self.goal), obstacles=self.obstacles)

    def _drawn(self, rng: np.random.Generator, area: Area, others: list[Point]) -> Point | None:
        reach = self.radius[len(self.start)] + WALL_CLEARANCE
        for _ in range(TRIES):
            x, y = rng.uniform(*area).tolist()
            is_walled = self.walls is not None and self.walls.dwithin(shapely.Point(x, y), reach)
            if self._clear(x, y, others) and not is_walled:
                return x, y
        return None

    def start_is_clear(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all starts."""
        return self._clear(x, y, self.start)

    def start_is_clear_of_goals(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all goals."""
        return self._clear(x, y, self.goal)

    goal_is_clear = start_is_clear_of_goals

    def _clear(self, x: float, y: float, points: list[Point]) -> bool:
        own = self.radius[len(self.start)] + CLEARANCE
        return all(
            math.hypot(x - px, y - py) >= own + other for (px, py), other in zip(points, self.radius, strict=False)
        )


def _shape(polygon: Float[np.ndarray, "corner 2"]) -> shapely.Geometry:
    corners = polygon[np.isfinite(polygon[:, 0])]
    return shapely.LineString(corners) if len(corners) == 2 else shapely.Polygon(corners)
