"""The joint state of the vehicle and a pedestrian: 13 numbers, the input of value networks.

It is that of Chen et al. (2019, section III-A), as CrowdNav computes it. The frame of its coordinates has the vehicle
as its origin, and its x axis points to the vehicle's goal. Lengths are in metres and speeds in m/s.

| index | of | quantity |
|---|---|---|
| 0 | vehicle | distance to the goal |
| 1 | vehicle | preferred speed |
| 2 | vehicle | heading, always 0 because the vehicle is holonomic |
| 3 | vehicle | radius |
| 4, 5 | vehicle | velocity, x and y |
| 6, 7 | pedestrian | position, x and y |
| 8, 9 | pedestrian | velocity, x and y |
| 10 | pedestrian | radius |
| 11 | both | distance between the centres |
| 12 | both | sum of the radii |
"""

from __future__ import annotations

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32

from crowdbench.compiled import njit

VEHICLE = 6
"""The first six numbers are the vehicle's, the same with every pedestrian."""

SIZE = 13
"""The size of a joint state."""

DISTANCE = 11
"""Index of the distance between the centres."""


def joint_states(
    position: Float[np.ndarray, "*batch agent 2"],
    velocity: Float[np.ndarray, "*batch agent 2"],
    radius: Float[np.ndarray, "*batch agent"],
    present: Bool[np.ndarray, "*batch agent"],
    goal: Float[np.ndarray, "*batch 2"],
    preferred_speed: Float[np.ndarray, "*batch"],
) -> Float32[np.ndarray, "*batch pedestrian 13"]:
    """The joint states of the vehicle with every pedestrian.

    Args:
        position: Centres in metres; agent 0 is the vehicle.
        velocity: Velocities in m/s.
        radius: Radii in metres.
        present: Whether there is a pedestrian. The vehicle's own value is not read.
        goal: The vehicle's goal in metres.
        preferred_speed: The vehicle's preferred speed in m/s.

    Returns:
        A row for every pedestrian. An absent one has zeros from index 6 on. Without any pedestrian there is one row,
        that of an absent one.
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
@njit
def write_joint_state(out, x, y, vx, vy, radius, goal, speed, position, velocity, radii, present):
    """Write the joint states of one vehicle with all pedestrians. Compiled.

    Args:
        out (array): `[row, 13]`, where they are written. Rows beyond the pedestrians are those of absent ones.
        x (float): The vehicle's position x in metres.
        y (float): The vehicle's position y in metres.
        vx (float): The vehicle's velocity x in m/s.
        vy (float): The vehicle's velocity y in m/s.
        radius (float): The vehicle's radius in metres.
        goal (array): `[2]`, the vehicle's goal in metres.
        speed (float): The vehicle's preferred speed in m/s.
        position (array): `[pedestrian, 2]`, centres in metres.
        velocity (array): `[pedestrian, 2]`, velocities in m/s.
        radii (array): `[pedestrian]`, radii in metres.
        present (array): `[pedestrian]`, whether there is a pedestrian.
    """
    dx, dy = goal[0] - x, goal[1] - y
    distance = math.sqrt(dx * dx + dy * dy)
    # At the goal there is no direction to it. The frame is then the world's, because CrowdNav takes atan2(0, 0) = 0.
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
@njit
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
