"""Policies, which look no step ahead: a network maps what the vehicle sees to a velocity, and a planner asks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.core.types import Observation
from crowdbench.networks.weights import digest, load_into, read_card, weights_file
from crowdbench.planners.base import Planner
from crowdbench.planners.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES, features, in_disc, to_world
from crowdbench.planners.reactive import along_walls
from crowdbench.utils.errors import InputError, is_integer
from crowdbench.utils.threads import in_chunks

VehicleRows = Float[Tensor, "world features"]
PedestrianRows = Float[Tensor, "world nearest others"]
Seen = Bool[Tensor, "world nearest"]

NAME = "ppo"
"""The name of the network on cards."""

SCALE = 3.0
"""Distances in metres are divided by this before they enter the network, so that its inputs are of the order of 1."""


class SetEncoder(nn.Module):
    """Encodes the vehicle and any number of pedestrians, whose order does not matter.

    Each pedestrian is encoded together with the vehicle. What goes on is a sum over pedestrians, weighted by attention,
    and the largest value of each number: the sum says what the crowd is like, the maximum who is most urgent.

    Args:
        width: Numbers per pedestrian inside the network.
        encoded: Numbers that come out.
    """

    def __init__(self, width: int = 64, encoded: int = 128) -> None:
        super().__init__()
        self.encoded = encoded
        self.each = nn.Sequential(
            nn.Linear(VEHICLE_FEATURES + PEDESTRIAN_FEATURES, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU()
        )
        self.attention = nn.Linear(width, 1)
        self.joined = nn.Sequential(nn.Linear(VEHICLE_FEATURES + 2 * width, encoded), nn.ReLU())

    def forward(self, vehicle: VehicleRows, pedestrians: PedestrianRows, seen: Seen) -> Float[Tensor, "world encoded"]:
        """Encode what `crowdbench.planners.features` gives.

        Args:
            vehicle: About the vehicle, in metres and m/s.
            pedestrians: About the nearest pedestrians, likewise; 0 where there are fewer.
            seen: Which of them there are.

        Returns:
            The code, without units.
        """
        vehicle = vehicle / vehicle.new_tensor([SCALE, 1.0, 1.0, 1.0, 1.0])
        pedestrians = pedestrians / pedestrians.new_tensor([SCALE, SCALE, 1.0, 1.0, 1.0, 1.0, SCALE, 1.0])
        own = vehicle[:, None].expand(-1, pedestrians.shape[1], -1)
        each = self.each(torch.cat([own, pedestrians], dim=2)) * seen[..., None]
        score = self.attention(each)[..., 0].masked_fill(~seen, -torch.inf)
        # Without any pedestrian there is nothing to weight, and softmax would be undefined.
        weight = torch.softmax(score.masked_fill(~seen.any(dim=1, keepdim=True), 0.0), dim=1)
        crowd = (weight[..., None] * each).sum(dim=1)
        # ReLU makes what is encoded 0 or more, so that 0 for those who are not seen is never a maximum of others.
        return self.joined(torch.cat([vehicle, crowd, each.amax(dim=1)], dim=1))


class Policy(nn.Module):
    """What a planner needs of a trained policy: the mean action.

    Attributes:
        encoder: Encodes what the vehicle sees.
        hidden: Layers between the code and the action.
        action: The last layer: a velocity in the frame of the goal, in m/s.
    """

    def __init__(self, width: int = 64, encoded: int = 128, hidden: int = 64) -> None:
        super().__init__()
        self.encoder = SetEncoder(width, encoded)
        self.hidden = nn.Sequential(nn.Linear(encoded, hidden), nn.Tanh())
        self.action = nn.Linear(hidden, 2)

    def forward(self, vehicle: VehicleRows, pedestrians: PedestrianRows, seen: Seen) -> Float[Tensor, "world 2"]:
        """The velocity in the frame of the goal, in m/s; it may be faster than the vehicle, and is limited then.

        Args:
            vehicle: As `SetEncoder` takes it, and so are the next two.
            pedestrians: About the nearest pedestrians.
            seen: Which of them there are.
        """
        return self.action(self.hidden(self.encoder(vehicle, pedestrians, seen)))


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
        view = features(obs, self.nearest)
        inputs = view.vehicle.astype(np.float32), view.pedestrians.astype(np.float32), view.seen
        action = np.empty((len(obs), 2))
        device = next(self.policy.parameters()).device

        def fill(part: slice) -> None:
            with torch.inference_mode():
                some = (torch.from_numpy(each[part]).to(device) for each in inputs)
                action[part] = self.policy(*some).double().cpu().numpy()

        in_chunks(fill, len(obs), CHUNK)
        # The direction is kept. (In training, the bounds of the action space limit each axis first.)
        command = to_world(in_disc(action, obs.vehicle.preferred_speed), view.axis)
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
