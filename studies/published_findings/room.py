"""The room of Stratton et al. (2024): pedestrians who pass the vehicle and pedestrians who cross its way."""

from __future__ import annotations

import numpy as np

from crowdbench import InputError
from crowdbench.scenario import LayoutWithRespawn, PerAgent, Placement, Position, Surroundings, Trip

WAY = 4.0
"""Distance in metres of the vehicle's start and goal from the middle."""

APART = 0.2
"""Smallest distance in metres between the rims of two agents at starts, and at goals."""

TO_WALLS = 0.005
"""Smallest distance in metres between a rim and a wall at starts and goals."""

TRIES = 1_000
"""Largest number of draws of a point."""


class Occupied:
    """Discs at starts, or at goals, that other points must not touch."""

    def __init__(self, points: Position, radii: PerAgent) -> None:
        self.points, self.radii = list(points), list(radii)

    def draw(self, rng: np.random.Generator, low: Position, high: Position, radius: float) -> Position | None:
        """Return a point of a rectangle that is apart from the discs, and occupy it; None without room."""
        for _ in range(TRIES):
            point = rng.uniform(low, high)
            if (np.linalg.norm(np.array(self.points) - point, axis=1) > np.array(self.radii) + radius + APART).all():
                self.points.append(point)
                self.radii.append(radius)
                return point
        return None


def place(
    rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent, *, width: float = 10.0, length: float = 10.0
) -> Placement:
    """Place the vehicle, which drives from bottom to top, and pedestrians: half pass it, half cross its way.

    Args:
        width: Width of the room [m].
        length: Length of the room [m].

    Returns:
        See `crowdbench.scenario.Placement`.

    Raises:
        InputError: There is no room for a pedestrian.
    """
    start, goal = np.array([[0.0, -WAY]]), np.array([[0.0, WAY]])
    starts, goals = Occupied(start, radius[:1]), Occupied(goal, radius[:1])
    for each in radius[1:]:
        if _draw_trip(rng, starts, goals, each, width, length) is None:
            raise InputError(f"a pedestrian finds no room in {width:g} x {length:g} m: lower pedestrians.number")
    x, y = width / 2.0, length / 2.0
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return Placement(start=np.array(starts.points), goal=np.array(goals.points), obstacles=walls)


def place_again(
    rng: np.random.Generator,
    surroundings: Surroundings,
    radius: float,
    preferred_speed: float,
    position: Position | None,
    *,
    width: float = 10.0,
    length: float = 10.0,
) -> Trip | None:
    """Return the start and the goal of a pedestrian that comes in for one that has arrived."""
    starts, goals = (Occupied(each, surroundings.radius) for each in (surroundings.position, surroundings.goal))
    return _draw_trip(rng, starts, goals, radius, width, length)


def _draw_trip(
    rng: np.random.Generator, starts: Occupied, goals: Occupied, radius: float, width: float, length: float
) -> Trip | None:
    """Return a start and a goal in the other half of the room; None without room.

    The goal of a pedestrian who crosses has the other sign of x. That of a pedestrian who passes has the other sign of
    y and the same sign of x.
    """
    most = np.array([width, length]) / 2.0 - radius - TO_WALLS
    start = starts.draw(rng, -most, most, radius)
    if start is None:
        return None
    crosses = rng.random() < 0.5
    x, y = np.where(start > 0.0, most, -most)
    corner, middle = (
        (np.array([-x, -most[1]]), np.array([0.0, most[1]])) if crosses else (np.array([x, -y]), np.zeros(2))
    )
    goal = goals.draw(rng, np.minimum(corner, middle), np.maximum(corner, middle), radius)
    return None if goal is None else (start, goal)


layout = LayoutWithRespawn(place, place_again)
