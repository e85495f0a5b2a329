"""Straight lines from the vehicle: visible pedestrians, and walls in between. Compiled.

Obstacles are polygons `[polygon, corner, 2]` in metres, NaN after the last corner, of which only the edges count.
"""

from __future__ import annotations

import math
from typing import no_type_check

from crowdbench.sim.obstacles import number_of_corners
from crowdbench.utils.compiled import njit


@no_type_check
@njit(error_model="numpy")
def is_hidden(seen, position, radius, present, obstacles):
    """Return whether walls and other pedestrians hide an agent from the vehicle. Compiled.

    It is hidden if none of three points can be seen from the vehicle's position: its centre, and the two ends of its
    diameter across the line of sight.

    Args:
        seen (int): Index of the agent.
        position (array): `[agent, 2]`, the vehicle's first, in metres.
        radius (array): `[agent]`, in metres.
        present (array): `[agent]`; agents that are not present do not hide others.
        obstacles (array): `[polygon, corner, 2]`, in metres.

    Returns:
        hidden (bool): True if it is hidden.
    """
    x, y = position[0, 0], position[0, 1]
    dx, dy = position[seen, 0] - x, position[seen, 1] - y
    distance = math.sqrt(dx * dx + dy * dy)
    across = radius[seen] / distance if distance > 0.0 else 0.0
    for side in (0.0, 1.0, -1.0):
        to_x, to_y = dx - side * across * dy, dy + side * across * dx
        if _is_behind_people(to_x, to_y, seen, position, radius, present):
            continue
        if len(obstacles) == 0 or share_to_walls(x, y, to_x, to_y, obstacles) == 1.0:
            return False
    return True


@no_type_check
@njit(error_model="numpy")
def _is_behind_people(dx, dy, seen, position, radius, present):
    """Return whether the line from the vehicle to the relative position (dx, dy) meets the disc of an agent except
    `seen`."""
    squared = dx * dx + dy * dy
    for a in range(1, len(radius)):
        if a == seen or not present[a]:
            continue
        bx, by = position[a, 0] - position[0, 0], position[a, 1] - position[0, 1]
        along = bx * dx + by * dy
        if along <= 0.0:
            continue
        share = min(along / squared, 1.0)
        bx, by = bx - share * dx, by - share * dy
        if bx * bx + by * by < radius[a] * radius[a]:
            return True
    return False


@no_type_check
@njit(error_model="numpy")
def share_to_walls(x, y, dx, dy, obstacles):
    """Return the share of a line after which it first meets an edge; 1 if it meets none."""
    least = 1.0
    for polygon in obstacles:
        corners = number_of_corners(polygon)
        for k in range(corners if corners > 2 else corners - 1):
            ax, ay = polygon[k, 0] - x, polygon[k, 1] - y
            ex, ey = polygon[(k + 1) % corners, 0] - x - ax, polygon[(k + 1) % corners, 1] - y - ay
            turn = dx * ey - dy * ex
            # An edge parallel to the line is not hit, except at its end.
            if turn == 0.0:
                continue
            share, on_edge = (ax * ey - ay * ex) / turn, (ax * dy - ay * dx) / turn
            if 0.0 <= share < least and 0.0 <= on_edge <= 1.0:
                least = share
    return least
