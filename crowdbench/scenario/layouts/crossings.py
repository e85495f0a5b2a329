"""Crossings on an empty plane.

They draw the same random numbers in the same order as CrowdNav (Chen et al. 2019), so that with CrowdNav's seeds they
give CrowdNav's cases.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from crowdbench.scenario.layouts.placed import TRIES, Placed
from crowdbench.scenario.placement import Placement


def circle_crossing(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    circle_radius: float = 4.0,
    perturbation: float = 0.0,
) -> Placement:
    """All agents walk from a point near a circle to the opposite point, the vehicle from bottom to top.

    Args:
        circle_radius: Radius of the circle [m].
        perturbation: Standard deviation of Gaussian noise on each coordinate of the vehicle's start and of all goals;
            noise of more than two standard deviations is drawn again. The starts of pedestrians always have CrowdNav's
            uniform noise [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """

    def nudge(x: float, y: float) -> tuple[float, float]:
        if perturbation == 0.0:
            return x, y
        while True:
            dx, dy = rng.normal(0.0, perturbation, 2)
            if max(abs(dx), abs(dy)) <= 2 * perturbation:
                return x + dx, y + dy

    placed = Placed(radius)
    placed.add(nudge(0.0, -circle_radius), nudge(0.0, circle_radius))
    speeds = preferred_speed.tolist()

    def place_next() -> bool:
        speed = speeds[len(placed.start)]
        for _ in range(TRIES):
            angle = rng.random() * np.pi * 2
            x = circle_radius * math.cos(angle) + (rng.random() - 0.5) * speed
            y = circle_radius * math.sin(angle) + (rng.random() - 0.5) * speed
            goal = nudge(-x, -y)
            if placed.start_is_clear(x, y) and placed.start_is_clear_of_goals(x, y):
                placed.add((x, y), goal)
                return True
        return False

    return placed.fill(place_next, f"a circle of {circle_radius:g} m radius", "layout.circle_radius")


def square_crossing(
    rng: np.random.Generator,
    radius: Float[np.ndarray, "agent"],
    preferred_speed: Float[np.ndarray, "agent"],
    *,
    square_width: float = 10.0,
    circle_radius: float = 4.0,
) -> Placement:
    """Pedestrians walk from one half of a square to the other, the vehicle upwards through its middle.

    Args:
        square_width: Width of the square [m].
        circle_radius: The vehicle goes from (0, -circle_radius) to (0, circle_radius) [m].

    Returns:
        See `Layout`, also for the parameters that all layouts have.
    """
    placed = Placed(radius)
    placed.add((0.0, -circle_radius), (0.0, circle_radius))

    def place_next() -> bool:
        side = -1.0 if rng.random() > 0.5 else 1.0
        start = _first(rng, square_width, side, placed.start_is_clear)
        goal = start and _first(rng, square_width, -side, placed.goal_is_clear)
        if start is None or goal is None:
            return False
        placed.add(start, goal)
        return True

    return placed.fill(place_next, f"a square of {square_width:g} m", "layout.square_width")


def _first(
    rng: np.random.Generator, width: float, side: float, clear: Callable[[float, float], bool]
) -> tuple[float, float] | None:
    """The first drawn position in one half of a square that is clear, None if none is.

    Args:
        rng: The random stream of the case.
        width: Width of the square [m].
        side: -1 for its left half, 1 for its right half.
        clear: Whether a position in metres is clear.
    """
    for _ in range(TRIES):
        x = rng.random() * width * 0.5 * side
        y = (rng.random() - 0.5) * width
        if clear(x, y):
            return x, y
    return None
