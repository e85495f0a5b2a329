"""Respawn: a layout draws a new pedestrian or a new goal during an episode."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from crowdbench.core.dynamics import reach
from crowdbench.core.geometry import norm
from crowdbench.core.types import World
from crowdbench.scenario.layouts.placer import CLEARANCE, WALL_CLEARANCE
from crowdbench.scenario.placement import Layout, LayoutCall, Placement, Position, Trip, add_routes, check_shape
from crowdbench.sim.visibility_graph import edges_of, nearest_on, solids
from crowdbench.utils.errors import InputError
from crowdbench.utils.resources import plugin_in_time

TRIES = 20
"""Largest number of draws for one pedestrian per step. A draw among walls takes milliseconds."""

SHORTEST_TRIP = 1.0
"""Smallest distance in metres from a pedestrian to its new goal."""


@dataclass(frozen=True)
class Surroundings:
    """The surroundings of a pedestrian that is drawn again: the other agents, the vehicle first, and the obstacles.

    Attributes:
        position: Centres in metres.
        goal: In metres.
        radius: In metres; for the vehicle, of a disc around its whole body.
        preferred_speed: In m/s.
        obstacles: Polygons in metres, NaN beyond the last corner of each.
    """

    position: Float[np.ndarray, "other 2"]
    goal: Float[np.ndarray, "other 2"]
    radius: Float[np.ndarray, "other"]
    preferred_speed: Float[np.ndarray, "other"]
    obstacles: Float[np.ndarray, "polygon corner 2"]

    @classmethod
    def of(cls, world: World, row: int, without: Int[np.ndarray, "agent"]) -> Surroundings:
        """Return the surroundings in one world of a batch, without some of its agents."""
        others = world.present[row].copy()
        others[without] = False
        radius = world.radius[row].copy()
        radius[0] += reach(world.rules.body)
        others[0] = True
        position, goal, speed = (array[row, others] for array in (world.position, world.goal, world.preferred_speed))
        return cls(position, goal, radius[others], speed, world.obstacles[row])

    def is_clear(
        self, point: Position, radius: float, clearance: float = CLEARANCE, walls: float = WALL_CLEARANCE
    ) -> bool:
        """Return whether a disc at a point keeps its distance from all positions and goals, and from walls.

        Args:
            point: In metres.
            radius: Of the disc, in metres.
            clearance: Smallest distance in metres between rims.
            walls: Smallest distance in metres between the rim and a wall.
        """
        points, radii = self._discs
        if (norm(points - point) < radii + (radius + clearance)).any():
            return False
        edges, filled = _edges_and_solids(self.obstacles.tobytes(), self.obstacles.shape)
        if len(edges) and norm(nearest_on(edges, point[None])[0] - point).min() < radius + walls:
            return False
        return not shapely.contains_xy(filled, *point).any()

    @functools.cached_property
    def _discs(self) -> tuple[Float[np.ndarray, "disc 2"], Float[np.ndarray, "disc"]]:
        """The centres and radii in metres of the discs at all positions and goals."""
        return np.concatenate([self.position, self.goal]), np.tile(self.radius, 2)

    def find_route(self, start: Position, goal: Position, radius: float) -> np.ndarray | None:
        """Return the waypoints `[waypoint, 2]` in metres of a disc's shortest path; None if there is no path."""
        if not np.isfinite(self.obstacles).any():
            return np.empty((0, 2))
        placement = Placement(start[None], goal[None], obstacles=self.obstacles)
        try:
            route = add_routes(placement, np.array([radius])).route
        except InputError:
            return None
        assert route is not None  # there are obstacles
        return route[0]


@functools.lru_cache(maxsize=256)
def _edges_and_solids(obstacles: bytes, shape: tuple[int, ...]) -> tuple[Float[np.ndarray, "edge 2 2"], np.ndarray]:
    """Return the edges and the solid polygons of obstacles. A layout draws among the same walls many times."""
    polygons = np.frombuffer(obstacles).reshape(shape)
    filled = np.array(solids(polygons), object)
    shapely.prepare(filled)
    return edges_of(polygons), filled


Respawn = Callable[..., Trip | None]
"""A function `(rng, surroundings, radius, preferred_speed, position, **options) -> (start, goal)`.

It draws one pedestrian again, or its goal.

- `rng` is the random stream for this pedestrian and step, the only source of random numbers.
- `surroundings` is a `Surroundings`; start and goal must keep a distance from its agents.
- `radius` and `preferred_speed` are the pedestrian's, in metres and in m/s.
- `position` is the position in metres of a pedestrian that only gets another goal; None for a new pedestrian.
- The options are the options of the layout.

It returns None if there is no room. Then the pedestrian walks on, and is drawn again in the next step."""


class LayoutWithRespawn:
    """A layout with a function that draws pedestrians and goals again; other layouts place a crowd of one repeatedly.

    Args:
        layout: The layout, which places the agents at the start.
        again: The function that draws one pedestrian again.
    """

    def __init__(self, layout: Layout, again: Respawn) -> None:
        functools.update_wrapper(self, layout)  # copies the layout's signature and docstring
        self.layout, self.again = layout, again

    def __call__(self, *args: Any, **options: Any) -> Placement:
        """Return the placement by the layout."""
        return self.layout(*args, **options)


def _respawn_by_layout(
    layout: LayoutCall,
    rng: np.random.Generator,
    surroundings: Surroundings,
    radius: float,
    speed: float,
    position: Position | None,
) -> Trip | None:
    """Call a layout for the vehicle and one pedestrian until the pedestrian is clear of all agents; see `Respawn`."""
    both = np.array([surroundings.radius[0], radius]), np.array([surroundings.preferred_speed[0], speed])
    for _ in range(TRIES):
        placement = check_shape(layout(rng, *both), 2)
        start, goal = placement.start[1] if position is None else position, placement.goal[1]
        if position is None:
            start_is_valid = surroundings.is_clear(start, radius)
        else:
            start_is_valid = math.dist(start, goal) >= SHORTEST_TRIP
        if start_is_valid and surroundings.is_clear(goal, radius):
            return start, goal
    return None


def redraw(layout: LayoutCall, *arguments: Any) -> Trip | None:
    """Draw one pedestrian again by a layout, and check the result.

    Args:
        layout: The layout with its options.
        *arguments: Arguments of a `Respawn`.

    Raises:
        InputError: The layout raises, or returns neither None nor two points.
    """
    draw = layout.func.again if isinstance(layout.func, LayoutWithRespawn) else None
    with plugin_in_time("the layout raised"):
        answer = draw(*arguments, **layout.keywords) if draw else _respawn_by_layout(layout, *arguments)
    if answer is None:
        return None
    if not isinstance(answer, tuple) or len(answer) != 2 or not all(map(_is_point, answer)):
        raise InputError(f"the layout drew {answer!r} again, but must draw a start and a goal, two points in metres")
    start, goal = (np.asarray(point, np.float64) for point in answer)
    return start, goal


def _is_point(point: object) -> bool:
    array = np.asarray(point)
    return array.shape == (2,) and array.dtype.kind in "fi" and bool(np.isfinite(array).all())
