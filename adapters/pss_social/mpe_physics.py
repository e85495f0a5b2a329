"""The physics of MPE, the multi-agent particle environment, in the scene of PSS-Social: damping, forces, contacts.

A step of MPE moves each agent with its velocity from before the step, and then updates the velocity with the forces at
the positions before the step. A step of crowdbench moves each agent with its new velocity. Both are the same motion if
crowdbench's positions are MPE's positions of one step later, while the velocities are equal. Hence the position in MPE
is `position - DT * velocity`.
"""

import numpy as np
from jaxtyping import Bool, Float

DT = 0.1
"""Length of a step in seconds."""

DAMPING = 0.25
"""Share of its velocity that an agent loses in a step."""

GAIN = 5.0
"""Acceleration in m/s^2 along an axis by an action of 1. All agents have a mass of 1 kg."""

SIZE = 0.15
"""Radius of an agent in metres."""

STIFFNESS, MARGIN = 100.0, 1e-3
"""Contact force per depth of the overlap in N/m, and length in metres over which it begins."""


def positions_of_mpe(
    position: Float[np.ndarray, "*batch 2"], velocity: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 2"]:
    """Return the positions of MPE in metres, one step before crowdbench's positions."""
    return position - DT * velocity


def pairs(
    position: Float[np.ndarray, "world agent 2"], present: Bool[np.ndarray, "world agent"]
) -> tuple[Float[np.ndarray, "world agent agent 2"], Float[np.ndarray, "world agent agent"]]:
    """Return the unit vectors to each agent from each other agent, and their distances in metres.

    The distance to itself, and to an agent that is not present, is infinite.
    """
    away = position[:, :, None] - position[:, None]
    distance = np.sqrt((away**2).sum(axis=3))
    distance[np.broadcast_to(~present[:, None], distance.shape)] = np.inf
    agents = np.arange(position.shape[1])
    distance[:, agents, agents] = np.inf
    return away / np.maximum(distance, 1e-9)[..., None], distance


def velocities_after(
    velocity: Float[np.ndarray, "world agent 2"],
    action: Float[np.ndarray, "world agent 2"],
    away: Float[np.ndarray, "world agent other 2"],
    distance: Float[np.ndarray, "world agent other"],
) -> Float[np.ndarray, "world agent 2"]:
    """Return the velocities of agents after a step, in m/s.

    Args:
        velocity: Before the step, in m/s.
        action: Along each axis, from -1 to 1.
        away: Unit vectors from the other agents, see `pairs`.
        distance: Distances to the other agents in metres.
    """
    depth = MARGIN * np.logaddexp(0.0, (2.0 * SIZE - distance) / MARGIN)
    contact = STIFFNESS * (depth[..., None] * away).sum(axis=2)
    return (1.0 - DAMPING) * velocity + DT * (GAIN * action + contact)
