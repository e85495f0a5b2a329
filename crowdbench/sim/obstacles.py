"""Moving discs among obstacles: gaps, lines of sight, and sliding along walls. Compiled, for one world.

Obstacles are polygons `[polygon, corner, 2]` in metres, NaN after the last corner. Two corners are a wall that can be
touched from both sides, three or more are solid.
"""

from __future__ import annotations

import math
from typing import no_type_check

from crowdbench.utils.compiled import njit

_TOUCHING = 1e-9
"""Discs whose gap to a wall is below this, in metres, touch it."""

_SLIDES = 4
"""Largest number of contacts of a disc with walls in a step; the rest of its motion is lost."""


@no_type_check
@njit(error_model="numpy", nogil=True)
def wall_gap_in_step(x, y, dx, dy, radius, obstacles):
    """Return the smallest distance between a disc's rim and the obstacles while the disc moves straight. Compiled.

    This is, with `touches_in_step`, the only test of discs and obstacles.

    Args:
        x (float): x of its centre before the motion, in metres.
        y (float): Its y.
        dx (float): x of the motion in metres.
        dy (float): Its y.
        radius (float): Its radius in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres.

    Returns:
        gap (float): In metres, negative if the disc overlaps an obstacle, at least -radius; infinite without obstacles.
    """
    return _least_distance(x, y, dx, dy, obstacles, -1.0) - radius


@no_type_check
@njit(error_model="numpy", nogil=True)
def touches_in_step(x, y, dx, dy, radius, obstacles):
    """Return whether a disc touches obstacles while it moves straight: `wall_gap_in_step` is not positive. Compiled.

    Args:
        x (float): x of its centre before the motion, in metres.
        y (float): Its y.
        dx (float): x of the motion in metres.
        dy (float): Its y.
        radius (float): Its radius in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres.
    """
    return _least_distance(x, y, dx, dy, obstacles, radius) <= radius


@no_type_check
@njit(error_model="numpy", nogil=True)
def _least_distance(x, y, dx, dy, obstacles, enough):
    """Return the smallest distance in metres between a motion and obstacles, or any distance of at most `enough`."""
    least = math.inf
    for polygon in obstacles:
        corners = number_of_corners(polygon)
        inside = False
        for k in range(corners if corners > 2 else corners - 1):
            ax, ay = polygon[k, 0], polygon[k, 1]
            bx, by = polygon[(k + 1) % corners, 0], polygon[(k + 1) % corners, 1]
            if not _are_apart(x, y, dx, dy, ax, ay, bx, by, least):
                least = min(least, _between_segments(x, y, dx, dy, ax, ay, bx, by))
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                inside = not inside
        if inside and corners > 2:
            least = 0.0
        if least <= enough:
            break
    return least


@no_type_check
@njit(error_model="numpy")
def _are_apart(x, y, dx, dy, ax, ay, bx, by, distance):
    """Return whether the rectangles around a motion and the segment from a to b are farther apart than `distance`."""
    across = max(min(ax, bx) - max(x, x + dx), min(x, x + dx) - max(ax, bx), 0.0)
    along = max(min(ay, by) - max(y, y + dy), min(y, y + dy) - max(ay, by), 0.0)
    return across * across + along * along > distance * distance * (1.0 + 1e-9) + 1e-18


@no_type_check
@njit
def number_of_corners(polygon):
    """Return the number of corners of a polygon. Compiled.

    Args:
        polygon (array): `[corner, 2]`, in metres, NaN after the last corner.

    Returns:
        corners (int): Their number.
    """
    corners = 0
    while corners < len(polygon) and not math.isnan(polygon[corners, 0]):
        corners += 1
    return corners


@no_type_check
@njit(error_model="numpy")
def nearest_on_segment(x, y, ax, ay, bx, by):
    """Return the point of a segment that is nearest to another point. Compiled.

    Args:
        x (float): x of the other point in metres.
        y (float): Its y.
        ax (float): x of the segment's first end in metres.
        ay (float): Its y.
        bx (float): x of the segment's second end in metres.
        by (float): Its y.

    Returns:
        x (float): x of the nearest point in metres.
        y (float): Its y.
    """
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    share = min(max(((x - ax) * dx + (y - ay) * dy) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return ax + share * dx, ay + share * dy


@no_type_check
@njit(error_model="numpy")
def _between_segments(x, y, dx, dy, ax, ay, bx, by):
    """Return the distance in metres between the segment of a motion and the segment from a to b."""
    ex, ey = bx - ax, by - ay
    before, after = ex * (y - ay) - ey * (x - ax), ex * (y + dy - ay) - ey * (x + dx - ax)
    first, second = dx * (ay - y) - dy * (ax - x), dx * (by - y) - dy * (bx - x)
    if before * after < 0.0 and first * second < 0.0:
        return 0.0
    squared = _squared_to_segment(x, y, ax, ay, bx, by)
    squared = min(squared, _squared_to_segment(x + dx, y + dy, ax, ay, bx, by))
    squared = min(squared, _squared_to_segment(ax, ay, x, y, x + dx, y + dy))
    return math.sqrt(min(squared, _squared_to_segment(bx, by, x, y, x + dx, y + dy)))


@no_type_check
@njit(error_model="numpy")
def _squared_to_segment(x, y, ax, ay, bx, by):
    """Return the squared distance in square metres between a point and the segment from a to b."""
    nx, ny = nearest_on_segment(x, y, ax, ay, bx, by)
    return (x - nx) * (x - nx) + (y - ny) * (y - ny)


@no_type_check
@njit(error_model="numpy")
def slide(x, y, dx, dy, radius, obstacles):
    """Return the position of a disc after a motion in which it cannot pass walls. Compiled.

    If its rim touches a wall, it loses the component of the motion into the wall and slides along it. A disc that
    overlaps a wall can move along the wall and away from it.

    Args:
        x (float): x of its centre before the motion, in metres.
        y (float): Its y.
        dx (float): x of the motion in metres.
        dy (float): Its y.
        radius (float): Its radius in metres.
        obstacles (array): `[polygon, corner, 2]`, in metres.

    Returns:
        touched (bool): True if the disc touched a wall.
        x (float): x of its centre after the motion, in metres.
        y (float): Its y.
    """
    touched = False
    for _ in range(_SLIDES):
        share, nx, ny = _first_touch(x, y, dx, dy, radius, obstacles)
        x, y = x + share * dx, y + share * dy
        if share == 1.0:
            return touched, x, y
        touched = True
        dx, dy = (1.0 - share) * dx, (1.0 - share) * dy
        into = min(dx * nx + dy * ny, 0.0)
        dx, dy = dx - into * nx, dy - into * ny
    return touched, x, y


@no_type_check
@njit(error_model="numpy")
def _first_touch(x, y, dx, dy, radius, obstacles):
    """Return the share of a motion after which a disc touches a wall, 1 if it never does, and the wall's normal there.

    The normal points from the wall to the disc's centre.
    """
    least, normal_x, normal_y = 1.0, 0.0, 0.0
    for polygon in obstacles:
        corners = number_of_corners(polygon)
        for k in range(corners if corners > 2 else corners - 1):
            ax, ay = polygon[k, 0], polygon[k, 1]
            bx, by = polygon[(k + 1) % corners, 0], polygon[(k + 1) % corners, 1]
            if _are_apart(x, y, dx, dy, ax, ay, bx, by, radius + _TOUCHING):
                continue
            if _between_segments(x, y, dx, dy, ax, ay, bx, by) < radius + _TOUCHING:
                share, nx, ny = _touch_of_edge(x, y, dx, dy, radius, ax, ay, bx, by)
                if share < least:
                    least, normal_x, normal_y = share, nx, ny
    return least, normal_x, normal_y


@no_type_check
@njit(error_model="numpy")
def _touch_of_edge(x, y, dx, dy, radius, ax, ay, bx, by):
    """Return the result of `_first_touch` for the edge from a to b only."""
    px, py = nearest_on_segment(x, y, ax, ay, bx, by)
    nx, ny = x - px, y - py
    distance = math.sqrt(nx * nx + ny * ny)
    if distance < radius + _TOUCHING:
        # A centre exactly on the wall has no side, and may move in all directions.
        if distance > 0.0 and dx * nx + dy * ny < -_TOUCHING * distance:
            return 0.0, nx / distance, ny / distance
        return 1.0, 0.0, 0.0
    least, normal_x, normal_y = 1.0, 0.0, 0.0
    ex, ey = bx - ax, by - ay
    length = math.sqrt(ex * ex + ey * ey)
    ex, ey = ex / length, ey / length
    side = 1.0 if ex * (y - ay) - ey * (x - ax) > 0.0 else -1.0
    nx, ny = -side * ey, side * ex
    toward = -(dx * nx + dy * ny)
    if toward > 0.0:
        share = ((x - ax) * nx + (y - ay) * ny - radius) / toward
        along = (x + share * dx - ax) * ex + (y + share * dy - ay) * ey
        if 0.0 <= share < least and 0.0 <= along <= length:
            least, normal_x, normal_y = share, nx, ny
    for cx, cy in ((ax, ay), (bx, by)):
        share = _touch_of_corner(x - cx, y - cy, dx, dy, radius)
        if share < least:
            least = share
            normal_x, normal_y = (x + share * dx - cx) / radius, (y + share * dy - cy) / radius
    return least, normal_x, normal_y


@no_type_check
@njit(error_model="numpy")
def _touch_of_corner(x, y, dx, dy, radius):
    """Return the share of a motion after which a disc touches the origin; 1 if it never does."""
    squared, half = dx * dx + dy * dy, x * dx + y * dy
    root = half * half - squared * (x * x + y * y - radius * radius)
    if half >= 0.0 or root < 0.0:
        return 1.0
    return min(max((-half - math.sqrt(root)) / squared, 0.0), 1.0)
