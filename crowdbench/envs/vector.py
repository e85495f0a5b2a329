"""The Gymnasium vector environment: the vehicle acts in many worlds, which are simulated at once."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.spaces.utils import flatdim
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from jaxtyping import Bool, Float

from crowdbench.core.types import Outcome, World
from crowdbench.envs import stepping
from crowdbench.envs.rewards import Reward, Step, load_reward
from crowdbench.scenario.scenario import Scenario
from crowdbench.utils.errors import InputError, require, require_count
from crowdbench.views.view import NEAREST, Observed, View, row_of

MAX_ENVS = 100_000
"""Largest number of worlds."""

MAX_NUMBERS = 100_000_000
"""Largest number of numbers in the observations of all worlds."""

_Flags = Bool[np.ndarray, "world"]


class VehicleVectorEnv(VectorEnv[Observed, np.ndarray, np.ndarray]):
    """The vehicle in many worlds of a scenario, `crowdbench/Vehicle-v0` for `gymnasium.make_vec`.

    Observations, actions, rewards, terminations, truncations and infos of each world equal the ones of a `VehicleEnv`
    with the same seed. The attribute `cases` lists the names of the cases, such as `test/37`.

    All worlds are simulated at once. `vectorization_mode="sync"` steps them one after the other: with 128 worlds this
    takes about twice as long if observations are `flat`, and otherwise eight times as long. Only that mode renders.
    With stable-baselines3, `crowdbench.envs.CrowdVecEnv` is as fast as this environment.

    Args:
        num_envs: Number of worlds.
        scenario: The name of a scenario, the path of its file, or a `Scenario`.
        autoreset_mode: When worlds whose episode is over are reset, as in Gymnasium's `SyncVectorEnv`.
        reward: As for `VehicleEnv`, and so are the next five.
        observation: `flat`, `goal_frame`, `dict` or `lidar`.
        action: `normalized` or another name of `crowdbench.views.actions`.
        nearest: Largest number of pedestrians in an observation in the frame of the goal.
        rays: Number of rays to walls in an observation in the frame of the goal.
        dtype: Type of the numbers of an observation: `float32` or `float64`.
        max_episode_steps: Largest number of steps of an episode, after which it is truncated.

    Raises:
        InputError: Scenario, reward, observation, action or type do not exist.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = "circle_crossing_5",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        reward: str | Reward = "crowdnav",
        observation: str = "flat",
        action: str = "normalized",
        nearest: int = NEAREST,
        rays: int = 0,
        dtype: str = "float32",
        max_episode_steps: int | None = None,
    ) -> None:
        self._max_steps = stepping.check_max_steps(max_episode_steps)
        require_count("num_envs", num_envs, MAX_ENVS)
        modes = [mode.value for mode in AutoresetMode]
        is_mode = isinstance(autoreset_mode, str | AutoresetMode) and autoreset_mode in [*modes, *AutoresetMode]
        require("autoreset_mode", autoreset_mode, is_mode, f"one of {', '.join(modes)}")
        self.num_envs = num_envs
        self.scenario = stepping.as_scenario(scenario)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.view = View(self.scenario, observation, action, nearest, rays, dtype)
        self.reward = load_reward(reward)
        self.single_observation_space = self.view.observation_space
        self.single_action_space = self.view.action_space
        numbers = num_envs * flatdim(self.single_observation_space)
        if numbers > MAX_NUMBERS:
            raise InputError(
                f"an observation of {num_envs} worlds has {numbers} numbers, but at most {MAX_NUMBERS} fit"
            )
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self.cases = [""] * num_envs
        self._numbers = np.zeros(num_envs, np.int64)
        self._over = np.zeros(num_envs, bool)
        self._worlds: World | None = None

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: A seed per world, or the seed of the first world; the others get the following integers. Each world
                draws training cases from its seed. None continues with the same generators.
            options: `case`, the name of a case for all worlds or a list with one per world, instead of drawn ones.
                `reset_mask`, a bool per world: only these worlds are reset.

        Returns:
            Observations and infos.

        Raises:
            InputError: A seed or an option is wrong.
        """
        given = stepping.check_options(options, "case", "reset_mask")
        mask = self._mask(given.get("reset_mask"))
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + row for row in range(self.num_envs)]
        cases = given.get("case")
        if isinstance(cases, str):
            cases = [cases] * self.num_envs
        cases = self._one_each("case", cases)
        for row, world_seed in enumerate(self._one_each("seed", seed)):
            if mask[row] and world_seed is not None:
                self._generators[row], _ = seeding.np_random(world_seed)
        self._worlds = self._restart(self._worlds, mask, cases)
        self._over[mask] = False
        infos: dict[str, Any] = {}
        _add(infos, mask, **self._facts(np.full(self.num_envs, Outcome.RUNNING), np.full(self.num_envs, np.inf)))
        return self.view.observe(self._worlds), infos

    def step(self, actions: np.ndarray) -> tuple[Observed, Float[np.ndarray, "world"], _Flags, _Flags, dict[str, Any]]:
        """Simulate one step in all worlds.

        Args:
            actions: The vehicles' actions `[world, 2]`.

        Returns:
            Observations, rewards, terminations, truncations and infos. In mode `SAME_STEP`, the last observations and
            infos of episodes that ended are in infos as `final_obs` and `final_info`.

        Raises:
            InputError: The actions are not finite numbers.
            gymnasium.error.ResetNeeded: There was no reset yet or, in mode `DISABLED`, an episode is over.
        """
        if self._worlds is None or (self.autoreset_mode == AutoresetMode.DISABLED and self._over.any()):
            raise error.ResetNeeded("call reset() first, for all worlds or for those whose episode is over")
        step = stepping.drive(self.view, self._worlds, stepping.check_actions(actions, (self.num_envs, 2)))
        worlds, outcome, gap = step.after, step.outcome, step.gap
        restarted = self._over
        rewards = self._rewards(step)
        if restarted.any():
            # NEXT_STEP: this step is the reset of these worlds. The result of their simulated step is discarded.
            worlds = self._restart(worlds, restarted)
            outcome[restarted], gap[restarted] = Outcome.RUNNING, np.inf
        terminated = (outcome != Outcome.RUNNING) & (outcome != Outcome.TIMEOUT)
        truncated = (outcome == Outcome.TIMEOUT) | (worlds.step >= self._max_steps)
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._over.any():
            restarted = self._over
            self._over = np.zeros(self.num_envs, bool)
            infos = self._final(step, restarted)
            worlds = self._restart(worlds, restarted)
            outcome[restarted], gap[restarted] = Outcome.RUNNING, np.inf
        _add(infos, np.ones(self.num_envs, bool), **self._facts(outcome, gap))
        self._worlds = worlds
        return self.view.observe(worlds), rewards, terminated, truncated, infos

    def _rewards(self, step: Step) -> Float[np.ndarray, "world"]:
        """Return the rewards of a step, 0 in worlds whose episode was over before it."""
        if not self._over.any():
            return self.reward(step)
        rewards, rows = np.zeros(self.num_envs), np.flatnonzero(~self._over)
        if len(rows):
            rewards[rows] = self.reward(step.take(rows))
        return rewards

    def _restart(self, worlds: World | None, mask: _Flags, cases: Sequence[str | None] | None = None) -> World:
        """Return all worlds, with new episodes in the masked ones: of the given cases, or else of random training
        cases."""
        rows = np.flatnonzero(mask)
        names = []
        for row in rows.tolist():
            generator = self._generators[row]
            if generator is None:
                generator = self._generators[row] = seeding.np_random()[0]
            case = None if cases is None else cases[row]
            names.append(stepping.choose_case(case, generator))
        fresh = stepping.start(self.scenario, names)
        for row, name in zip(rows.tolist(), names, strict=True):
            self.cases[row] = name
        self._numbers[rows] = fresh.case
        return fresh if worlds is None or mask.all() else worlds.put(rows, fresh)

    def _final(self, step: Step, ended: _Flags) -> dict[str, Any]:
        """Return the infos about episodes that ended in this step, before their worlds are reset."""
        final_obs = np.full(self.num_envs, None, object)
        seen = self.view.observe(step.after.take(ended))
        for index, row in enumerate(np.flatnonzero(ended)):
            final_obs[row] = row_of(seen, index)
        final_info: dict[str, Any] = {}
        _add(final_info, ended, **self._facts(step.outcome, step.gap))
        return {"final_obs": final_obs, "_final_obs": ended, "final_info": final_info, "_final_info": ended.copy()}

    def _facts(self, outcome: np.ndarray, gap: np.ndarray) -> dict[str, np.ndarray]:
        """Return the infos of all worlds, as `stepping.make_info` of each."""
        return {"outcome": outcome, "is_success": outcome == Outcome.SUCCESS, "gap": gap, "case": self._numbers}

    def _mask(self, mask: object) -> _Flags:
        if mask is None:
            return np.ones(self.num_envs, bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,) or not mask.any():
            raise InputError(f"reset_mask is {mask!r}, but must be an array of {self.num_envs} bools, one of them True")
        if self._worlds is None and not mask.all():
            raise InputError("reset_mask leaves worlds out that were never reset: reset all of them first")
        return mask

    def _one_each(self, name: str, values: Sequence[Any] | None) -> Sequence[Any]:
        if values is None:
            return [None] * self.num_envs
        if not isinstance(values, Sequence | np.ndarray):
            raise InputError(
                f"{name} is {values!r}, but must be a list with a value for each of {self.num_envs} worlds"
            )
        if len(values) != self.num_envs:
            raise InputError(f"{name} has {len(values)} values, but there are {self.num_envs} worlds")
        return values


def _add(infos: dict[str, Any], mask: _Flags, **values: np.ndarray) -> None:
    """Add values of some worlds to infos in Gymnasium's form, each with a mask `_name`; the others get 0."""
    if mask.any():
        for name, value in values.items():
            infos[name] = np.where(mask, value, np.zeros_like(value))
            infos[f"_{name}"] = mask.copy()
