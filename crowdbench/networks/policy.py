"""Policies: networks that map what a vehicle sees, in the frame of its goal, to a velocity."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.networks.features import PEDESTRIAN_FEATURES, VEHICLE_FEATURES, Features

SCALE = 3.0
"""Distances in metres are divided by this before they enter the network, so that its inputs are of the order of 1."""

LOG_STD = -0.5
"""Logarithm of the standard deviation of actions at the start of a training, in m/s."""


class Seen(NamedTuple):
    """What a policy is shown, as its network takes it. See `crowdbench.networks.features`.

    Attributes:
        vehicle: About the vehicle, in metres and m/s.
        pedestrians: About the nearest pedestrians, likewise; 0 where there are fewer.
        mask: Which of them there are.
    """

    vehicle: Float[Tensor, "*batch features"]
    pedestrians: Float[Tensor, "*batch nearest others"]
    mask: Bool[Tensor, "*batch nearest"]

    @classmethod
    def of(cls, shown: Features, device: str | torch.device = "cpu") -> Seen:
        """Features, in the numbers of the network, on a device."""
        numbers = shown.vehicle.astype(np.float32), shown.pedestrians.astype(np.float32), shown.seen
        return cls(*(torch.from_numpy(each).to(device) for each in numbers))

    def each(self, change: Callable[[Tensor], Tensor]) -> Seen:
        """The same with every tensor changed by a function."""
        return Seen(*map(change, self))


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

    def forward(self, seen: Seen) -> Float[Tensor, "world encoded"]:
        """The code of what is seen in each world, without units."""
        vehicle, pedestrians, mask = seen
        vehicle = vehicle / vehicle.new_tensor([SCALE, 1.0, 1.0, 1.0, 1.0])
        pedestrians = pedestrians / pedestrians.new_tensor([SCALE, SCALE, 1.0, 1.0, 1.0, 1.0, SCALE, 1.0])
        own = vehicle[:, None].expand(-1, pedestrians.shape[1], -1)
        each = self.each(torch.cat([own, pedestrians], dim=2)) * mask[..., None]
        score = self.attention(each)[..., 0].masked_fill(~mask, -torch.inf)
        # Without any pedestrian there is nothing to weight, and softmax would be undefined.
        weight = torch.softmax(score.masked_fill(~mask.any(dim=1, keepdim=True), 0.0), dim=1)
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

    def forward(self, seen: Seen) -> Float[Tensor, "world 2"]:
        """The velocity in the frame of the goal, in m/s; it may be faster than the vehicle, and is limited then."""
        return self.action(self.hidden(self.encoder(seen)))


class ActorCritic(nn.Module):
    """A policy in training, and the value of what it sees. They share the encoder.

    Attributes:
        policy: The policy. Its actions are the means of those that are tried.
        value: From the code of what is seen to the expected discounted sum of rewards.
        log_std: The logarithm of the standard deviation of the actions that are tried, in m/s.

    Args:
        hidden: Numbers in the hidden layer of the value.
    """

    def __init__(self, hidden: int = 64) -> None:
        super().__init__()
        self.policy = Policy(hidden=hidden)
        self.value = nn.Sequential(nn.Linear(self.policy.encoder.encoded, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.log_std = nn.Parameter(torch.full((2,), LOG_STD))
        # The first actions are small, so that what is tried at first is noise in all directions.
        gains = {self.policy.action: 0.01, self.value[2]: 1.0}
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, gains.get(layer, math.sqrt(2.0)))
                nn.init.zeros_(layer.bias)

    def forward(self, seen: Seen) -> tuple[Float[Tensor, "row 2"], Float[Tensor, "row"]]:
        """The mean of the actions in m/s, and the value, in each row of what is seen."""
        code = self.policy.encoder(seen)
        return self.policy.action(self.policy.hidden(code)), self.value(code)[:, 0]

    def log_probability(self, action: Float[Tensor, "row 2"], mean: Float[Tensor, "row 2"]) -> Float[Tensor, "row"]:
        """The logarithm of the probability density with which actions of these means are tried.

        Args:
            action: The actions in m/s.
            mean: Their means.
        """
        deviation = (action - mean) / self.log_std.exp()
        return (-0.5 * deviation**2 - self.log_std - 0.5 * math.log(2.0 * math.pi)).sum(dim=1)
