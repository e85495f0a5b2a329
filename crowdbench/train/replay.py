"""What a value network learns from: the steps of episodes, as joint states."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.reward import discount, episode_rewards
from crowdbench.types import Outcome, Trace
from crowdbench.value.joint_state import joint_states


@dataclass(frozen=True)
class Steps:
    """Steps from one state to the next, in float32.

    `value` is the discounted return to the episode's end; it says nothing of episodes that ran out of time.
    `factor` is what the next state's value counts for: 0 after the last step of an episode, but not after a
    time-out, which ends the watching, not the way.
    """

    joint: Float32[np.ndarray, "step pedestrian 13"]
    next_joint: Float32[np.ndarray, "step pedestrian 13"]
    present: Bool[np.ndarray, "step pedestrian"]
    reward: Float32[np.ndarray, "step"]
    factor: Float32[np.ndarray, "step"]
    value: Float32[np.ndarray, "step"]

    def __len__(self) -> int:
        return len(self.reward)

    def take(self, rows: Int[np.ndarray, "row"] | slice) -> Steps:
        """The given steps."""
        return Steps(*(getattr(self, field.name)[rows] for field in dataclasses.fields(self)))


def steps_of(trace: Trace, *, timeouts: bool = True) -> Steps:
    """All steps of a trace's episodes, those that ran out of time only if `timeouts`."""
    taken = np.arange(trace.gap.shape[1]) < trace.steps[:, None]
    if not timeouts:
        taken &= (trace.outcome != Outcome.TIMEOUT)[:, None]
    reward = np.where(taken, episode_rewards(trace), 0.0)
    factor = discount(trace.preferred_speed[:, :1], trace.rules.dt)
    last = np.arange(trace.gap.shape[1]) == trace.steps[:, None] - 1
    ends = last & (trace.outcome != Outcome.TIMEOUT)[:, None]
    states = (len(trace), trace.position.shape[1])
    joint = joint_states(
        np.nan_to_num(trace.position),
        np.nan_to_num(trace.velocity),
        np.broadcast_to(trace.radius[:, None], (*states, trace.radius.shape[1])),
        np.broadcast_to(trace.present[:, None], (*states, trace.present.shape[1])),
        np.broadcast_to(trace.goal[:, None, 0], (*states, 2)),
        np.broadcast_to(trace.preferred_speed[:, :1], states),
    )
    present = np.zeros(joint.shape[:3], bool)
    present[..., : trace.present.shape[1] - 1] = trace.present[:, None, 1:]
    return Steps(
        joint=joint[:, :-1][taken],
        next_joint=joint[:, 1:][taken],
        present=present[:, :-1][taken],
        reward=reward[taken].astype(np.float32),
        factor=np.where(ends, 0.0, factor)[taken].astype(np.float32),
        value=_returns(reward, factor[:, 0])[taken].astype(np.float32),
    )


def _returns(reward: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """The discounted sum of each step's reward and all later ones of its episode."""
    returns = reward.copy()
    for t in range(reward.shape[1] - 2, -1, -1):
        returns[:, t] += factor * returns[:, t + 1]
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
