"""The walls that are nearest to a vehicle, in different directions."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.sim.obstacles import nearest_on_segment, number_of_corners
from crowdbench.utils.compiled import njit

APART = math.cos(math.radians(45.0))
"""Two walls are shown only if they are at least 45 degrees apart, so that a block nearby does not stand for all."""


def nearest_walls(
    position: Float[np.ndarray, "world 2"],
    obstacles: Float[np.ndarray, "world polygon corner 2"],
    number: int,
    reach: float,
) -> Float[np.ndarray, "world wall 2"]:
    """The nearest points of the nearest edges of obstacles in directions that differ, nearest first.

    Args:
        position: Points in metres.
        obstacles: Polygons in metres, NaN after the last corner.
        number: How many points of each world.
        reach: The largest distance in metres.

    Returns:
        Points in metres, NaN where fewer are within reach.
    """
    walls = np.full((len(position), number, 2), np.nan)
    _fill_walls(np.ascontiguousarray(position), np.ascontiguousarray(obstacles), reach, walls)
    return walls


@no_type_check
@njit(error_model="numpy")
def _fill_walls(position, obstacles, reach, walls):
    """Fill `walls`, see `nearest_walls`."""
    for w in range(len(position)):
        x, y = position[w, 0], position[w, 1]
        for place in range(walls.shape[1]):
            nearest = reach
            for polygon in obstacles[w]:
                corners = number_of_corners(polygon)
                for k in range(corners if corners > 2 else corners - 1):
                    a, b = polygon[k], polygon[(k + 1) % corners]
                    point = nearest_on_segment(x, y, a[0], a[1], b[0], b[1])
                    distance = math.hypot(point[0] - x, point[1] - y)
                    if distance < nearest and _is_apart(point, distance, position[w], walls[w, :place]):
                        nearest = distance
                        walls[w, place, 0], walls[w, place, 1] = point
            if nearest == reach:
                break


@no_type_check
@njit(error_model="numpy")
def _is_apart(point, distance, position, walls):
    """Whether a point, at a distance in metres from a position, is in another direction than all walls."""
    x, y = point[0] - position[0], point[1] - position[1]
    for wall in walls:
        wall_x, wall_y = wall[0] - position[0], wall[1] - position[1]
        if x * wall_x + y * wall_y > APART * distance * math.hypot(wall_x, wall_y):
            return False
    return True
