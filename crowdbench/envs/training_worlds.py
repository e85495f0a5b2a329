"""Worlds in which a policy is trained: as soon as an episode is over, its world starts another one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.core.types import Outcome, World
from crowdbench.envs import stepping
from crowdbench.envs.rewards import CheckedReward, Step
from crowdbench.sim.fleet import in_whole_worlds, is_running
from crowdbench.utils.errors import InputError
from crowdbench.views.view import View

CASES = 2048
"""Training cases that are drawn at the start. Drawing one takes as long as hundreds of steps of a world."""


class Driven(NamedTuple):
    """A step of many worlds in which a policy is trained.

    Attributes:
        step: The step.
        reward: Reward of each vehicle.
        returned: The sum of the rewards of each episode up to it.
        length: The number of steps of each episode up to it.
        acts: False for a vehicle whose episode had ended before, which waits for the other vehicles of its world.
    """

    step: Step
    reward: Float[np.ndarray, "world"]
    returned: Float[np.ndarray, "world"]
    length: Int[np.ndarray, "world"]
    acts: Bool[np.ndarray, "world"]


class TrainingWorlds:
    """Many worlds of a scenario. Each episode starts from a random one of the training cases, which are drawn once.

    With several vehicles in a world, each of them has a row, and their world starts again when all of them have ended.

    Attributes:
        worlds: The current worlds, which exist from the first `start` on.

    Args:
        number: How many rows there are: worlds, times the vehicles in each.
        view: Interpretation of the vehicles' actions, and the scenario.
        cases: How many training cases are drawn.

    Raises:
        InputError: The rows do not fill the last world.
    """

    def __init__(self, number: int, view: View, reward: CheckedReward, cases: int = CASES) -> None:
        self.worlds: World
        self._vehicles, name = view.scenario.rules.vehicles, view.scenario.name
        if number % self._vehicles:
            raise InputError(
                f"{name} has {self._vehicles} vehicles in a world, but the training drives {number} there: the number "
                f"must be a multiple of {self._vehicles}"
            )
        self._number, self._view, self._reward, self._cases = number, view, reward, cases
        self._starts: World | None = None
        self._returned, self._length = np.zeros(number), np.zeros(number, np.int64)

    def seed(self, seed: int | None) -> None:
        """Set the seed with which the next `start` draws training cases and their order; None for a random seed."""
        self._order, self._starts = np.random.default_rng(seed), None

    def start(self) -> World:
        """Start new episodes in all worlds."""
        if self._starts is None:
            numbers = self._order.choice(stepping.TRAINING_CASES, self._cases, replace=False)
            self._starts = self._view.scenario.draw("train", numbers)
        self.worlds = self._draw(self._number)
        self._returned[:], self._length[:] = 0.0, 0
        return self.worlds

    def step(self, actions: Float[np.ndarray, "world 2"]) -> Driven:
        """Simulate one step in all worlds. If a world's episode ends, its next episode starts.

        Args:
            actions: The vehicles' actions, checked.
        """
        acts = is_running(self.worlds)
        step = stepping.drive(self._view, self.worlds, actions)
        reward = np.where(acts, self._reward(step), 0.0)
        over = np.flatnonzero(~in_whole_worlds(step.outcome == Outcome.RUNNING, self._vehicles))
        driven = Driven(step, reward, self._returned + reward, self._length + 1, acts)
        self.worlds = step.after.put(over, self._draw(len(over))) if len(over) else step.after
        self._returned = np.where(step.ended, 0.0, driven.returned)
        self._length = np.where(step.ended, 0, driven.length)
        return driven

    def _draw(self, number: int) -> World:
        """Return random starting states of a number of rows."""
        assert self._starts is not None  # drawn by `start`
        vehicle = np.arange(self._vehicles)
        first = self._order.integers(len(self._starts) // self._vehicles, size=number // self._vehicles)
        return self._starts.take((self._vehicles * first[:, None] + vehicle).ravel())
