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
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32

from crowdbench.utils.compiled import njit

VEHICLE = 6
"""The first six numbers are the vehicle's, the same with every pedestrian."""

SIZE = 13
"""The size of a joint state."""

DISTANCE = 11
"""Index of the distance between the centres."""


class VehicleState(NamedTuple):
    """One vehicle: position x and y in metres, velocity in m/s, radius and goal `[2]` in metres, speed in m/s."""

    x: float
    y: float
    vx: float
    vy: float
    radius: float
    goal: Float[np.ndarray, "2"]
    preferred_speed: float


class PedestrianStates(NamedTuple):
    """The pedestrians around it: positions in metres, velocities in m/s, radii in metres, and presence."""

    position: Float[np.ndarray, "pedestrian 2"]
    velocity: Float[np.ndarray, "pedestrian 2"]
    radius: Float[np.ndarray, "pedestrian"]
    present: Bool[np.ndarray, "pedestrian"]


def joint_states(
    position: Float[np.ndarray, "*batch agent 2"],
    velocity: Float[np.ndarray, "*batch agent 2"],
    radius: Float[np.ndarray, "*batch agent"],
    present: Bool[np.ndarray, "*batch agent"],
    goal: Float[np.ndarray, "*batch 2"],
    preferred_speed: Float[np.ndarray, "*batch"],
) -> Float32[np.ndarray, "*batch pedestrian 13"]:
    """Return the joint states of the vehicle with every pedestrian.

    Args:
        position: Centres in metres; agent 0 is the vehicle.
        velocity: Velocities in m/s.
        radius: Radii in metres.
        present: True if there is a pedestrian. The vehicle's own value is not read.
        goal: The vehicle's goal in metres.
        preferred_speed: The vehicle's preferred speed in m/s.

    Returns:
        A row for every pedestrian. An absent one has zeros from index 6 on. Without any pedestrian there is one row,
        that of an absent one.
    """
    *batch, agents = radius.shape
    out = np.empty((*batch, max(agents - 1, 1), SIZE), np.float32)
    axes = len(batch)
    agents_of_all = PedestrianStates(*(_flat(array, axes) for array in (position, velocity, radius, present)))
    _joint_states(agents_of_all, _flat(goal, axes), _flat(preferred_speed, axes), out.reshape(-1, *out.shape[-2:]))
    return out


def _flat(array: np.ndarray, axes: int) -> np.ndarray:
    """Return an array with one batch axis instead of `axes`."""
    return np.ascontiguousarray(array).reshape(-1, *array.shape[axes:])


@no_type_check
@njit
def write_joint_states(out, own, others):
    """Write the joint states of one vehicle with all pedestrians. Compiled.

    Args:
        out (array): `[row, 13]`, the output. Rows beyond the pedestrians belong to absent ones.
        own (VehicleState): The vehicle.
        others (PedestrianStates): The pedestrians.
    """
    dx, dy = own.goal[0] - own.x, own.goal[1] - own.y
    distance = math.sqrt(dx * dx + dy * dy)
    # At the goal there is no direction to it. The frame is then the world's, because CrowdNav takes atan2(0, 0) = 0.
    cos, sin = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
    for p in range(len(out)):
        out[p, 0], out[p, 1], out[p, 2], out[p, 3] = distance, own.preferred_speed, 0.0, own.radius
        out[p, 4], out[p, 5] = own.vx * cos + own.vy * sin, own.vy * cos - own.vx * sin
        if p >= len(others.present) or not others.present[p]:
            out[p, 6:] = 0.0
            continue
        px, py = others.position[p, 0] - own.x, others.position[p, 1] - own.y
        vx, vy = others.velocity[p, 0], others.velocity[p, 1]
        out[p, 6], out[p, 7] = px * cos + py * sin, py * cos - px * sin
        out[p, 8], out[p, 9] = vx * cos + vy * sin, vy * cos - vx * sin
        out[p, 10], out[p, 11] = others.radius[p], math.sqrt(px * px + py * py)
        out[p, 12] = others.radius[p] + own.radius


@no_type_check
@njit
def _joint_states(agents, goal, speed, out):
    for b in range(len(out)):
        x, y = agents.position[b, 0, 0], agents.position[b, 0, 1]
        vx, vy = agents.velocity[b, 0, 0], agents.velocity[b, 0, 1]
        own = VehicleState(x, y, vx, vy, agents.radius[b, 0], goal[b], speed[b])
        position, velocity = agents.position[b, 1:], agents.velocity[b, 1:]
        others = PedestrianStates(position, velocity, agents.radius[b, 1:], agents.present[b, 1:])
        write_joint_states(out[b], own, others)
