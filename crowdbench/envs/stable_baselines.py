"""The vehicle in many worlds as a vector environment of stable-baselines3, which simulates them all at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import error
from jaxtyping import Bool, Float

from crowdbench.core.types import Outcome
from crowdbench.envs.rewards import Reward, load_reward
from crowdbench.envs.stepping import as_scenario, check_actions
from crowdbench.envs.training_worlds import CASES, TrainingWorlds
from crowdbench.envs.vector import MAX_ENVS
from crowdbench.scenario.cases import MOST
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError, is_integer, require, require_count
from crowdbench.views.view import NEAREST, Observed, View, row_of

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as missing:
    raise ImportError("CrowdVecEnv needs stable-baselines3: pip install 'crowdbench[ppo]'") from missing


class CrowdVecEnv(VecEnv):  # type: ignore[misc]  # stable_baselines3 is not looked into
    """The vehicle in many worlds of a scenario, for stable-baselines3 (`pip install 'crowdbench[ppo]'`).

    Observations, actions and rewards are as in `crowdbench.envs.vehicle.VehicleEnv`. Each episode starts from a random
    one of the training cases, which are drawn once. A world whose episode is over starts the next one in the same step.
    The info of that step has the last observation as `terminal_observation`, the number of its `outcome`, `is_success`,
    whether it is a time-out as `TimeLimit.truncated`, and the return `r` and the length `l` of the episode as
    `episode`. Other infos are empty.

    Args:
        num_envs: Number of worlds.
        scenario: The name of a scenario, the path of its file, or a `Scenario`.
        seed: The seed of the training cases and of their order.
        reward: See `VehicleEnv`, also for the next three.
        observation: `flat`, `goal_frame`, `dict` or `lidar`.
        action: A name of `crowdbench.views.actions`.
        nearest: Largest number of observed pedestrians in the frame of the goal.
        rays: Number of observed rays to walls in the frame of the goal.
        cases: Number of training cases.

    Raises:
        InputError: Scenario, reward, observation or action do not exist, a number is out of its range, or it is no
            whole number.
    """

    def __init__(
        self,
        num_envs: int,
        scenario: str | Path | Scenario = "circle_crossing_5",
        seed: int = 0,
        reward: str | Reward = "progress",
        observation: str = "dict",
        action: str = "normalized_goal_frame",
        nearest: int = NEAREST,
        rays: int = 0,
        cases: int = CASES,
    ) -> None:
        require_count("num_envs", num_envs, MAX_ENVS)
        require_count("cases", cases, MOST)
        self.scenario = as_scenario(scenario)
        self.view = View(self.scenario, observation, action, nearest, rays)
        self.render_mode = None
        self._running = TrainingWorlds(num_envs, self.view, load_reward(reward), cases)
        self._is_reset = False
        self._action = np.zeros((num_envs, 2))
        super().__init__(num_envs, self.view.observation_space, self.view.action_space)
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Draw the training cases and their order again at the next reset. Without a seed, a random one is taken.

        Raises InputError if the seed is no whole number, or negative.
        """
        require("seed", seed, seed is None or (is_integer(seed) and seed >= 0), "a whole number, 0 or more, or None")
        self._running.seed(seed)
        return [seed] * self.num_envs

    def reset(self) -> Observed:
        """Start new episodes in all worlds, and return the observations."""
        self._is_reset = True
        return self.view.observe(self._running.start())

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions `[world, 2]` for `step_wait`."""
        self._action = check_actions(actions, (self.num_envs, 2))

    def step_wait(self) -> tuple[Observed, Float[np.ndarray, "world"], Bool[np.ndarray, "world"], list[dict[str, Any]]]:
        """Simulate one step in all worlds. Return observations, rewards, whether episodes are over, and infos."""
        if not self._is_reset:
            raise error.ResetNeeded("call reset() first")
        step, reward, returned, length, _ = self._running.step(self._action)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if len(rows := np.flatnonzero(step.ended)):
            last = self.view.observe(step.after.take(rows))
            for index, row in enumerate(rows.tolist()):
                infos[row] = {
                    "terminal_observation": row_of(last, index),
                    "TimeLimit.truncated": bool(step.outcome[row] == Outcome.TIMEOUT),
                    "outcome": int(step.outcome[row]),
                    "is_success": bool(step.outcome[row] == Outcome.SUCCESS),
                    "episode": {"r": float(returned[row]), "l": int(length[row])},
                }
        return self.view.observe(self._running.worlds), reward, step.ended, infos

    def close(self) -> None:
        """Do nothing: no resource is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the environment, which all worlds share, once for each world.

        Args:
            attr_name: Its name.
            indices: Which worlds; all if None.
        """
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise InputError: worlds have no separate attributes.

        Args:
            attr_name: The attribute's name.
            value: Its value.
            indices: Which worlds; all if None.

        Raises:
            InputError: Always.
        """
        raise InputError(f"{attr_name} cannot be set for single worlds: make another environment")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raise InputError: worlds have no separate methods.

        Args:
            method_name: The method's name.
            *args: Its arguments.
            indices: Which worlds; all if None.
            **kwargs: Its arguments by name.

        Raises:
            InputError: Always.
        """
        raise InputError(f"worlds have no method {method_name} of their own")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Return False for each world: none is wrapped.

        Args:
            wrapper_class: A class of wrappers.
            indices: Which worlds; all if None.

        Returns:
            False for each world.
        """
        return [False] * len(list(self._get_indices(indices)))
