"""A planner that asks a policy network for its command."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from crowdbench.core.types import Observation
from crowdbench.networks.weights import digest, load_into, read_card, weights_file
from crowdbench.planners.base import Planner
from crowdbench.planners.policy.features import features, in_disc, to_world
from crowdbench.planners.policy.network import NAME, Policy
from crowdbench.planners.reactive import along_walls
from crowdbench.utils.errors import InputError, is_integer
from crowdbench.utils.threads import in_chunks

CHUNK = 4096
"""Worlds that go through the network at once."""


class PolicyPlanner(Planner):
    """Drives with the mean action of a policy: no lookahead, no prediction, no randomness.

    Args:
        policy: The trained network.
        nearest: How many pedestrians it is shown, at most: the nearest ones.
        trained_pedestrians: The largest number of pedestrians that it was trained with; None where that is unknown.
    """

    def __init__(self, policy: Policy, nearest: int, trained_pedestrians: int | None = None) -> None:
        self.policy = policy.eval()
        self.nearest = nearest
        self.trained_pedestrians = trained_pedestrians
        self.facts = {"network": NAME, "weights": digest(policy)}

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        shown = features(obs, self.nearest)
        action = np.empty((len(obs), 2))

        def fill(part: slice) -> None:
            action[part] = self._actions(shown.vehicle[part], shown.pedestrians[part], shown.seen[part])

        in_chunks(fill, len(obs), CHUNK)
        # The direction is kept. (In training, the bounds of the action space limit each axis first.)
        command = to_world(in_disc(action, obs.vehicle.preferred_speed), shown.axis)
        # Policies have learnt in worlds without obstacles.
        return along_walls(obs, command)

    @torch.inference_mode()
    def _actions(
        self,
        vehicle: Float[np.ndarray, "world features"],
        pedestrians: Float[np.ndarray, "world nearest others"],
        seen: np.ndarray,
    ) -> np.ndarray:
        device = next(self.policy.parameters()).device
        inputs = (vehicle.astype(np.float32), pedestrians.astype(np.float32), seen)
        return self.policy(*(torch.from_numpy(each).to(device) for each in inputs)).double().cpu().numpy()


def load_policy(weights: str, device: str = "cpu") -> PolicyPlanner:
    """A planner with a trained policy.

    Args:
        weights: The name of built-in weights, or a file.
        device: `cpu` or `cuda`.

    Returns:
        The planner.

    Raises:
        InputError: The weights are missing, altered or not those of a policy.
    """
    path = weights_file(weights)
    policy = load_into(Policy(), NAME, path, device)
    training = read_card(path).get("training", {})
    nearest = training.get("nearest")
    if not is_integer(nearest) or nearest < 1:
        raise InputError(f"the card of the weights {path} does not say how many pedestrians the policy is shown")
    return PolicyPlanner(policy, int(nearest), _most_pedestrians(training))


def _most_pedestrians(training: Mapping[str, Any]) -> int | None:
    """The largest number of pedestrians that a card says of the training; None where it does not say one."""
    try:
        number = training["scenario"]["pedestrians"]["number"]
    except (KeyError, TypeError):
        return None
    most = number[-1] if isinstance(number, list) and number else number
    return most if is_integer(most) else None
