"""Policies, which look no step ahead: a network maps what the vehicle sees to a velocity, and a planner asks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from crowdbench.core.types import Observation
from crowdbench.networks.features import features, in_disc, to_world
from crowdbench.networks.policy import Policy, Seen
from crowdbench.networks.weights import digest, load_into, read_card, weights_file
from crowdbench.planners.base import Planner
from crowdbench.planners.reactive import along_walls
from crowdbench.utils.errors import InputError, is_integer
from crowdbench.utils.threads import in_chunks

NAME = "ppo"
"""The name of the network on cards."""

CHUNK = 4096
"""Worlds that go through the network at once."""


@dataclass(eq=False)
class PolicyPlanner(Planner):
    """Drives with the mean action of a policy: no lookahead, no prediction, no randomness.

    Attributes:
        policy: The trained network.
        nearest: How many pedestrians it is shown, at most: the nearest ones.
        trained_pedestrians: The largest number of pedestrians that it was trained with; None where that is unknown.
    """

    policy: Policy
    nearest: int
    trained_pedestrians: int | None = None

    def __post_init__(self) -> None:
        self.policy.eval()
        self.facts = {"network": NAME, "weights": digest(self.policy)}

    def plan(self, obs: Observation) -> Float[np.ndarray, "world 2"]:
        """See `Planner`."""
        shown = features(obs, self.nearest)
        seen = Seen.of(shown, next(self.policy.parameters()).device)
        action = np.empty((len(obs), 2))

        def fill(part: slice) -> None:
            with torch.inference_mode():
                action[part] = self.policy(seen.each(lambda tensor: tensor[part])).double().cpu().numpy()

        in_chunks(fill, len(obs), CHUNK)
        # The direction is kept.
        command = to_world(in_disc(action, obs.vehicle.preferred_speed), shown.axis)
        # Policies have learnt in worlds without obstacles.
        return along_walls(obs, command)


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
