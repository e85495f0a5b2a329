"""The scene in which DS-RNN was trained: people cross a circle, and the vehicle goes somewhere else in its square."""

import numpy as np

from crowdbench.scenario.layouts import circle_crossing
from crowdbench.scenario.placement import PerAgent, Placement

LEAST_WAY = 6.0
"""Smallest distance in metres from the vehicle's start to its goal."""

CLEARANCE = 0.25
"""Smallest distance in metres from people's starts to the vehicle's start and goal, between rims."""


def layout(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    circle_radius: float = 6.0,
    around_vehicle: float = 0.0,
) -> Placement:
    """People walk from a point near a circle to the opposite side, the vehicle from one point in its square to another.

    Args:
        circle_radius: Radius of the circle [m].
        around_vehicle: For a vehicle that starts on the circle, smallest distance from people's starts to its start and
            goal; 0 for one that starts anywhere in the square [m].
    """
    way = np.zeros((2, 2))
    while np.linalg.norm(way[1] - way[0]) < LEAST_WAY:
        way = rng.uniform(-circle_radius, circle_radius, (2, 2))
        if around_vehicle > 0.0:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            way[0] = circle_radius * np.cos(angle), circle_radius * np.sin(angle)
    least = np.maximum(radius[1:] + (radius[0] + CLEARANCE), around_vehicle)
    while True:
        placed = circle_crossing(rng, radius, preferred_speed, circle_radius=circle_radius)
        distance = np.linalg.norm(placed.start[1:, None] - way, axis=-1)
        if (distance >= least[:, None]).all():
            placed.start[0], placed.goal[0] = way
            return placed
