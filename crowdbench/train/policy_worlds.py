"""The worlds in which a policy is trained, as the policy observes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.envs.rewards import CheckedReward, Step
from crowdbench.envs.training_worlds import Driven, TrainingWorlds
from crowdbench.networks.features import Features
from crowdbench.planners.scan_interface import ScanInterface
from crowdbench.planners.trained_policy import PolicyInterface
from crowdbench.predict.linear import ConstantVelocity
from crowdbench.scenario.scenario import Scenario
from crowdbench.sim.sensor import observe
from crowdbench.views.view import View

NEAREST = 8
"""Largest number of pedestrians in the input of a policy with a memory."""


def make_interface(network: str, scenarios: Sequence[Scenario]) -> PolicyInterface | ScanInterface:
    """Return the observation of a policy: scans, or all pedestrians of the scenarios, or `NEAREST` at most.

    Args:
        network: The name of the network.
        scenarios: The scenarios of the training.
    """
    if network == "ppo_lidar":
        return ScanInterface()
    most = max(1, *(scenario.max_agents - 1 for scenario in scenarios))
    if network == "ppo_attention":
        return PolicyInterface(min(most, NEAREST), ConstantVelocity())
    return PolicyInterface(most)


class PolicyWorlds:
    """Training worlds of a scenario. A world with an ended episode starts the next one.

    Args:
        scenario: The scenario.
        rows: The rows of the worlds in the batch of all scenarios.
        cases: The number of training cases that are drawn at a restart.
        reward: The reward of a step.
        interface: The policy's observation and actions.
    """

    def __init__(
        self,
        scenario: Scenario,
        rows: np.ndarray,
        cases: int,
        reward: CheckedReward,
        interface: PolicyInterface | ScanInterface,
    ) -> None:
        self.rows = rows
        self.worlds = TrainingWorlds(len(rows), View(scenario, action="velocity"), reward, cases)
        self._interface = interface

    def restart(self, seed: int) -> None:
        """Draw training cases with a seed, and start new episodes in all worlds."""
        self.worlds.seed(seed)
        self.worlds.start()
        self._interface.reset(self.rows)

    def observe(self) -> Features:
        """Return the present input of the policy in each world."""
        self._observed = observe(self.worlds.worlds)
        features = self._interface(self._observed)
        self._axis = features.axis
        return features

    def step(self, action: Float[np.ndarray, "world 2"]) -> Driven:
        """Act as the policy does after `observe`."""
        return self.worlds.step(self._interface.velocities(action, self._observed, self._axis))

    def observe_last(self, step: Step, rows: Int[np.ndarray, "row"]) -> Features:
        """Return the input of the policy after a step in some of its worlds, before the next episode there."""
        return self._interface(observe(step.after.take(rows), rows))

    def forget(self, ended: Bool[np.ndarray, "world"]) -> None:
        """Forget ended episodes."""
        self._interface.forget(np.flatnonzero(ended))
