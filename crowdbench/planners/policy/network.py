"""The network of a policy: a set encoder of the pedestrians, then an action in the frame of the goal."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.planners.policy.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES

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

    def forward(
        self,
        vehicle: Float[Tensor, "world features"],
        pedestrians: Float[Tensor, "world nearest others"],
        seen: Bool[Tensor, "world nearest"],
    ) -> Float[Tensor, "world encoded"]:
        """Encode what `crowdbench.planners.policy.features` gives.

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

    def forward(
        self,
        vehicle: Float[Tensor, "world features"],
        pedestrians: Float[Tensor, "world nearest others"],
        seen: Bool[Tensor, "world nearest"],
    ) -> Float[Tensor, "world 2"]:
        """The velocity in the frame of the goal, in m/s; it may be faster than the vehicle, and is limited then.

        Args:
            vehicle: As `SetEncoder` takes it, and so are the next two.
            pedestrians: About the nearest pedestrians.
            seen: Which of them there are.
        """
        return self.action(self.hidden(self.encoder(vehicle, pedestrians, seen)))
