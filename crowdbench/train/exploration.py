"""Exploration in training: random commands every now and then."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from crowdbench.planners.base import Planner
from crowdbench.planners.lookahead import ValuePlanner
from crowdbench.types import Observation


class EpsilonGreedy(Planner):
    """Takes one of another planner's commands at random with probability epsilon, and else the best one.

    The random choice depends only on seed, case and step.

    Args:
        planner: The planner that knows the best command.
        epsilon: The probability of a random command, from 0 to 1.
        seed: The seed of the random choices.
    """

    def __init__(self, planner: ValuePlanner, epsilon: float, seed: int) -> None:
        self.privileged = planner.privileged
        self.planner = planner
        self.epsilon = epsilon
        self.purpose = f"exploration {seed}"

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        commands = self.planner.actions(obs.vehicle.preferred_speed)
        # Uniform numbers by the normal distribution function: the streams of a case have only normal numbers.
        explore, which = ndtr(obs.noise(self.purpose, (2,))).T
        chosen = commands[np.arange(len(obs)), (which * commands.shape[1]).astype(int)]
        greedy = explore >= self.epsilon
        if greedy.any():
            chosen[greedy] = self.planner.plan(obs.take(greedy))
        return chosen
