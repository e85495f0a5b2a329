"""What is observed, as one row of numbers: the form in which learning libraries want it.

Six numbers for whoever looks, then six for each other agent, in metres and m/s, along the axes of the
world (moved with the viewer, not turned):

    goal x, y (less own position) | velocity x, y | radius | preferred speed
    position x, y (less the viewer's) | velocity x, y | radius | 1.0, or all six 0.0 where nobody is seen

The vehicle sees the pedestrians in their order; a pedestrian sees the vehicle, then the other pedestrians.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit

from crowdbench.types import Observation, World

AGENT_FEATURES = 6
"""Numbers per agent, the viewer included."""


def flatten(obs: Observation) -> Float[np.ndarray, "world features"]:
    """What the vehicle sees, as the environments return it: `6 * (1 + pedestrians)` float64 numbers a world."""
    position, velocity, radius, present = obs.everybody()
    goal = np.ascontiguousarray(obs.vehicle.goal[:, None])
    speed = np.ascontiguousarray(obs.vehicle.preferred_speed[:, None])
    out = np.zeros((len(obs), 1, AGENT_FEATURES * radius.shape[1]))
    _flatten(position, velocity, radius, present, goal, speed, True, out)
    return out[:, 0]


def flatten_everybody(world: World) -> Float[np.ndarray, "world agent features"]:
    """What each agent sees from its own place, zeros for absent ones. Row 0 is `flatten(observe(world))`.

    A vehicle that is not visible is not seen by the pedestrians.
    """
    worlds, agents = world.radius.shape
    out = np.zeros((worlds, agents, AGENT_FEATURES * agents))
    _flatten(
        world.position,
        world.velocity,
        world.radius,
        world.present,
        world.goal,
        world.preferred_speed,
        world.rules.visible,
        out,
    )
    return out


@no_type_check
@njit(cache=True)
def _flatten(position, velocity, radius, present, goal, preferred_speed, visible, out):
    """Fill `out[world, viewer]`, which is zero, for as many viewers as it has room for."""
    worlds, viewers, _ = out.shape
    for w in range(worlds):
        for i in range(viewers):
            if not present[w, i]:
                continue
            row = out[w, i]
            x, y = position[w, i, 0], position[w, i, 1]
            row[0], row[1] = goal[w, i, 0] - x, goal[w, i, 1] - y
            row[2], row[3] = velocity[w, i, 0], velocity[w, i, 1]
            row[4], row[5] = radius[w, i], preferred_speed[w, i]
            k = 0
            for j in range(radius.shape[1]):
                if j == i:
                    continue
                k += AGENT_FEATURES
                if present[w, j] and (j > 0 or visible):
                    row[k], row[k + 1] = position[w, j, 0] - x, position[w, j, 1] - y
                    row[k + 2], row[k + 3] = velocity[w, j, 0], velocity[w, j, 1]
                    row[k + 4], row[k + 5] = radius[w, j], 1.0
