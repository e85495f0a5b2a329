"""The last plan of each world, whose remaining steps are the start of the next decision."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from crowdbench.core.types import Observation
from crowdbench.planners.scene import Sequence, Sequences
from crowdbench.utils.errors import require


class LastPlans:
    """The last plan of each world of a batch.

    Args:
        horizon: Number of steps of a plan.
    """

    def __init__(self, horizon: int) -> None:
        self.horizon = horizon
        self.reset(np.arange(0))

    def reset(self, rows: Int[np.ndarray, "world"]) -> None:
        """Delete all plans. See `Planner.reset`."""
        self.plan = np.zeros((len(rows), self.horizon, 2))
        self.step = np.full(len(rows), -1)
        """The step in which each plan was computed; -1 if there is none."""

    def check_length(self, steps: int) -> None:
        """Raise InputError unless a plan has commands for the steps of `Planner.plan_ahead`."""
        right = f"{steps} or more, the steps that are asked for at once"
        require("horizon", self.horizon, steps <= self.horizon, right)

    def guesses(self, obs: Observation, default: Sequence) -> Sequences:
        """Return first guesses: the remaining steps of the last plan, and each command of the dynamics, held constant.

        Args:
            obs: The present observation.
            default: Replaces the last plan in worlds without one.
        """
        vehicle = obs.vehicle
        constant = vehicle.dynamics.commands(vehicle.state, vehicle.preferred_speed, self.horizon * obs.dt)
        remaining = self.remaining(obs, default)[:, None]
        return np.concatenate([remaining, constant[:, :, None].repeat(self.horizon, axis=2)], axis=1)

    def remaining(self, obs: Observation, default: Sequence) -> Sequence:
        """Return the remaining steps of the last plans, whose last command is repeated; see `guesses`."""
        planned = self.step[obs.row]
        ahead = np.minimum(np.arange(self.horizon) + (obs.step - planned)[:, None], self.horizon - 1)
        remaining = np.take_along_axis(self.plan[obs.row], ahead[..., None], axis=1)
        return np.where((planned < 0)[:, None, None], default, remaining)

    def store(self, obs: Observation, plan: Sequence) -> None:
        """Store new plans."""
        self.plan[obs.row], self.step[obs.row] = plan, obs.step
