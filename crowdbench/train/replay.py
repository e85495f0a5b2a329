"""What a value network learns from: the steps of episodes, as joint states."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.reward import discount, episode_rewards
from crowdbench.types import Outcome, Trace
from crowdbench.value.joint_state import joint_states


@dataclass(frozen=True)
class Steps:
    """States of episodes, each with what came of it some steps later, in float32.

    `reward` is the discounted sum of the rewards until then, `later` the state reached, and `factor` what the value of
    that state counts for: 0 where the episode ended before, but not by a time-out, which ends the watching, not the
    way. `value` is the discounted return to the episode's end; it says nothing of episodes that ran out of time.
    """

    joint: Float32[np.ndarray, "step pedestrian 13"]
    later: Float32[np.ndarray, "step pedestrian 13"]
    present: Bool[np.ndarray, "step pedestrian"]
    reward: Float32[np.ndarray, "step"]
    factor: Float32[np.ndarray, "step"]
    value: Float32[np.ndarray, "step"]

    def __len__(self) -> int:
        return len(self.reward)

    def take(self, rows: Int[np.ndarray, "row"] | slice) -> Steps:
        """The given steps."""
        return Steps(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


def steps_of(trace: Trace, ahead: int, *, timeouts: bool = True) -> Steps:
    """All states of a trace's episodes but the last ones, each with what came of it `ahead` steps later.

    The states of episodes that ran out of time are left out unless `timeouts`.
    """
    length = trace.gap.shape[1]
    taken = np.arange(length) < trace.steps[:, None]
    reward = np.where(taken, episode_rewards(trace), 0.0)
    factor = discount(trace.preferred_speed[:, 0], trace.rules.dt)
    # The state that is looked at later: that many steps on, or the episode's last.
    then = np.minimum(np.arange(length) + ahead, trace.steps[:, None])
    over = (then == trace.steps[:, None]) & (trace.outcome != Outcome.TIMEOUT)[:, None]
    joint, present = _states(trace)
    world, time = np.nonzero(taken & (timeouts | (trace.outcome != Outcome.TIMEOUT))[:, None])
    return Steps(
        joint=joint[world, time],
        later=joint[world, then[world, time]],
        present=present[world],
        reward=_returns(reward, factor, ahead)[world, time].astype(np.float32),
        factor=np.where(over, 0.0, factor[:, None] ** (then - np.arange(length)))[world, time].astype(np.float32),
        value=_returns(reward, factor, length)[world, time].astype(np.float32),
    )


def _states(
    trace: Trace,
) -> tuple[Float32[np.ndarray, "world time pedestrian 13"], Bool[np.ndarray, "world pedestrian"]]:
    """The joint states of a trace, and who is present in them."""
    worlds, times, agents = trace.position.shape[:3]
    joint = joint_states(
        np.nan_to_num(trace.position),
        np.nan_to_num(trace.velocity),
        trace.radius,
        trace.present,
        trace.goal[:, :, 0],
        np.broadcast_to(trace.preferred_speed[:, :1], (worlds, times)),
    )
    present = np.zeros((worlds, joint.shape[2]), bool)
    present[:, : agents - 1] = trace.present[:, 0, 1:]
    return joint, present


def _returns(
    reward: Float[np.ndarray, "world step"], factor: Float[np.ndarray, "world"], ahead: int
) -> Float[np.ndarray, "world step"]:
    """The discounted sum of each step's reward and those of the steps after it, `ahead` in all."""
    returns = np.zeros_like(reward)
    for later in range(min(ahead, reward.shape[1])):
        returns[:, : reward.shape[1] - later] += factor[:, None] ** later * reward[:, later:]
    return returns


class Replay:
    """The latest steps, up to a number of them; the oldest make room for new ones."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.steps: Steps | None = None
        self.added = 0

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, steps: Steps) -> None:
        """Add steps, all of episodes with the same largest number of pedestrians."""
        if self.steps is None:
            self.steps = Steps(
                *(
                    np.zeros((self.capacity, *getattr(steps, field.name).shape[1:]), getattr(steps, field.name).dtype)
                    for field in dataclasses.fields(Steps)
                )
            )
        rows = (self.added + np.arange(len(steps))) % self.capacity
        for field in dataclasses.fields(Steps):
            getattr(self.steps, field.name)[rows] = getattr(steps, field.name)
        self.added += len(steps)

    def sample(self, generator: np.random.Generator, n: int) -> Steps:
        """Steps drawn with replacement."""
        assert self.steps is not None
        return self.steps.take(generator.integers(len(self), size=n))
