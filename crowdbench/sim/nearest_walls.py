"""The walls that are nearest to a vehicle."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float

from crowdbench.sim.obstacles import nearest_on_segment, number_of_corners
from crowdbench.utils.compiled import njit


def nearest_walls(
    position: Float[np.ndarray, "world 2"],
    obstacles: Float[np.ndarray, "world polygon corner 2"],
    number: int,
    reach: float,
) -> Float[np.ndarray, "world wall 2"]:
    """The nearest points of the nearest edges of obstacles, nearest first.

    Args:
        position: Points in metres.
        obstacles: Polygons in metres, NaN after the last corner.
        number: How many edges of each world.
        reach: The largest distance in metres.

    Returns:
        Points in metres, NaN where fewer edges are within reach.
    """
    walls = np.full((len(position), number, 2), np.nan)
    _fill_walls(np.ascontiguousarray(position), np.ascontiguousarray(obstacles), reach, walls)
    return walls


@no_type_check
@njit(error_model="numpy")
def _fill_walls(position, obstacles, reach, walls):
    """Fill `walls`, see `nearest_walls`."""
    number = walls.shape[1]
    away = np.empty(number)
    for w in range(len(position)):
        away[:] = reach
        x, y = position[w, 0], position[w, 1]
        for polygon in obstacles[w]:
            corners = number_of_corners(polygon)
            for k in range(corners if corners > 2 else corners - 1):
                a, b = polygon[k], polygon[(k + 1) % corners]
                nearest_x, nearest_y = nearest_on_segment(x, y, a[0], a[1], b[0], b[1])
                distance, place = math.hypot(nearest_x - x, nearest_y - y), number
                while place > 0 and distance < away[place - 1]:
                    place -= 1
                if place < number:
                    for later in range(number - 1, place, -1):
                        away[later] = away[later - 1]
                        walls[w, later, 0], walls[w, later, 1] = walls[w, later - 1, 0], walls[w, later - 1, 1]
                    away[place], walls[w, place, 0], walls[w, place, 1] = distance, nearest_x, nearest_y
