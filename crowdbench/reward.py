"""The reward of a step: the only place that knows it.

CrowdNav's (Chen et al. 2019, equation 3), as its code computes it. The branches differ in unit:
collision and success are paid once, whatever the step; discomfort is a rate, paid per second, and so
multiplied by dt.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from crowdbench.types import DISCOMFORT_GAP, Outcome, Trace

SUCCESS = 1.0
"""Paid once, on arrival."""

COLLISION = -0.25
"""Paid once, on touching a pedestrian."""

WALL_COLLISION = -0.25
"""Paid once, on touching an obstacle. Not in CrowdNav, which has none: as much as for a pedestrian."""

DISCOMFORT = 0.5
"""Per metre of gap missing to 0.2 m and per second: dt is multiplied in."""

DISCOUNT = 0.9
"""Per metre at preferred speed: a step is discounted by `DISCOUNT ** (dt * preferred_speed)`."""

# Plain numbers, because looking a member of an enum up costs as much as the rest of a reward.
_RUNNING = int(Outcome.RUNNING)
_PAID = {Outcome.SUCCESS: SUCCESS, Outcome.COLLISION: COLLISION, Outcome.WALL_COLLISION: WALL_COLLISION}
_ENDED = np.array([_PAID.get(outcome, 0.0) for outcome in sorted(Outcome)])


def reward(
    outcome: Int[np.ndarray, "*batch"], gap: Float[np.ndarray, "*batch"], dt: float
) -> Float[np.ndarray, "*batch"]:
    """The reward of a step that ended in `outcome` and came as close as `gap` metres to a pedestrian.

    A time-out pays nothing.
    """
    discomfort = np.minimum(gap - DISCOMFORT_GAP, 0.0) * DISCOMFORT * dt
    return np.where(outcome == _RUNNING, discomfort, _ENDED[outcome])


def episode_rewards(trace: Trace) -> Float[np.ndarray, "world step"]:
    """The reward of every step of a trace, NaN after its last."""
    steps = np.arange(trace.gap.shape[1])
    outcome = np.where(steps == trace.steps[:, None] - 1, trace.outcome[:, None], _RUNNING)
    return np.where(steps < trace.steps[:, None], reward(outcome, trace.gap, trace.rules.dt), np.nan)


def discount(preferred_speed: Float[np.ndarray, "*batch"], dt: float) -> Float[np.ndarray, "*batch"]:
    """The factor by which a reward is worth less one step later."""
    return DISCOUNT ** (dt * preferred_speed)
