"""The starts and goals of PSS-Social: points of a square, apart from each other."""

import numpy as np

from crowdbench import InputError
from crowdbench.scenario import PerAgent, Placement

HALF_SIDE = 1.1
"""Half of the side of the square of starts and goals, in metres."""

APART, LEAST_WAY = 0.3, 0.8
"""Smallest distance in metres between two starts, and from a start to its goal."""

TRIES = 10_000
"""Largest number of draws of a point."""


def layout(rng: np.random.Generator, radius: PerAgent, preferred_speed: PerAgent) -> Placement:
    """Draw starts that do not touch, and a goal for each."""
    start: list[np.ndarray] = []
    for _ in radius:
        start.append(_draw(rng, np.array(start).reshape(-1, 2), APART))
    goal = [_draw(rng, point[None], LEAST_WAY) for point in start]
    return Placement(start=np.array(start), goal=np.array(goal))


def _draw(rng: np.random.Generator, others: np.ndarray, distance: float) -> np.ndarray:
    """Return a point that is farther than a distance from others, in metres."""
    for _ in range(TRIES):
        point = rng.uniform(-HALF_SIDE, HALF_SIDE, 2)
        if (np.linalg.norm(others - point, axis=1) > distance).all():
            return point
    raise InputError(f"an agent finds no room in {TRIES} draws: lower pedestrians.number")
