"""Pedestrians with a network that was trained jointly for vehicle and pedestrians, see studies/learn_together.

PPO with shared parameters (Schulman et al. 2017; de Witt et al. 2020, arXiv:2011.09533).
"""

from pathlib import Path
from typing import no_type_check

import numpy as np

from crowdbench import PedestrianPolicy, World
from crowdbench.networks import clip_to_disc, direction, to_world
from crowdbench.sim import Parameters, Velocities, goals_on_way, observe
from crowdbench.utils import njit
from crowdbench.views import ego_views, encode

WEIGHTS = Path(__file__).with_name("learned.npz")

NEAREST = 3
"""Number of other agents that a pedestrian observes."""


LEAST = 1e-9
"""Lower bound in m/s of the speed that reaches the goal in one step: `clip_to_disc` divides by it."""


class Learned(PedestrianPolicy):
    """Policy that takes the mean action of the network, up to the preferred speed, and stops at the goal."""

    def __init__(self) -> None:
        with np.load(WEIGHTS) as weights:
            self.weights = [weights[name].astype(np.float64) for name in sorted(weights)]

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        observed = encode(observe(ego_views(world)), "goal_frame", NEAREST)
        speed = world.preferred_speed[:, 1:].reshape(-1)
        action = mean_action(observed, *self.weights).reshape(world.position.shape)[:, 1:].reshape(-1, 2)
        position, goal, way = (part[:, 1:].reshape(-1, 2) for part in (world.position, world.goal, goals_on_way(world)))
        left = np.maximum(np.linalg.norm(goal - position, axis=1) / world.rules.dt, LEAST)
        velocity = to_world(np.clip(action, -speed[:, None], speed[:, None]), direction(position, way))
        return clip_to_disc(velocity, np.minimum(speed, left)).reshape(len(world), -1, 2)


@no_type_check
@njit
def mean_action(observed, b0, b1, b2, w0, w1, w2):
    """Compute the action of each row separately, with two hidden layers: matrix products depend on the batch."""
    actions = np.empty((len(observed), 2))
    for row in range(len(observed)):
        hidden = np.tanh(_layer(observed[row], w0, b0))
        actions[row] = _layer(np.tanh(_layer(hidden, w1, b1)), w2, b2)
    return actions


@no_type_check
@njit
def _layer(values, weight, bias):
    out = bias.copy()
    for unit in range(len(out)):
        for index in range(len(values)):
            out[unit] += weight[unit, index] * values[index]
    return out


def policy() -> Learned:
    """Make the policy. It has no parameters.

    Returns:
        The policy.
    """
    return Learned()
