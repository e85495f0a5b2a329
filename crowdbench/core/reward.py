"""The reward of a step, for environments, training, lookahead and metrics.

It is the reward of CrowdNav (Chen et al. 2019, equation 3), as its code computes it. Collision and success have a
reward that does not depend on the length of a step. The reward for discomfort is per second, and so multiplied by dt.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from crowdbench.core.arrays import Numbers
from crowdbench.core.types import DISCOMFORT_GAP, Outcome, Trace
from crowdbench.utils.compiled import njit

SUCCESS = 1.0
"""Reward for reaching the goal."""

COLLISION = -0.25
"""Reward for a collision with a pedestrian."""

WALL_COLLISION = -0.25
"""Reward for a collision with an obstacle: the same as with a pedestrian. CrowdNav has no obstacles."""

DISCOMFORT = 0.5
"""Reward, times -1, per second and per metre by which the gap to a pedestrian is below 0.2 m."""

DISCOUNT = 0.9
"""Discount per metre at preferred speed: a step has the factor `DISCOUNT ** (dt * preferred_speed)`."""

# Plain numbers, because reading a member of an enum takes as long as the rest of the computation.
_RUNNING = int(Outcome.RUNNING)
_FINAL = np.zeros(len(Outcome))
_FINAL[[Outcome.SUCCESS, Outcome.COLLISION, Outcome.WALL_COLLISION]] = SUCCESS, COLLISION, WALL_COLLISION


def reward(outcome: Int[np.ndarray, "*batch"], gap: Numbers, dt: float) -> Numbers:
    """Return the reward of a step (Chen et al. 2019, equation 3). A time-out has reward 0.

    Args:
        outcome: The `Outcome` after the step.
        gap: Smallest distance to a pedestrian's rim during the step, in metres.
        dt: The length of the step in seconds.
    """
    rewards = np.empty(outcome.shape)
    outcome, gap = np.ascontiguousarray(outcome).reshape(-1), np.ascontiguousarray(gap).reshape(-1)
    fill_reward(outcome, gap, dt, rewards.reshape(-1))
    return rewards


@no_type_check
@njit
def fill_reward(outcome, gap, dt, rewards):
    """Fill `rewards [step]`, see `reward`. Compiled, because for one world NumPy would take as long as a step."""
    for i in range(len(rewards)):
        if outcome[i] == _RUNNING:
            rewards[i] = min(gap[i] - DISCOMFORT_GAP, 0.0) * DISCOMFORT * dt
        else:
            rewards[i] = _FINAL[outcome[i]]


def episode_rewards(trace: Trace) -> Float[np.ndarray, "world step"]:
    """Return the reward of every step of a trace, NaN after its last."""
    steps = np.arange(trace.gap.shape[1])
    outcome = np.where(steps == trace.steps[:, None] - 1, trace.outcome[:, None], _RUNNING)
    return np.where(steps < trace.steps[:, None], reward(outcome, trace.gap, trace.rules.dt), np.nan)


def discount(preferred_speed: Numbers, dt: float) -> Numbers:
    """Return the discount factor for a reward that is one step later.

    Args:
        preferred_speed: The vehicle's preferred speed in m/s.
        dt: The length of a step in seconds.
    """
    return DISCOUNT ** (dt * preferred_speed)
