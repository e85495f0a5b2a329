"""Policies: networks that map a vehicle's observation, in the frame of its goal, to a velocity."""

from __future__ import annotations

import abc
import math
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from crowdbench.networks.features import Features

SCALE = 3.0
"""Distances in metres are divided by this before they enter the network, so that its inputs are of the order of 1."""

LOG_STD = -0.5
"""Logarithm of the standard deviation of actions at the start of a training, in m/s."""


Memory = Float[Tensor, "world remembered"]
"""Memory of a policy of the current episode in each world, without units."""


class Seen(NamedTuple):
    """Input of the network of a policy. See `crowdbench.networks.features`.

    Attributes:
        vehicle: About the vehicle, in metres and m/s.
        pedestrians: About the nearest pedestrians, in metres and m/s; 0 in empty rows.
        mask: True for rows with a pedestrian, False for empty rows.
    """

    vehicle: Float[Tensor, "*batch features"]
    pedestrians: Float[Tensor, "*batch nearest others"]
    mask: Bool[Tensor, "*batch nearest"]

    @classmethod
    def of(cls, shown: Features, device: str | torch.device = "cpu") -> Seen:
        """Return features as tensors of a network, on a device."""
        numbers = shown.vehicle.astype(np.float32), shown.pedestrians.astype(np.float32), shown.seen
        return cls(*(torch.from_numpy(array).to(device) for array in numbers))


class Encoder(nn.Module, abc.ABC):
    """Encoder of observations.

    Attributes:
        encoded: Size of the output.
    """

    encoded: int

    @abc.abstractmethod
    def forward(self, seen: Seen) -> Float[Tensor, "row encoded"]:
        """Return the code of the observation in each row, without units."""


class Policy(nn.Module):
    """A trained policy for a planner: the mean action.

    Attributes:
        encoder: Encoder of the observation.
        memory: A gated recurrent unit (Cho et al. 2014) after the encoder; None in a policy without a memory.
        hidden: Layers between the code and the action.
        action: The last layer: a velocity in the frame of the goal in m/s, see `NetworkPlanner`.

    Args:
        remembered: Size of the memory from step to step; 0 for none.
        hidden: Numbers in the hidden layer.
    """

    def __init__(self, encoder: Encoder, remembered: int = 0, hidden: int = 64) -> None:
        super().__init__()
        self.encoder = encoder
        self.remembered: int = remembered
        self.coded: int = remembered or self.encoder.encoded
        self.memory = nn.GRUCell(self.encoder.encoded, remembered) if remembered else None
        self.hidden = nn.Sequential(nn.Linear(self.coded, hidden), nn.Tanh())
        self.action = nn.Linear(hidden, 2)

    def forward(self, seen: Seen, memory: Memory) -> tuple[Float[Tensor, "world 2"], Memory]:
        """Return the action in each world, and the memory after it."""
        code, memory = self.code(seen, memory, seen.mask.new_zeros(1, len(seen.mask)))
        return self.action(self.hidden(code)), memory

    def code(
        self, seen: Seen, memory: Memory, begins: Bool[Tensor, "time world"]
    ) -> tuple[Float[Tensor, "row code"], Memory]:
        """Return codes at some steps of some worlds, in their order.

        Args:
            seen: Input at each step in each world, on one axis.
            memory: The memory before the first step.
            begins: True if a step is the first of an episode, before which the memory is empty.

        Returns:
            The code of each row, and the memory after the last step.
        """
        code = self.encoder(seen)
        if self.memory is None:
            return code, memory
        codes = []
        for now, begin in zip(code.unflatten(0, begins.shape), begins, strict=True):
            memory = self.memory(now, memory.masked_fill(begin[:, None], 0.0))
            codes.append(memory)
        return torch.cat(codes), memory

    def initial_memory(self, worlds: int) -> Memory:
        """Return the memory at the start of episodes."""
        return self.action.weight.new_zeros(worlds, self.remembered)


class ActorCritic(nn.Module):
    """A policy in training, and its value function. They share the encoder and the memory.

    Attributes:
        policy: The policy. Its actions are the means of the sampled actions.
        value: Layers from the code and the state to the expected discounted sum of rewards.
        log_std: The logarithm of the standard deviation of the sampled actions, in m/s.

    Args:
        state: Numbers that the value depends on in addition to the code.
        hidden: Numbers in the hidden layer of the value.
    """

    def __init__(self, policy: Policy, state: int = 0, hidden: int = 64) -> None:
        super().__init__()
        self.policy = policy
        self.value = nn.Sequential(nn.Linear(policy.coded + state, hidden), nn.Tanh(), nn.Linear(hidden, 1))
        self.log_std = nn.Parameter(torch.full((2,), LOG_STD))
        # The first mean actions are small, so that the first sampled actions are noise in all directions.
        gains = {self.policy.action: 0.01, self.value[2]: 1.0}
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, gains.get(layer, math.sqrt(2.0)))
                nn.init.zeros_(layer.bias)

    def forward(
        self, seen: Seen, state: Float[Tensor, "row features"], memory: Memory, begins: Bool[Tensor, "time world"]
    ) -> tuple[Float[Tensor, "row 2"], Float[Tensor, "row"], Memory]:
        """Return the mean action and the value in each row of observations, and the memory; see `Policy.code`."""
        code, memory = self.policy.code(seen, memory, begins)
        return self.policy.action(self.policy.hidden(code)), self.value(torch.cat([code, state], dim=1))[:, 0], memory

    def log_probability(self, action: Float[Tensor, "row 2"], mean: Float[Tensor, "row 2"]) -> Float[Tensor, "row"]:
        """Return the logarithm of the probability density of sampled actions with the given means.

        Args:
            action: The actions in m/s.
        """
        deviation = (action - mean) / self.log_std.exp()
        return (-0.5 * deviation**2 - self.log_std - 0.5 * math.log(2.0 * math.pi)).sum(dim=1)
