"""The pedestrians of PSS-Social: a social force of goal, other agents and borders, executed by the physics of MPE.

[pedestrians]
policy = "./mpe_pedestrians.py"
"""

import numpy as np
from jaxtyping import Float
from mpe_physics import pairs, positions_of_mpe, velocities_after

from crowdbench import PedestrianPolicy, World
from crowdbench.sim import Parameters, Velocities

SPEED, RELAXATION = 0.5, 0.5
"""Desired speed in m/s and relaxation time in seconds."""

REPULSION, RANGE = 3.0, 0.4
"""Force between agents in contact, and the distance in metres over which it falls by a factor of e."""

BORDER, BORDER_FORCE, BORDER_WIDTH = 1.5, 2.0, 0.3
"""Half of the side of the square in metres, the force at its border, and the width in metres in which it acts."""

LARGEST = 2.0
"""Largest force."""


class PSSSocialPedestrians(PedestrianPolicy):
    """Pedestrians whose actions are a social force, limited to 1 along each axis."""

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        position = positions_of_mpe(world.position, world.velocity)
        away, distance = (part[:, 1:] for part in pairs(position, world.present))
        velocity = world.velocity[:, 1:]
        force = _toward_goal(world.goal[:, 1:] - position[:, 1:], velocity) + _from_border(position[:, 1:])
        force += (REPULSION * np.exp(-distance / RANGE)[..., None] * away).sum(axis=2)
        size = np.sqrt((force**2).sum(axis=2, keepdims=True))
        action = np.clip(force / np.maximum(size / LARGEST, 1.0), -1.0, 1.0)
        return velocities_after(velocity, action, away, distance)


def _toward_goal(ahead: Velocities, velocity: Velocities) -> Velocities:
    """Return the force of the goal, from the vector to it in metres and the velocity in m/s."""
    length = np.sqrt((ahead**2).sum(axis=2, keepdims=True))
    return (SPEED * ahead / np.maximum(length, 1e-6) - velocity) / RELAXATION


def _from_border(position: Float[np.ndarray, "world pedestrian 2"]) -> Velocities:
    """Return the force of the border, which acts near it and outside of it."""
    inside = BORDER - np.abs(position)
    force = BORDER_FORCE * np.exp(-np.maximum(inside, 1e-6) / RANGE)
    return np.where(inside < BORDER_WIDTH, -np.sign(position) * force, 0.0)


def policy() -> PSSSocialPedestrians:
    """Make the policy."""
    return PSSSocialPedestrians()
