"""The experience of a value network: n-step transitions between joint states, and their replay buffer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from torch import Tensor

from crowdbench.core.reward import discount, episode_rewards
from crowdbench.core.types import Outcome, Trace
from crowdbench.networks.joint_state import joint_states
from crowdbench.sim.routes import goals_in_trace

Rewards = Float[np.ndarray, "world step"]


@dataclass(frozen=True)
class Transitions:
    """States of episodes, each with the rewards of the next n steps and the state after them.

    An episode that ends in fewer than n steps gives fewer rewards and its last state. gamma is the discount of a step.

    Attributes:
        joint: The joint states.
        next_joint: The joint states k steps later, where k is n or the number of steps to the end of the episode.
        present: Which pedestrians are present.
        next_present: Which pedestrians are present k steps later.
        reward: The discounted sum of the k rewards in between.
        bootstrap: The factor of the next state's value in the target: gamma^k, or 0 if the episode terminated within
            the k steps. A time-out only truncates an episode, so that the next state keeps its value and the factor is
            gamma^k (Pardo et al. 2018).
        episode_return: The discounted sum of all rewards to the end of the episode. For a truncated episode it lacks
            the rewards after the truncation.
    """

    joint: Float32[np.ndarray, "step pedestrian 13"]
    next_joint: Float32[np.ndarray, "step pedestrian 13"]
    present: Bool[np.ndarray, "step pedestrian"]
    next_present: Bool[np.ndarray, "step pedestrian"]
    reward: Float32[np.ndarray, "step"]
    bootstrap: Float32[np.ndarray, "step"]
    episode_return: Float32[np.ndarray, "step"]

    def __len__(self) -> int:
        return len(self.reward)

    def take(self, rows: Int[np.ndarray, "row"] | slice) -> Transitions:
        """Return the transitions of the given rows."""
        return Transitions(*(array[rows] for array in vars(self).values()))


def transitions(trace: Trace, n: int, *, truncated: bool = True) -> Transitions:
    """Return the n-step transitions of all episodes of a trace, from every state but the last.

    Args:
        trace: The episodes.
        n: The number of steps of a transition.
        truncated: True to include episodes that ended in a time-out.

    Returns:
        The transitions, episode by episode.
    """
    length = trace.gap.shape[1]
    in_episode = np.arange(length) < trace.steps[:, None]
    reward = np.where(in_episode, episode_rewards(trace), 0.0)
    gamma = discount(trace.preferred_speed[:, 0], trace.rules.dt)
    timed_out = trace.outcome == Outcome.TIMEOUT
    later = np.minimum(np.arange(length) + n, trace.steps[:, None])
    terminated = (later == trace.steps[:, None]) & ~timed_out[:, None]
    pedestrians = trace.present[:, :, 1:]
    joint = joint_states(
        np.nan_to_num(trace.position),
        np.nan_to_num(trace.velocity),
        trace.radius,
        trace.present,
        goals_in_trace(trace),
        np.broadcast_to(trace.preferred_speed[:, :1], trace.position.shape[:2]),
    )
    present = np.zeros(joint.shape[:3], bool)
    present[:, :, : pedestrians.shape[2]] = pedestrians
    bootstrap = np.where(terminated, 0.0, gamma[:, None] ** (later - np.arange(length)))
    world, time = np.nonzero(in_episode & (truncated | ~timed_out)[:, None])
    return Transitions(
        joint=joint[world, time],
        next_joint=joint[world, later[world, time]],
        present=present[world, time],
        next_present=present[world, later[world, time]],
        reward=_returns(reward, gamma, n)[world, time].astype(np.float32),
        bootstrap=bootstrap[world, time].astype(np.float32),
        episode_return=_returns(reward, gamma, length)[world, time].astype(np.float32),
    )


def _returns(reward: Rewards, gamma: Float[np.ndarray, "world"], n: int) -> Rewards:
    """Return the discounted sums of n rewards from every step on.

    They are the n-step returns of Sutton and Barto (2018, equation 7.1) without the last term, the value after n steps.
    Rewards are 0 after an episode's last step.
    """
    returns = np.zeros_like(reward)
    for later in range(min(n, reward.shape[1])):
        returns[:, : reward.shape[1] - later] += gamma[:, None] ** later * reward[:, later:]
    return returns


class ReplayBuffer:
    """The latest transitions, up to a capacity: new ones overwrite the oldest."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.transitions: Transitions | None = None
        self.added = 0

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, new: Transitions) -> None:
        """Add transitions, always with the same size of the pedestrian axis."""
        if self.transitions is None:
            empty = (np.zeros((self.capacity, *array.shape[1:]), array.dtype) for array in vars(new).values())
            self.transitions = Transitions(*empty)
        rows = (self.added + np.arange(len(new))) % self.capacity
        for name, array in vars(new).items():
            getattr(self.transitions, name)[rows] = array
        self.added += len(new)

    def state_dict(self) -> dict[str, Tensor]:
        """Return the transitions and the number that was added, by name."""
        latest = {} if self.transitions is None else vars(self.transitions.take(slice(0, len(self))))
        arrays = {name: torch.from_numpy(array) for name, array in latest.items()}
        return {"added": torch.tensor(self.added), **arrays}

    def load_state_dict(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state_dict` returned, in an empty buffer."""
        arrays = {name: tensor.numpy() for name, tensor in state.items()}
        added = int(arrays.pop("added"))
        if arrays:
            self.add(Transitions(**arrays))
        self.added = added

    def sample(self, generator: np.random.Generator, n: int) -> Transitions:
        """Draw transitions uniformly, with replacement.

        Args:
            generator: The source of random numbers.
            n: The number of transitions.

        Returns:
            The transitions.
        """
        assert self.transitions is not None
        return self.transitions.take(generator.integers(len(self), size=n))
