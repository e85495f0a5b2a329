"""Plane geometry of moving discs and headings."""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit


@no_type_check
@njit(cache=True)
def nearest_in_step(i, position, motion, radius, seen):
    """The least distance in a step between agent i's rim and another's, in metres, and whose it is.

    Of one world: `position [agent, 2]` before the step, `motion [agent, 2]` in metres, straight and even,
    `radius [agent]`, `seen [agent]`. Infinite and -1 where nobody is seen. The only place that sweeps discs.
    """
    least, nearest = np.inf, -1
    for j in range(len(radius)):
        if j != i and seen[j]:
            x, y = position[j, 0] - position[i, 0], position[j, 1] - position[i, 1]
            dx, dy = motion[j, 0] - motion[i, 0], motion[j, 1] - motion[i, 1]
            squared = dx * dx + dy * dy
            share = min(max(-(x * dx + y * dy) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
            x, y = x + share * dx, y + share * dy
            gap = math.sqrt(x * x + y * y) - radius[j] - radius[i]
            if gap < least:
                least, nearest = gap, j
    return least, nearest


def norm(vector: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch"]:
    """Length of each vector."""
    x, y = vector[..., 0], vector[..., 1]
    return np.sqrt(x * x + y * y)


@no_type_check
@njit(cache=True)
def heading_of(vx, vy, before):
    """The direction of a velocity in radians, or the heading `before` where there is no motion. Compiled."""
    return math.atan2(vy, vx) if vx != 0.0 or vy != 0.0 else before


@no_type_check
@njit(cache=True)
def turn(before, after):
    """The change from one heading to another, in [-pi, pi), all in radians. Compiled, for one pair."""
    return (after - before + math.pi) % (2.0 * math.pi) - math.pi


def wrap_angle(angle: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """The same angle in [-pi, pi), in radians."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def toward_goal(
    position: Float[np.ndarray, "*batch 2"],
    goal: Float[np.ndarray, "*batch 2"],
    preferred_speed: Float[np.ndarray, "*batch"],
) -> Float[np.ndarray, "*batch 2"]:
    """The vector to the goal, read as a velocity in m/s and shortened to the preferred speed.

    So an agent slows down over its last metre, as in CrowdNav.
    """
    out = np.empty(position.shape)
    _toward_goal(np.ascontiguousarray(position), np.ascontiguousarray(goal), np.ascontiguousarray(preferred_speed), out)
    return out


@no_type_check
@njit(cache=True)
def _toward_goal(position, goal, preferred_speed, out):
    # Reshaped here, where it costs nothing: these few numbers are wanted at every step.
    position, goal, out = position.reshape(-1, 2), goal.reshape(-1, 2), out.reshape(-1, 2)
    preferred_speed = preferred_speed.reshape(-1)
    for i in range(len(position)):
        x, y = goal[i, 0] - position[i, 0], goal[i, 1] - position[i, 1]
        scale = preferred_speed[i] / max(math.sqrt(x * x + y * y), preferred_speed[i])
        out[i, 0], out[i, 1] = scale * x, scale * y
