"""Exploration in training: random commands every now and then."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.types import Observation


class EpsilonGreedy(Planner):
    """Takes a command within another planner's limits at random with probability epsilon, and else the best one.

    The random choice depends only on seed, case and step.

    Args:
        planner: The planner that knows the best command.
        epsilon: The probability of a random command, from 0 to 1.
        seed: The seed of the random choices.
    """

    def __init__(self, planner: ValuePlanner, epsilon: float, seed: int) -> None:
        self.privileged = planner.privileged
        self.native = planner.native
        self.planner = planner
        self.epsilon = epsilon
        self.purpose = f"exploration {seed}"

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        vehicle, limits = obs.vehicle, self.planner.limits
        commands = self.planner.commands(vehicle.state, vehicle.dynamics, vehicle.preferred_speed, obs.dt)
        allowed = np.ones(commands.shape[:2], bool)
        if limits is not None:
            after = vehicle.dynamics.velocities(vehicle.state, commands, vehicle.preferred_speed, obs.dt)
            allowed = limits.allow(vehicle.velocity, after, obs.dt)
        # Uniform numbers by the normal distribution function: the streams of a case have only normal numbers.
        explore, which = ndtr(obs.noise(self.purpose, (2,))).T
        drawn = (which * allowed.sum(axis=1)).astype(int)
        chosen = commands[np.arange(len(obs)), (allowed.cumsum(axis=1) > drawn[:, None]).argmax(axis=1)]
        greedy = explore >= self.epsilon
        if greedy.any():
            chosen[greedy] = self.planner.plan(obs.take(greedy))
        return chosen
