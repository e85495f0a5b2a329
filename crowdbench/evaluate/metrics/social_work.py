"""The metric of social work."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from crowdbench.evaluate.metrics.sums import total
from crowdbench.geometry import norm, wrap_angle
from crowdbench.types import Trace

STRENGTH = 2.1
"""Strength of the social force in m/s^2, and the next four, are those of HuNavSim."""

VELOCITY_WEIGHT = 2.0
"""Moussaïd's lambda in s/m: how much a relative velocity counts beside the direction to the other."""

RANGE = 0.35
"""Moussaïd's gamma in m, times the length of the interaction vector."""

TURNING = 2.0
"""Moussaïd's n in 1/m, of the force that turns."""

BRAKING = 3.0
"""Moussaïd's n' in 1/m, of the force that brakes."""

OBSTACLE_STRENGTH = 10.0
"""Strength of the force of the nearest obstacle in m/s^2, and its range, are those of HuNavSim."""

OBSTACLE_RANGE = 0.2
"""In metres."""


def social_work(trace: Trace) -> Float[np.ndarray, "world"]:
    """Size of the social forces on the vehicle, and of those that it exerts on each pedestrian, over time [m/s].

    HuNavSim (Pérez-Higueras et al. 2023): the size of the sum of the forces of all pedestrians on the vehicle, that of
    the force of the nearest obstacle on it, and the sizes of the vehicle's forces on the pedestrians, with the social
    force of Moussaïd et al. (2009). Here each step counts with its duration, so that the sum does not depend on the
    time step.
    """
    position, velocity = trace.position[:, 1:], trace.velocity[:, 1:]
    between, relative = position[:, :, 1:] - position[:, :, :1], velocity[:, :, :1] - velocity[:, :, 1:]
    on_vehicle = _social_force(between, relative)
    x, y = total(on_vehicle[..., 0]), total(on_vehicle[..., 1])
    obstacle = OBSTACLE_STRENGTH * np.exp(-np.maximum(trace.wall_gap, 0.0) / OBSTACLE_RANGE)
    on_pedestrians = total(norm(_social_force(-between, -relative)))
    return total(np.hypot(x, y) + obstacle + on_pedestrians) * trace.rules.dt


def _social_force(
    between: Float[np.ndarray, "*batch 2"], relative: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """The force of another agent in m/s^2 (Moussaïd et al. 2009).

    Args:
        between: The way to the other in metres.
        relative: The agent's own velocity less the other's, in m/s.

    Returns:
        The force; 0 where the interaction vector vanishes.
    """
    distance = norm(between)
    direction = between / np.maximum(distance, np.finfo(float).tiny)[..., None]
    interaction = VELOCITY_WEIGHT * relative + direction
    length = np.maximum(norm(interaction), 1e-9)
    ahead = interaction / length[..., None]
    aside = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    angle = np.arctan2(direction[..., 1], direction[..., 0]) - np.arctan2(ahead[..., 1], ahead[..., 0])
    angle, reach = wrap_angle(angle), RANGE * length
    brakes = np.exp(-distance / reach - (BRAKING * reach * angle) ** 2)
    turns = np.sign(angle) * np.exp(-distance / reach - (TURNING * reach * angle) ** 2)
    return np.asarray(-STRENGTH * (brakes[..., None] * ahead + turns[..., None] * aside))
