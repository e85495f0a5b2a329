"""The experience of a policy: the segments of many worlds between two updates."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Bool, Float, Int
from torch import Tensor

from crowdbench.networks.policy import Memory, Seen


class Experience(NamedTuple):
    """Steps that the policy learns from: the segment of every world, in order of time.

    Attributes:
        seen: The observations.
        state: Numbers that the value depends on in addition, see `critic` in `crowdbench.train.ppo.Parameters`.
        memory: The policy's memory before the first of the steps.
        begins: True for steps that were the first of an episode.
        action: The actions, in m/s.
        log_probability: The logarithms of their probability densities at the time of the action.
        advantage: The advantages, normalized to mean 0 and standard deviation 1.
        target: The targets of the value.
        acts: False for steps of a vehicle whose episode has ended, which teach nothing.
    """

    seen: Seen
    state: Float[Tensor, "*step features"]
    memory: Memory
    begins: Bool[Tensor, "time world"]
    action: Float[Tensor, "*step 2"]
    log_probability: Float[Tensor, "*step"]
    advantage: Float[Tensor, "*step"]
    target: Float[Tensor, "*step"]
    acts: Bool[Tensor, "*step"]

    def take(self, worlds: Int[Tensor, "world"]) -> Experience:
        """Return the segments of the given worlds, all steps on one axis, without empty rows of pedestrians."""
        tensors = (*self.seen, self.state, self.action, self.log_probability, self.advantage, self.target, self.acts)
        vehicle, pedestrians, mask, state, *others = (tensor[:, worlds].flatten(0, 1) for tensor in tensors)
        width = max(int(mask.sum(dim=1).max()), 1)
        seen = Seen(vehicle, pedestrians[:, :width], mask[:, :width])
        return Experience(seen, state, self.memory[worlds], self.begins[:, worlds], *others)
