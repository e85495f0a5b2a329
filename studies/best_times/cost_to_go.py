"""Lengths of the shortest paths around obstacles to the goal, from all positions: the cost-to-go of a search."""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from crowdbench.sim import wall_gap_in_step
from crowdbench.utils import njit

CELL = 0.1
"""Distance in metres between the points of the grid."""

ROOM = 4.0
"""Margin in metres of the searched area around the start, the goal and all obstacles, or half the distance from start
to goal if that is larger."""

_STEPS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [2, 1], [1, 2], [2, -1], [1, -2]])
"""Offsets from a grid point to its neighbours, one per pair of directions; paths are too long by 2.7 % at most."""


Point = Float[np.ndarray, "2"]


class CostToGo(NamedTuple):
    """Lengths of the shortest paths to a goal from the points of a grid. For kernels.

    Attributes:
        goal: The goal in metres.
        low: The corner of the searched area, and the first point of the grid, in metres.
        high: The opposite corner.
        length: The length of the path from each point of the grid in metres, infinite if there is no path. It is empty
            without obstacles, because paths are straight.
    """

    goal: Point
    low: Point
    high: Point
    length: Float[np.ndarray, "x y"]


def find_cost_to_go(
    start: Point, goal: Point, radius: float, obstacles: Float[np.ndarray, "polygon corner 2"]
) -> CostToGo:
    """Return the path lengths of a disc.

    Args:
        start: Start of the vehicle in metres.
        goal: Goal of the vehicle in metres.
        radius: Radius of the disc in metres.
        obstacles: Polygons in metres, NaN beyond the last corner of each.
    """
    corners = obstacles[np.isfinite(obstacles[..., 0])]
    points = np.concatenate([[start, goal], corners])
    room = max(ROOM, 0.5 * math.dist(start, goal))
    low, high = points.min(axis=0) - room, points.max(axis=0) + room
    if not len(corners):
        return CostToGo(goal, low, high, np.empty((0, 0)))
    shape = tuple(np.ceil((high - low) / CELL).astype(np.int64) + 1)
    near = np.rint((goal - low) / CELL).astype(np.int64)
    low = goal - near * CELL  # so that the goal is a point of the grid
    # The centre of a vehicle on wheels is not farther from a wall than its discs are wide.
    free = np.empty((len(_STEPS), *shape), bool)
    _fill_free(low, radius, obstacles, free)
    step, *point = np.nonzero(free)
    one = np.ravel_multi_index(point, shape)
    other = np.ravel_multi_index([each + _STEPS[step, axis] for axis, each in enumerate(point)], shape)
    length = CELL * np.sqrt((_STEPS**2).sum(axis=1))[step]
    graph = coo_array((length, (one, other)), shape=(math.prod(shape),) * 2).tocsr()
    found = dijkstra(graph, directed=False, indices=np.ravel_multi_index(tuple(near), shape))
    return CostToGo(goal, low, high, found.reshape(shape))


@no_type_check
@njit(nogil=True, error_model="numpy")
def cost_left(x, y, cost):
    """Return the length of the path from a point (x, y) to the goal of a `CostToGo`, in metres. Compiled."""
    goal, low, _, length = cost
    if length.shape[0] == 0:
        return math.hypot(goal[0] - x, goal[1] - y)
    i, j = round((x - low[0]) / CELL), round((y - low[1]) / CELL)
    least = math.inf
    for k in range(max(i - 1, 0), min(i + 2, length.shape[0])):
        for m in range(max(j - 1, 0), min(j + 2, length.shape[1])):
            least = min(least, length[k, m] + math.hypot(low[0] + k * CELL - x, low[1] + m * CELL - y))
    return least


@no_type_check
@njit
def _fill_free(low, radius, obstacles, free):
    """Compute the pairs of neighbouring grid points between which a disc can move.

    Args:
        low (array): `[2]`, the first point in metres.
        radius (float): Radius of the disc in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres.
        free (array): `[step, x, y]`, filled: whether each of `_STEPS` can be taken from each point.
    """
    farthest = 3.0 * CELL
    for i in range(free.shape[1]):
        for j in range(free.shape[2]):
            x, y = low[0] + i * CELL, low[1] + j * CELL
            gap = wall_gap_in_step(x, y, 0.0, 0.0, radius, obstacles)
            for k in range(len(_STEPS)):
                inside = 0 <= i + _STEPS[k, 0] < free.shape[1] and 0 <= j + _STEPS[k, 1] < free.shape[2]
                free[k, i, j] = inside and gap >= 0.0
                if inside and 0.0 <= gap < farthest:
                    dx, dy = CELL * _STEPS[k, 0], CELL * _STEPS[k, 1]
                    free[k, i, j] = wall_gap_in_step(x, y, dx, dy, radius, obstacles) >= 0.0
