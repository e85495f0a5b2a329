"""A planner that asks a policy network for its command."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from crowdbench.planners.base import Planner
from crowdbench.planners.policy.features import features, in_disc, to_world
from crowdbench.planners.policy.network import NAME, Policy
from crowdbench.threads import in_chunks
from crowdbench.types import Observation
from crowdbench.weights.store import digest

CHUNK = 4096
"""Worlds that go through the network at once."""


class PolicyPlanner(Planner):
    """Drives with the mean action of a policy: no lookahead, no prediction, no randomness.

    Args:
        policy: The trained network.
        nearest: How many pedestrians it is shown, at most: the nearest ones.
    """

    def __init__(self, policy: Policy, nearest: int) -> None:
        self.policy = policy.eval()
        self.nearest = nearest
        self.facts = {"network": NAME, "weights": digest(policy)}

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        shown = features(obs, self.nearest)
        action = np.empty((len(obs), 2))

        def fill(part: slice) -> None:
            action[part] = self._actions(shown.vehicle[part], shown.pedestrians[part], shown.seen[part])

        in_chunks(fill, len(obs), CHUNK)
        return to_world(in_disc(action), shown.axis) * obs.vehicle.preferred_speed[:, None]

    @torch.inference_mode()
    def _actions(
        self,
        vehicle: Float[np.ndarray, "world features"],
        pedestrians: Float[np.ndarray, "world nearest others"],
        seen: np.ndarray,
    ) -> np.ndarray:
        single = torch.float32
        tensors = torch.from_numpy(vehicle).to(single), torch.from_numpy(pedestrians).to(single), torch.from_numpy(seen)
        return self.policy(*tensors).double().numpy()
