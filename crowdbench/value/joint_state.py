"""The joint state: 13 numbers per pedestrian, in the frame whose x axis points from the vehicle to its goal.

CrowdNav's (Chen et al. 2019, section III-A), as its code computes it. The vehicle's six come first and are the
same for all pedestrians: distance to the goal, preferred speed, heading (0, as it is holonomic), radius, velocity
x and y. Then the pedestrian's own seven: position x and y relative to the vehicle, velocity x and y, radius,
distance between the centres, sum of the radii.
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32
from numba import njit

VEHICLE = 6
"""So many numbers are the vehicle's."""

SIZE = 13

DISTANCE = 11
"""Place of the distance between the centres."""


def joint_states(
    position: Float[np.ndarray, "*batch agent 2"],
    velocity: Float[np.ndarray, "*batch agent 2"],
    radius: Float[np.ndarray, "*batch agent"],
    present: Bool[np.ndarray, "*batch agent"],
    goal: Float[np.ndarray, "*batch 2"],
    preferred_speed: Float[np.ndarray, "*batch"],
) -> Float32[np.ndarray, "*batch pedestrian 13"]:
    """The joint states of the vehicle, agent 0, with every other agent; `goal` and `preferred_speed` are its own.

    The row of an absent pedestrian has zeros for its own numbers, and there is a row even without pedestrians.
    """
    *batch, agents = radius.shape
    out = np.empty((*batch, max(agents - 1, 1), SIZE), np.float32)
    _joint_states(
        np.ascontiguousarray(position).reshape(-1, agents, 2),
        np.ascontiguousarray(velocity).reshape(-1, agents, 2),
        np.ascontiguousarray(radius).reshape(-1, agents),
        np.ascontiguousarray(present).reshape(-1, agents),
        np.ascontiguousarray(goal).reshape(-1, 2),
        np.ascontiguousarray(preferred_speed).reshape(-1),
        out.reshape(-1, out.shape[-2], SIZE),
    )
    return out


@no_type_check
@njit(cache=True)
def write_joint_state(out, x, y, vx, vy, radius, goal, speed, position, velocity, radii, present):
    """Write the joint states of one vehicle with all pedestrians `[pedestrian, ...]` into `out [pedestrian, 13]`."""
    dx, dy = goal[0] - x, goal[1] - y
    distance = math.sqrt(dx * dx + dy * dy)
    # At its goal the vehicle has no direction to it: the frame is then the world's, as atan2(0, 0) has it.
    cos, sin = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
    for p in range(len(out)):
        out[p, 0] = distance
        out[p, 1] = speed
        out[p, 2] = 0.0
        out[p, 3] = radius
        out[p, 4] = vx * cos + vy * sin
        out[p, 5] = vy * cos - vx * sin
        if p >= len(present) or not present[p]:
            out[p, 6:] = 0.0
            continue
        px, py = position[p, 0] - x, position[p, 1] - y
        out[p, 6] = px * cos + py * sin
        out[p, 7] = py * cos - px * sin
        out[p, 8] = velocity[p, 0] * cos + velocity[p, 1] * sin
        out[p, 9] = velocity[p, 1] * cos - velocity[p, 0] * sin
        out[p, 10] = radii[p]
        out[p, 11] = math.sqrt(px * px + py * py)
        out[p, 12] = radii[p] + radius


@no_type_check
@njit(cache=True)
def _joint_states(position, velocity, radius, present, goal, speed, out):
    for b in range(len(out)):
        write_joint_state(
            out[b],
            position[b, 0, 0],
            position[b, 0, 1],
            velocity[b, 0, 0],
            velocity[b, 0, 1],
            radius[b, 0],
            goal[b],
            speed[b],
            position[b, 1:],
            velocity[b, 1:],
            radius[b, 1:],
            present[b, 1:],
        )
