"""The linear programs of ORCA (van den Berg et al. 2011, sections 5.1 and 5.3), compiled.

A half-plane of permitted velocities is stored as its boundary line, `(point x, point y, direction x, direction y)` in
m/s with a direction of length 1. Velocities to the left of the direction are permitted.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np

from crowdbench.utils.compiled import njit

AS_VELOCITY, AS_DIRECTION = np.bool_(False), np.bool_(True)
"""Objective of a linear program. For literals, numba would compile it twice."""

_PARALLEL = 1e-5
"""Lines are parallel if the cross product of their directions is not larger than this, as in the library RVO2."""


@no_type_check
@njit(error_model="numpy", forceinline=True)
def unit(x, y):
    """Return the unit vector along (x, y), and its length.

    Args:
        x (float): First coordinate.
        y (float): Second coordinate.

    Returns:
        x (float): First coordinate of the unit vector; 1 for the zero vector.
        y (float): Its second coordinate.
        length (float): The length of (x, y).
    """
    length = math.sqrt(x * x + y * y)
    if length == 0.0:
        return 1.0, 0.0, 0.0
    return x / length, y / length, length


@no_type_check
@njit(error_model="numpy", forceinline=True)
def _nearest_on_line(lines, k, speed, x, y, as_direction):
    """Return the best velocity on line k that the lines before it and the speed limit permit.

    Args:
        lines: `[line, 4]`.
        k: Index of the line.
        speed: Largest speed in m/s.
        x, y: The wanted velocity in m/s, or the wanted direction.
        as_direction: True to go as far as possible in the direction (x, y), instead of as near as possible to it.

    Returns:
        True if there is such a velocity, and its x and y, or (x, y) if there is none.
    """
    px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
    dot = px * dx + py * dy
    discriminant = dot * dot + speed * speed - (px * px + py * py)
    if discriminant < 0.0:
        return False, x, y
    root = math.sqrt(discriminant)
    left, right = -dot - root, -dot + root
    for j in range(k):
        cross = dx * lines[j, 3] - dy * lines[j, 2]
        offset = lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])
        if abs(cross) <= _PARALLEL:
            if offset < 0.0:
                return False, x, y
            continue
        t = offset / cross
        if cross >= 0.0:
            right = min(right, t)
        else:
            left = max(left, t)
        if left > right:
            return False, x, y
    if as_direction:
        t = right if x * dx + y * dy > 0.0 else left
    else:
        t = min(max(dx * (x - px) + dy * (y - py), left), right)
    return True, px + t * dx, py + t * dy


@no_type_check
@njit(error_model="numpy", forceinline=True)
def nearest_permitted(lines, n, speed, x, y, as_direction):
    """Return the permitted velocity nearest to (x, y), or farthest in its direction (section 5.1).

    Args:
        lines (array): `[line, 4]`.
        n (int): Number of lines.
        speed (float): Largest speed in m/s.
        x (float): x of the wanted velocity in m/s, or of the wanted direction.
        y (float): Its y.
        as_direction (bool): True if (x, y) is a direction.

    Returns:
        met (int): Number of lines before the first line that contradicts the lines before it; n if there is none.
        x (float): x of the best velocity for those lines, in m/s.
        y (float): Its y.
    """
    best_x, best_y = x, y
    if as_direction:
        best_x, best_y = x * speed, y * speed
    elif x * x + y * y > speed * speed:
        ux, uy, _ = unit(x, y)
        best_x, best_y = ux * speed, uy * speed
    for k in range(n):
        if lines[k, 2] * (lines[k, 1] - best_y) - lines[k, 3] * (lines[k, 0] - best_x) > 0.0:
            exists, new_x, new_y = _nearest_on_line(lines, k, speed, x, y, as_direction)
            if not exists:
                return k, best_x, best_y
            best_x, best_y = new_x, new_y
    return n, best_x, best_y


@no_type_check
@njit(error_model="numpy")
def least_violation(lines, n, hard, failed, speed, x, y, scratch):
    """Return the velocity whose largest distance beyond a line is smallest (section 5.3).

    Args:
        lines (array): `[line, 4]`.
        n (int): Number of lines.
        hard (int): Number of lines at the beginning that are hard constraints: the lines of obstacles.
        failed (int): Index of the first line that cannot be met.
        speed (float): Largest speed in m/s.
        x (float): x of the best velocity for the lines before `failed`, in m/s.
        y (float): Its y.
        scratch (array): `[line, 4]`, working memory.

    Returns:
        x (float): x of the velocity in m/s.
        y (float): Its y.
    """
    worst = 0.0
    for k in range(failed, n):
        px, py, dx, dy = lines[k, 0], lines[k, 1], lines[k, 2], lines[k, 3]
        if dx * (py - y) - dy * (px - x) <= worst:
            continue
        for j in range(hard):
            for part in range(4):
                scratch[j, part] = lines[j, part]
        m = hard
        for j in range(hard, k):
            cross = dx * lines[j, 3] - dy * lines[j, 2]
            if abs(cross) <= _PARALLEL:
                if dx * lines[j, 2] + dy * lines[j, 3] > 0.0:
                    continue
                scratch[m, 0], scratch[m, 1] = 0.5 * (px + lines[j, 0]), 0.5 * (py + lines[j, 1])
            else:
                t = (lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])) / cross
                scratch[m, 0], scratch[m, 1] = px + t * dx, py + t * dy
            scratch[m, 2], scratch[m, 3], _ = unit(lines[j, 2] - dx, lines[j, 3] - dy)
            m += 1
        missed, new_x, new_y = nearest_permitted(scratch, m, speed, -dy, dx, AS_DIRECTION)
        # A solution always exists. If it is missed because of rounding, the last one is kept.
        if missed == m:
            x, y = new_x, new_y
        worst = dx * (py - y) - dy * (px - x)
    return x, y
