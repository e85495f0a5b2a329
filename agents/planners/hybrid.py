"""A learned policy proposes, and model predictive path integral control (MPPI) decides.

The policy drives where MPPI finds nothing that costs `patience` seconds less; its commands are candidates of MPPI's
search, too. Williams et al., "Information theoretic MPC for model-based reinforcement learning", ICRA 2017.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from crowdbench import MPPIPlanner, Observation, Planner, load_predictor
from crowdbench.planners import (
    MPPISearch,
    MPPIWeights,
    RadiusInflation,
    Scene,
    Sequence,
    Sequences,
    load_policy,
)

HOLDS = 1, 3, 6
"""Numbers of steps for which a proposal holds the policy's command."""

FEWER = dataclasses.replace(MPPIPlanner.search, samples=100)


@dataclasses.dataclass(eq=False, kw_only=True)
class HybridPlanner(MPPIPlanner):
    """Drives the policy's command unless the search finds a much better sequence.

    A proposal holds the policy's command for some steps, and goes on straight to the goal or as the last plan.

    Attributes:
        policy: The policy, which must give velocities in m/s.
        patience: The best proposal is driven unless the best sequence costs so much less [s].
    """

    policy: Planner
    patience: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.privileged = self.policy.privileged or self.privileged
        self.facts = {**self.facts, **self.policy.facts}

    def for_held_out_scene(self, scene: str) -> HybridPlanner:
        """See `Planner`."""
        return dataclasses.replace(super().for_held_out_scene(scene), policy=self.policy.for_held_out_scene(scene))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """See `Planner`."""
        self.policy.reset(rows)
        super().reset(rows)

    def first_guesses(self, obs: Observation) -> Sequences:
        """Return the guesses of MPPI, and then the proposals."""
        vehicle, guesses = obs.vehicle, super().first_guesses(obs)
        command = vehicle.dynamics.follow(vehicle.state, self.policy.plan(obs), vehicle.preferred_speed, obs.dt)
        rest = guesses[:, None, :2]  # the last plan, and straight to the goal
        held = np.arange(self.horizon) < np.array(HOLDS)[:, None]
        proposals = np.where(held[:, None, :, None], command[:, None, None, None], rest)
        return np.concatenate([guesses, proposals.reshape(len(obs), -1, self.horizon, 2)], axis=1)

    def optimize(
        self,
        scene: Scene,
        halo: RadiusInflation,
        hidden: Scene | None,
        guesses: Sequences,
        noise: Float[np.ndarray, "world round sample time 2"],
    ) -> tuple[Sequence, Float[np.ndarray, "world candidate time 3"]]:
        """See `MPPIPlanner`."""
        best, paths = super().optimize(scene, halo, hidden, guesses, noise)
        compared = np.concatenate([guesses[:, -2 * len(HOLDS) :], best[:, None]], axis=1)
        cost, _ = self.costs(scene, compared, halo, hidden)
        cost[:, -1] += self.patience
        return compared[np.arange(len(best)), cost.argmin(axis=1)], paths


def planner(
    weights: str = "ppo_attention",
    patience: float = 1.0,
    predictor: str = "constant_velocity",
    search: MPPISearch = FEWER,
    costs: MPPIWeights = MPPIPlanner.weights,
    horizon: int = 18,
) -> HybridPlanner:
    """Make the planner.

    Args:
        weights: The trained policy: a name (`crowdbench list weights`) or a file.
        patience: The policy drives unless the best sequence costs so much less [s].
        predictor: The predictor of pedestrians: a name (`crowdbench list predictors`) or a file.
        search: How sequences are sampled.
        costs: The costs of sequences.
        horizon: Number of steps of a sequence [1].

    Returns:
        The planner.
    """
    policy = load_policy(weights, predictor=predictor)
    return HybridPlanner(load_predictor(predictor), search, costs, horizon, policy=policy, patience=patience)
