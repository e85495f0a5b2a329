"""The agents that a layout has placed so far, and room for the next one; polygons as arrays."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

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

ATTEMPTS = 10
"""How often all pedestrians are placed anew where the layout is full: those before the last one may stand so that
nobody else finds room, in a layout that has room for all."""

_FEW = 16
"""With fewer points it takes no longer to look at all than into cells."""

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


class Points:
    """The starts of agents, or their goals, kept in cells, so that looking around one takes no longer among many.

    Args:
        radius: Radii in metres of all agents.
    """

    def __init__(self, radius: Sequence[float]) -> None:
        self.radius = radius
        self.all: list[Point] = []
        # Two points that are too close to each other are in the same cell or in two that touch, whatever is rounded.
        self._side = 1.001 * (2 * max(radius) + CLEARANCE)
        self._cells: dict[tuple[int, int], list[int]] = {}
        self._in_cells = 0

    def __len__(self) -> int:
        return len(self.all)

    def append(self, point: Point) -> None:
        """Add the point of the next agent, in metres."""
        self.all.append(point)

    def pop(self) -> None:
        """Take the last point away."""
        point = self.all.pop()
        if self._in_cells > len(self.all):
            self._in_cells -= 1
            self._cells[self._cell(*point)].pop()

    def is_clear(self, x: float, y: float, radius: float) -> bool:
        """Whether a disc of this radius, in metres, keeps `CLEARANCE` from the disc around each of the points."""
        own = radius + CLEARANCE
        for i in range(len(self.all)) if len(self.all) < _FEW else self._around(x, y):
            px, py = self.all[i]
            if math.hypot(x - px, y - py) < own + self.radius[i]:
                return False
        return True

    def _around(self, x: float, y: float) -> Iterator[int]:
        """Which points are in the cell of a position in metres, and in those that touch it."""
        for i in range(self._in_cells, len(self.all)):
            self._cells.setdefault(self._cell(*self.all[i]), []).append(i)
        self._in_cells = len(self.all)
        column, row = self._cell(x, y)
        for near in itertools.product((column - 1, column, column + 1), (row - 1, row, row + 1)):
            yield from self._cells.get(near, ())

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        return math.floor(x / self._side), math.floor(y / self._side)


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
        self.start, self.goal = Points(self.radius), Points(self.radius)

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
        before, everybody = len(self.start), len(self.radius)
        for _ in range(ATTEMPTS):
            while len(self.start) < everybody and place_next():
                pass
            if len(self.start) == everybody:
                return Placement(start=np.array(self.start.all), goal=np.array(self.goal.all), obstacles=self.obstacles)
            missed = len(self.start)
            while len(self.start) > before:
                self.start.pop()
                self.goal.pop()
        raise InputError(no_room(missed, everybody, area, key))

    def _drawn(self, rng: np.random.Generator, area: Area, others: Points) -> Point | None:
        own = self.radius[len(self.start)]
        for _ in range(TRIES):
            x, y = rng.uniform(*area).tolist()
            if others.is_clear(x, y, own) and not self._is_walled(x, y, own + WALL_CLEARANCE):
                return x, y
        return None

    def _is_walled(self, x: float, y: float, distance: float) -> bool:
        """Whether a position is nearer to an obstacle than a distance, all in metres."""
        return self.walls is not None and bool(self.walls.dwithin(shapely.Point(x, y), distance))

    def start_is_clear(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all starts."""
        return self.start.is_clear(x, y, self.radius[len(self.start)])

    def start_is_clear_of_goals(self, x: float, y: float) -> bool:
        """Whether a position in metres is far enough from all goals."""
        return self.goal.is_clear(x, y, self.radius[len(self.start)])

    goal_is_clear = start_is_clear_of_goals


def no_room(agent: int, agents: int, area: str, key: str) -> str:
    """What is said where a pedestrian finds no room.

    Args:
        agent: Which one, in the last attempt.
        agents: How many agents there are.
        area: Where they are placed.
        key: The key of the scenario that would make more room.
    """
    return (
        f"pedestrian {agent} of {agents - 1} finds no room on {area}, in {ATTEMPTS} attempts of {TRIES} draws: lower "
        f"pedestrians.number or raise {key}"
    )


def _shape(polygon: Float[np.ndarray, "corner 2"]) -> shapely.Geometry:
    corners = polygon[np.isfinite(polygon[:, 0])]
    return shapely.LineString(corners) if len(corners) == 2 else shapely.Polygon(corners)
