"""The last plan of each world, whose rest is where the next decision starts."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from crowdbench.core.types import Observation
from crowdbench.planners.scene import Sequence


class LastPlans:
    """The last plan of each world of a batch.

    Args:
        horizon: Number of steps of a plan.
    """

    def __init__(self, horizon: int) -> None:
        self.horizon = horizon
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Forget all plans. See `Planner.reset`."""
        self.plan = np.zeros((len(rows), self.horizon, 2))
        self.step = np.full(len(rows), -1)
        """The step in which each was made; -1 where there is none."""

    def rest(self, obs: Observation, otherwise: Sequence) -> Sequence:
        """What is left of the last plans, whose last command goes on.

        Args:
            obs: The present.
            otherwise: Taken in worlds without a plan.
        """
        made = self.step[obs.row]
        ahead = np.minimum(np.arange(self.horizon) + (obs.step - made)[:, None], self.horizon - 1)
        rest = np.take_along_axis(self.plan[obs.row], ahead[..., None], axis=1)
        return np.where((made < 0)[:, None, None], otherwise, rest)

    def keep(self, obs: Observation, plan: Sequence) -> None:
        """Remember new plans."""
        self.plan[obs.row], self.step[obs.row] = plan, obs.step
