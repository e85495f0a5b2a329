"""The training scene of DS-RNN: pedestrians cross a circle, and the vehicle drives between two points of a square."""

import numpy as np

from crowdbench import InputError
from crowdbench.scenario import PerAgent, Placement, circle_crossing

TRIES = 2000
"""Largest number of draws of all pedestrians before the layout counts as full."""

RADIUS = 6.0
"""Radius of the circle, and half of the side of the square, in metres."""

LEAST_WAY = 6.0
"""Smallest distance in metres from the vehicle's start to its goal."""

CLEARANCE = 0.25
"""Smallest distance in metres, between rims, from pedestrians' starts to the vehicle's start and goal."""


def layout(
    rng: np.random.Generator,
    radius: PerAgent,
    preferred_speed: PerAgent,
    *,
    around_vehicle: float = 0.0,
) -> Placement:
    """Let pedestrians walk from a point near a circle to the opposite side, and the vehicle drive between two points of
    a square.

    Args:
        around_vehicle: For a vehicle that starts on the circle, smallest distance from pedestrians' starts to its start
            and goal; 0 for a vehicle that starts anywhere in the square [m].
    """
    way = np.zeros((2, 2))
    while np.linalg.norm(way[1] - way[0]) < LEAST_WAY:
        way = rng.uniform(-RADIUS, RADIUS, (2, 2))
        if around_vehicle > 0.0:
            angle = rng.uniform(0.0, 2.0 * np.pi)
            way[0] = RADIUS * np.cos(angle), RADIUS * np.sin(angle)
    least = np.maximum(radius[1:] + (radius[0] + CLEARANCE), around_vehicle)
    for _ in range(TRIES):
        placed = circle_crossing(rng, radius, preferred_speed, circle_radius=RADIUS)
        distance = np.linalg.norm(placed.start[1:, None] - way, axis=-1)
        if (distance >= least[:, None]).all():
            placed.start[0], placed.goal[0] = way
            return placed
    raise InputError(f"people find no room around the vehicle in {TRIES} draws: lower layout.around_vehicle")
