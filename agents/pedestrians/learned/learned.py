"""Pedestrians with a network that was trained jointly for vehicle and pedestrians, see studies/cross_play.

PPO with shared parameters (Schulman et al. 2017; de Witt et al. 2020, arXiv:2011.09533). Three networks differ in the
seed of their training.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, no_type_check

import numpy as np
from safetensors.numpy import load_file

from crowdbench import InputError, PedestrianPolicy, World
from crowdbench.networks import clip_to_disc, direction, to_world
from crowdbench.sim import Parameters, Velocities, goals_on_way, observe
from crowdbench.utils import njit
from crowdbench.views import ego_views, encode

SEEDS = 3
"""Number of networks, whose seeds are 0, 1 and 2."""

WEIGHTS = Path(__file__).parent
"""The folder of their weights."""

NEAREST = 3
"""Number of other agents that a pedestrian observes."""


LEAST = 1e-9
"""Lower bound in m/s of the speed that reaches the goal in one step: `clip_to_disc` divides by it."""


class Learned(PedestrianPolicy):
    """Policy that takes the mean action of the network, up to the preferred speed, and stops at the goal."""

    parameters: ClassVar[Mapping[str, float]] = {"seed": 0}

    def __init__(self) -> None:
        networks = [load_file(WEIGHTS / f"learned-seed{seed}.safetensors") for seed in range(SEEDS)]
        self.weights = [np.stack([part[name] for part in networks]).astype(float) for name in sorted(networks[0])]

    def velocities(self, world: World, parameters: Parameters) -> Velocities:
        """See `PedestrianPolicy`."""
        seed = parameters["seed"].astype(np.int64).reshape(-1)
        if seed.max() >= SEEDS:
            raise InputError(f"pedestrians.learned.seed is {seed.max()}, but must be 0 to {SEEDS - 1}")
        observed = encode(observe(ego_views(world)), "goal_frame", NEAREST)
        speed = world.preferred_speed[:, 1:].reshape(-1)
        action = mean_action(observed, seed, *self.weights).reshape(world.position.shape)[:, 1:].reshape(-1, 2)
        position, goal, way = (part[:, 1:].reshape(-1, 2) for part in (world.position, world.goal, goals_on_way(world)))
        left = np.maximum(np.linalg.norm(goal - position, axis=1) / world.rules.dt, LEAST)
        velocity = to_world(np.clip(action, -speed[:, None], speed[:, None]), direction(position, way))
        return clip_to_disc(velocity, np.minimum(speed, left)).reshape(len(world), -1, 2)


@no_type_check
@njit
def mean_action(observed, seed, b0, b1, b2, w0, w1, w2):
    """Compute the action of each row separately, with two hidden layers: matrix products depend on the batch."""
    actions = np.empty((len(observed), 2))
    for row in range(len(observed)):
        k = seed[row]
        hidden = np.tanh(_layer(observed[row], w0[k], b0[k]))
        actions[row] = _layer(np.tanh(_layer(hidden, w1[k], b1[k])), w2[k], b2[k])
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
    """Make the policy. Its parameter is set in the scenario, in `[pedestrians.learned]`.

    Parameters:
        seed: Seed of the training of a pedestrian's network: 0, 1 or 2 [1].

    Returns:
        The policy.
    """
    return Learned()
